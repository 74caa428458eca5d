"""Parameters of the joint tracker: depth points and amplitude edges in one least squares."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import NonNegative, Positive, Share
from rpod_schemas.config.pmd_check import PmdCheckConfig
from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.config.tuning import BUDGET, BY_HAND, WIDE_PRIOR, Provenance, Tuning

Count = Annotated[int, Field(gt=0)]


class RangeErrorConfig(Tuning):
    """Errors of the ranges that do not average out over a frame, standard deviations."""

    bias_m: Positive
    """Of what all points share; each frame estimates it anew."""
    uneven_m: NonNegative
    """Of what differs from it over the target, as one more error of the depth as a whole."""


class JointDepthConfig(Tuning):
    """Measured points in the target's distance field."""

    points: Annotated[Count, BUDGET] = 1500
    """Measured points wanted, and most used; they lie as far apart in the image as that allows."""
    scale_m: Annotated[Positive, BY_HAND] = 0.10
    """Geman-McClure scale in the first iteration from afar."""
    final_scale_m: Annotated[Positive, BY_HAND] = 0.03
    """Geman-McClure scale in the last iteration."""
    noise_m: Annotated[Positive, BY_HAND] = 0.006
    """Least standard deviation of a residual; the inliers' own spread where that is larger."""
    effective_points: Annotated[
        Count,
        Provenance("hand, mock-up", "neighbours share their errors; the number is chosen on emulated frames"),
    ] = 400
    """Most residuals counted as independent: neighbours share their errors."""
    raw: Annotated[
        RangeErrorConfig,
        Provenance(
            "hand, mock-up", "of the order that Lindner et al. (CVIU 114, 2010) report for wiggling; chosen"
        ),
    ] = RangeErrorConfig(bias_m=0.04, uneven_m=0.005)
    """What noise leaves, where the depth is not calibrated: the wiggling, which is of several centimetres
    (M. Lindner et al., Computer Vision and Image Understanding 114, 2010)."""
    calibrated: Annotated[
        RangeErrorConfig, Provenance("hand, mock-up", "several millimetres that a calibration leaves; chosen")
    ] = RangeErrorConfig(bias_m=0.007, uneven_m=0.001)
    """The same where it is calibrated, of which mostly several millimetres are left; a calibration that tells
    what it left (``evidence.bias_after_m``) is believed instead."""


class JointEdgeConfig(Tuning):
    """The model's edges, searched along their normals in the amplitude image."""

    spacing_share: Annotated[Positive, BY_HAND] = 0.03
    """Distance of two samples of an edge, as a share of the target's radius."""
    blur_px: Annotated[Positive, BY_HAND] = 0.8
    """Standard deviation of the smoothing before gradients are taken."""
    clip: Annotated[Positive, BY_HAND] = 4.0
    """The amplitude is clipped at so many times its median over the target: glints would outshine edges."""
    search_px: Annotated[Positive, BY_HAND] = 12.0
    """Reach of the search both ways in the first iteration from afar."""
    final_search_px: Annotated[Positive, BY_HAND] = 3.0
    """Reach of the search in the last iteration."""
    least_contrast: Annotated[Positive, BY_HAND] = 0.06
    """Of an edge's gradient over two pixels, as a share of the median amplitude."""
    sigma_px: Annotated[Positive, BY_HAND] = 0.3
    """Least standard deviation of an edge's place; the inliers' own spread where that is larger."""
    effective_edges: Annotated[
        Count,
        Provenance("hand, mock-up", "neighbours share their errors; the number is chosen on emulated frames"),
    ] = 300
    """Most samples counted as independent."""


