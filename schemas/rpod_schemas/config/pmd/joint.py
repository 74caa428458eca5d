"""Parameters of the joint tracker: depth points and amplitude edges in one least squares."""

from operator import attrgetter
from typing import Annotated, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Count, NonNegative, Positive, Share
from rpod_schemas.config.pmd.check import PmdCheckConfig
from rpod_schemas.config.pmd.depth_calibration import DepthCalibration
from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.config.tuning import (
    BUDGET,
    BY_HAND,
    FIRST_STEP,
    OF_CAMERA,
    POPULATION_PMD,
    THREE_SIGMA,
    UNKNOWN_ANGLE,
    Limit,
    Provenance,
    Tuning,
)

CHOICE = Provenance(
    "numerics", "it chooses the start that is tried first; the next one is tried where its result is refused"
)
"""Provenance of what decides with how many steps the tracker begins."""
NEIGHBOURS = Provenance(
    "hand, mock-up", "neighbours share their errors; the number is chosen on emulated frames"
)
"""Provenance of numbers of residuals that count as independent."""


class RangeErrorConfig(Tuning):
    """Standard deviations of the range errors that do not average out over a frame."""

    bias_m: Positive
    """Standard deviation of the error that all points share, m; it is estimated in each frame."""
    uneven_m: NonNegative
    """Standard deviation of the remaining error, which varies over the target, m; it counts as one more error
    of the whole depth."""


class JointDepthConfig(Tuning):
    """Residuals of measured points in the target's distance field, and their errors."""

    points: Annotated[Count, BUDGET] = 1500
    """Largest and desired number of measured points; their spacing in the image follows from it."""
    scale_share: Annotated[Positive, FIRST_STEP] = 0.106
    """Geman-McClure scale in the first step from a far prediction, as a share of the target's radius."""
    final_scale_share: Annotated[Positive, BY_HAND] = 0.032
    """The same in the last step; ``scale_sigmas`` limits both."""
    scale_sigmas: Annotated[Positive, THREE_SIGMA] = 3.0
    """Least scale, in standard deviations of a range by the frame's noise and ``noise_m``."""
    noise_m: Annotated[Positive, OF_CAMERA] = 0.006
    """Least standard deviation of a residual, m; the spread of the inliers if that is larger."""
    effective_points: Annotated[Count, NEIGHBOURS] = 400
    """Largest number of residuals that count as independent: the errors of neighbours are correlated."""
    raw: Annotated[
        RangeErrorConfig,
        Provenance(
            "hand, mock-up", "of the order that Lindner et al. (CVIU 114, 2010) report for wiggling; chosen"
        ),
    ] = RangeErrorConfig(bias_m=0.04, uneven_m=0.005)
    """Errors of the ranges if the depth is not calibrated: the wiggling, which is several centimetres (M.
    Lindner et al., Computer Vision and Image Understanding 114, 2010)."""
    calibrated: Annotated[
        RangeErrorConfig, Provenance("hand, mock-up", "several millimetres that a calibration leaves; chosen")
    ] = RangeErrorConfig(bias_m=0.007, uneven_m=0.001)
    """Errors of the ranges if the depth is calibrated, mostly several millimetres. A calibration that states
    its remaining error (``evidence.bias_after_m``) replaces it."""

    def shared_bias_m(self, calibration: DepthCalibration | None) -> float:
        """Return the standard deviation of the error that all ranges of a frame share, m."""
        if calibration is None:
            return self.raw.bias_m
        return self.calibrated.bias_m if calibration.evidence is None else calibration.evidence.bias_after_m


class JointEdgeConfig(Tuning):
    """Search for the model's edges along their normals in the amplitude image, and their errors."""

    spacing_share: Annotated[Positive, BUDGET] = 0.03
    """Distance between two samples of an edge, as a share of the target's radius."""
    blur_px: Annotated[Positive, BY_HAND] = 0.8
    """Standard deviation of the smoothing before gradients are taken, px."""
    clip: Annotated[Positive, BY_HAND] = 4.0
    """Amplitude above which pixels are clipped, over the median amplitude of the target: glints would
    outshine edges."""
    search_px: Annotated[Positive, BY_HAND] = 12.0
    """Reach of the search to both sides in the first step from a far prediction, px."""
    final_search_px: Annotated[Positive, BY_HAND] = 3.0
    """Reach of the search in the last step, px."""
    least_contrast: Annotated[Positive, BY_HAND] = 0.06
    """Least change of the amplitude over two pixels at an edge, as a share of the median amplitude."""
    sigma_px: Annotated[Positive, BY_HAND] = 0.3
    """Least standard deviation of an edge's position, px; the spread of the inliers if that is larger."""
    effective_edges: Annotated[Count, NEIGHBOURS] = 300
    """Largest number of samples that count as independent: the errors of neighbours are correlated."""