class JointVerdictConfig(Tuning):
    """When the tracker believes its own result: ``check``, and what the edges say."""

    min_edge_share: Annotated[
        Share,
        Provenance(
            "hand, mock-up",
            "noise leaves half of a right pose's edges in their place on emulated frames, 7 m off",
        ),
    ] = 0.47
    """Found in their place, of the edges to expect there by the noise of the frame, less one over the root of
    their number. What is expected are places that show a change, where it is. Noise leaves half of
    a right pose's there, 7 m off with the sun behind the camera."""
    weak_edge_share: Annotated[Share, BY_HAND] = 0.58
    """Below this a frame is believed, but speaks against the pose: a stream of such frames is not."""
    min_changed_share: Annotated[Share, BY_HAND] = 0.5
    """Of all places of edges those that should show a change at least; without depth, all."""
    bias_sigmas: Annotated[
        Positive,
        Provenance(
            "hand, mock-up", "right poses had up to 1.0 on emulated frames beside what scale_share allows"
        ),
    ] = 2.0
    """Of what the depth's ``bias_m`` is, that ranges may be off from where the edges have the target. Right
    poses had up to 1.0 beside what ``scale_share`` allows, a target 5 % larger or smaller mostly has more."""
    scale_share: Annotated[NonNegative, BY_HAND] = 0.004
    """Of the range, that they may be off besides: errors of the target's size and of the focal length."""
    min_points: Annotated[int, Field(ge=6), BY_HAND] = 40
    """Fewer matched points say nothing."""
    min_edges: Annotated[int, Field(ge=6), BY_HAND] = 40
    """Fewer matched samples of edges say nothing."""


class JointTuning(Tuning):
    """Steps, scales and limits of the joint tracker."""

    far_iterations: Annotated[int, Field(ge=0), BUDGET] = 8
    """Steps on depth alone before, from afar."""
    far_scale_m: Annotated[Positive, BY_HAND] = 0.6
    """Geman-McClure scale of the first of them."""
    far_points: Annotated[Count, BUDGET] = 400
    """Points that they take."""
    iterations: Annotated[int, Field(ge=2), BUDGET] = 8
    """Gauss-Newton steps from afar, over which scales and reaches narrow geometrically."""
    near_iterations: Annotated[int, Field(ge=2), BUDGET] = 5
    """Of them, the last that are done where the prediction has the edges near; and how many follow with the
    last scale and reach, the only ones where it is sharp."""
    sharp_share: Annotated[Share, BY_HAND] = 0.55
    """The prediction is sharp where this share of the edges expected in their places is there."""
    near_share: Annotated[Share, BY_HAND] = 0.4
    """It has the edges near where this share is."""
    fair_share: Annotated[Share, BY_HAND] = 0.5
    """Below this share it is drawn in from afar."""
    near_m: Annotated[Positive, BY_HAND] = 0.05
    """Within which a prediction agrees with a pixel, or within twice its noise."""
    missing_weight: Annotated[Share, BY_HAND] = 0.1
    """Weight of a pixel without depth where a prediction has surface, beside a measured one: glints, dark
    parts and close, bright ones lose theirs."""
    ghost_share: Annotated[Share, BY_HAND] = 0.08
    """Depth is dropped where the amplitude is below this share of the image's mean, in which pixels without
    depth count as dark: close to a bright target, stray light gives the background a depth."""
    unobserved_m: Annotated[Positive, WIDE_PRIOR] = 1.0
    """Standard deviation of a motion that nothing in the image determines."""
    unobserved_deg: Annotated[Positive, WIDE_PRIOR] = 30.0
    """The same of a turn."""
    depth: JointDepthConfig = JointDepthConfig()
    """Its residuals and their errors."""
    edges: JointEdgeConfig = JointEdgeConfig()
    """Their search and their errors."""
    check: PmdCheckConfig = PmdCheckConfig()
    """The self-check by render and compare."""
    verdict: JointVerdictConfig = JointVerdictConfig()
    """That by the edges, and what is too little to say anything."""

    @model_validator(mode="after")
    def _narrows(self) -> Self:
        if self.depth.final_scale_m > self.depth.scale_m:
            raise ValueError("depth.final_scale_m must not exceed depth.scale_m: the weights narrow")
        if self.edges.final_search_px > self.edges.search_px:
            raise ValueError("edges.final_search_px must not exceed edges.search_px: the search narrows")
        if self.verdict.min_edge_share > self.verdict.weak_edge_share:
            raise ValueError(
                "verdict.min_edge_share must not exceed verdict.weak_edge_share: weak is believed"
            )
        if self.near_iterations > self.iterations:
            raise ValueError("near_iterations must not exceed iterations: they are the last of them")
        return self


class JointConfig(MethodConfig):
    """Signed distance of depth points and places of edges in one least squares."""

    kind: str = "joint"
    """Selects this method."""
    slack_m: NonNegative = 0.00015
    """Standard deviation of the target model's own error, one for depth and edges as a whole. Raise it
    where the body differs more from its file: the covariances grow, so that the filter trusts frames less."""
    tuning: JointTuning = JointTuning()
    """Limits and numbers that are no part of the promise; change them only to study the method."""