class JointAcceptanceConfig(Tuning):
    """Limits of the edges and of the scale for a pose to be accepted, besides the limits in ``check``."""

    min_edge_share: Annotated[
        Share,
        Limit("edges_in_place_share", least=True),
        POPULATION_PMD,
    ] = 0.46
    """Least share of edges found near their place, over those that a rendering of the target shows and that
    exceed the noise of the frame. One over the square root of their number is added to the share, as an
    allowance for chance."""
    weak_edge_share: Annotated[
        Share, Limit("edges_in_place_share", least=True, usual=0.98), POPULATION_PMD
    ] = 0.7
    """Share below which a pose is doubtful: no track begins at it, and a stream of doubtful frames ends a
    track. One right pose in fifty has less."""
    bias_sigmas: Annotated[
        Positive,
        Limit("range_bias_sigmas"),
        Provenance(
            "physics",
            "95 % of normal errors are smaller; the population, with an uncalibrated camera, would allow 1.2",
        ),
    ] = 2.0
    """Largest bias of the ranges against the distance that the edges give, in standard deviations ``bias_m``
    of the depth and in addition to ``scale_share``. A target 5 % larger or smaller mostly has more."""
    scale_share: Annotated[NonNegative, BY_HAND] = 0.004
    """Further tolerated bias of the ranges, as a share of the range: errors of the target's size and of the
    focal length."""
    min_points: Annotated[int, Field(ge=6), BY_HAND] = 40
    """Least number of matched points that are conclusive."""
    min_edges: Annotated[int, Field(ge=6), BY_HAND] = 40
    """Least number of matched edge samples that are conclusive."""


class JointTuning(Tuning):
    """Steps, scales and limits of the joint tracker."""

    far_iterations: Annotated[int, Field(ge=0), BUDGET] = 8
    """Number of first steps from a far prediction, on depth alone."""
    far_scale_share: Annotated[Positive, FIRST_STEP] = 0.64
    """Geman-McClure scale of the first of these steps, as a share of the target's radius."""
    far_points: Annotated[Count, BUDGET] = 400
    """Number of points that these steps use."""
    iterations: Annotated[int, Field(ge=2), BUDGET] = 8
    """Number of Gauss-Newton steps from a far prediction, over which scales and reaches narrow
    geometrically."""
    near_iterations: Annotated[int, Field(ge=2), BUDGET] = 5
    """Number of these steps, the last ones, that are done from a near prediction; and number of further steps
    with the last scale and reach. From an accurate prediction only the further steps are done."""
    accurate_share: Annotated[Share, CHOICE] = 0.55
    """Share of the expected edges found in their places above which a prediction is accurate."""
    near_share: Annotated[Share, CHOICE] = 0.4
    """Share of the expected edges found in their places above which a prediction is near."""
    fair_share: Annotated[Share, CHOICE] = 0.5
    """Share of agreeing pixels below which a prediction is far: the steps on depth alone are done first."""
    near_depth_share: Annotated[Positive, BY_HAND] = 0.053
    """Largest difference between a predicted and a measured range that agree, as a share of the target's
    radius; or the standard deviation of the camera's bias, or twice the pixel's noise."""
    missing_weight: Annotated[Share, BY_HAND] = 0.1
    """Weight of a pixel without depth at a predicted surface, over that of a measured one: glints, dark parts
    and close, bright parts lose their depth."""
    ghost_share: Annotated[Share, BY_HAND] = 0.08
    """Share of the brightness around a pixel below which its depth is dropped; pixels without depth count as
    dark. Close to a bright target, stray light gives the background a false depth."""
    unobserved_deg: Annotated[Positive, UNKNOWN_ANGLE] = 104.0
    """Standard deviation of a rotation that nothing in the image determines, deg. That of a translation is
    the target's radius."""
    depth: JointDepthConfig = JointDepthConfig()
    """Residuals of the depth points and their errors."""
    edges: JointEdgeConfig = JointEdgeConfig()
    """Search for the edges and their errors."""
    check: PmdCheckConfig = PmdCheckConfig()
    """Limits of the self-check by render and compare."""
    acceptance: JointAcceptanceConfig = JointAcceptanceConfig()
    """Limits of the self-check by the edges, and least numbers that are conclusive."""

    @model_validator(mode="after")
    def _narrows(self) -> Self:
        for lower, upper, why in (
            ("depth.final_scale_share", "depth.scale_share", "the weights narrow from step to step"),
            ("edges.final_search_px", "edges.search_px", "the search narrows from step to step"),
            ("acceptance.min_edge_share", "acceptance.weak_edge_share", "a pose between them is doubtful"),
            ("near_iterations", "iterations", "they are the last of them"),
        ):
            value, limit = attrgetter(lower)(self), attrgetter(upper)(self)
            if value > limit:
                raise ValueError(f"{lower} is {value:g}, must not exceed {upper} ({limit:g}): {why}")
        return self


class JointConfig(MethodConfig):
    """Joint tracker: depth points in the distance field and edge positions in one least squares."""

    kind: str = "joint"
    """Selects this method."""
    slack_m: NonNegative = 0.00015
    """Standard deviation of the target model's own error, m, one for depth and edges as a whole. Raise it if
    the body differs more from its file: the covariances grow, and the filter trusts frames less."""
    tuning: JointTuning = JointTuning()
    """Limits and numbers of the method that are outside the public interface; change them only to study
    it."""
