"""Parameters of the methods that estimate a pose from PMD depth images."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.base import Config, Count, NonNegative, Positive, Share
from rpod_schemas.config.pmd.lengths import SIGMAS, MatchLengths, chosen
from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.config.tuning import BUDGET, BY_HAND, Tuning


class DepthImageConfig(Config):
    """Pixels of a depth image that are used."""

    ghost_share: Share = 0.08
    """Share of the image's mean amplitude below which depth is dropped: close to a bright target, stray light
    gives the background a false depth. It has no effect if no amplitude is sent."""
    min_pixels: Annotated[int, Field(ge=100)] = 200
    """Least number of measured pixels in an image of the target."""
    stride_px: Count = 4
    """Stride across and down, px, with which the model is rendered; at each stride the median depth of a
    pixel and its neighbours is taken."""


class DepthComparisonConfig(Config):
    """Comparison of a pose's rendered depth with the measured one: the self-check of all methods."""

    tolerance_m: Positive | None = None
    """Largest difference of measured and rendered depth that agree, m. If left out, it covers the camera's
    wiggling error and noise, 0.12 m by ``errors``; for targets smaller than the mock-up it is smaller in
    proportion, but covers the noise."""
    missing_weight: Share = 0.25
    """Weight of a pixel without depth at a predicted surface. Glints and dark parts lose depth, so that it is
    less conclusive than a measured surface that is inconsistent with the model (weight 1)."""


class DepthErrorConfig(Config):
    """Errors of the depth that the covariance of a registration assumes."""

    noise_m: Positive = 0.02
    """Least standard deviation of one depth residual, m; the spread of the residuals if that is larger. It
    belongs to the camera, whatever it looks at, as ``bias_m`` does."""
    effective_points: Count = 120
    """Largest number of residuals that count as independent: the errors of neighbours are correlated."""
    bias_m: NonNegative = 0.02
    """Standard deviation of an error that all pixels share, along the line of sight (wiggling), m."""
    bias_rad: NonNegative = 0.005
    """Standard deviation of the attitude error that an uneven depth error leaves, about each axis, rad."""

    def tolerance_m(self, size: float) -> float:
        """Return the difference of depths that this camera's errors explain, for a relative size, m."""
        noise_m = SIGMAS * self.noise_m
        covered_m = noise_m + SIGMAS * self.bias_m
        return min(covered_m, max(noise_m, size * covered_m))

    def max_cost_m2(self, size: float) -> float:
        """Return the largest mean squared residual of a right pose for a relative size, m2."""
        return max(0.003 * size**2, self.noise_m**2)


class IcpReverseCalibrationConfig(MethodConfig):
    """ICP with reverse calibration: matches are looked up in the depth image around the projected model."""

    kind: str = "icp_reverse_calibration"
    """Selects this method."""
    metric: Literal["point_to_plane", "point_to_point"] = "point_to_plane"
    """Residuals. point_to_point is the 2018 paper's: every visible model point goes to its nearest neighbour,
    with equal weights. point_to_plane slides along the model's faces and is point to point at outlines
    only."""
    radius_px: Count = 25
    """Radius of the neighbour search around a model point's pixel in the first iteration, px."""
    direct_m: Positive | None = None
    """Distance in the first iteration up to which the depth at a model point's pixel and its neighbours is
    its match, m. Beyond it, and always in point_to_point, the radius is searched. If left out, it is 0.24 m
    for the mock-up, and in proportion for what is seen of another target."""
    scale_m: Positive | None = None
    """Geman-McClure scale of the residuals in the first iteration, m (point_to_plane only). If left out, it
    is 0.15 m for the mock-up, and in proportion for another target, but such that the last one covers the
    noise of the depth."""
    outline_weight: Share = 0.3
    """Weight of a match that the search found, over that of a direct one (point_to_plane only): scattered
    lost depth resembles an outline."""
    final_share: Annotated[float, Field(gt=0, le=1)] = 0.33
    """Ratio of the last to the first radius, direct distance and scale (point_to_plane only)."""
    gate_m: Positive | None = None
    """Largest distance of a match, m; a model point farther from every measurement has none. If left out, it
    is 0.3 m for the mock-up, and in proportion for another target."""
    cover_points: Annotated[int, Field(ge=0)] = 2000
    """Largest number of measured points that are used in the opposite direction, by the target's distance
    field (point_to_plane only): they pull the model over the points that it leaves uncovered. 0 uses none."""
    iterations: Count = 15
    """Largest number of iterations."""
    error_m2: NonNegative = 0.0
    """Mean squared residual below which the iterations end, m2 (the paper's threshold)."""
    step_m: Positive | None = None
    """Motion of the target's surface in one step below which the iterations end, m. If left out, it is 2 mm
    for the mock-up, and in proportion for another target."""
    unsettled_m: Positive | None = None
    """Motion in the last step above which the iterations did not converge, m. If left out, it is
    0.02 m for the mock-up, and in proportion for another target."""
    min_cosine: Share = 0.3
    """Least cosine of the angle between the normal of a matched model point and the line of sight. Faces that
    a small attitude error brings into view have no measurement and would bias the pose."""
    min_matches: Annotated[int, Field(ge=6)] = 30
    """Least number of matched model points of a registration."""
    image: DepthImageConfig = DepthImageConfig()
    """Pixels of the image that are used."""
    comparison: DepthComparisonConfig = DepthComparisonConfig()
    """The self-check."""
    errors: DepthErrorConfig = DepthErrorConfig()
    """Errors that the covariance assumes."""
    acceptance: AcceptanceConfig = AcceptanceConfig(min_explained_share=0.6, min_inlier_share=0.45)
    """Limits within which a registration is accepted."""

    def match_lengths(self, size: float) -> MatchLengths:
        """Return the lengths of the iterations for what is seen of a relative size, m."""
        noise_m = self.errors.noise_m / self.final_share
        return MatchLengths(
            direct_m=chosen(self.direct_m, max(0.24 * size, noise_m)),
            scale_m=chosen(self.scale_m, max(0.15 * size, noise_m)),
            gate_m=chosen(self.gate_m, max(0.3 * size, noise_m)),
            step_m=chosen(self.step_m, 0.002 * size),
        )


class SignedDistanceTuning(Tuning):
    """Steps, scales and limits of the tracker by signed distance."""

    points: Annotated[Count, BUDGET] = 2000
    """Largest number of measured points that are used."""
    scale_m: Annotated[Positive | None, BY_HAND] = None
    """Geman-McClure scale in the first iteration, m. If left out, it is 0.10 m for the mock-up, and in
    proportion for what is seen of another target."""
    final_scale_m: Annotated[Positive | None, BY_HAND] = None
    """Geman-McClure scale in the last iteration, m. If left out, it is 0.03 m for the mock-up, and in
    proportion for another target, but at least the noise of the depth."""
    iterations: Annotated[int, Field(ge=2), BUDGET] = 12
    """Number of iterations, over which the scale narrows geometrically."""
    unsettled_m: Annotated[Positive | None, BY_HAND] = None
    """Motion in the last step above which the iterations did not converge, m. If left out, it is 0.02 m for
    the mock-up, and in proportion for another target."""
    image: Annotated[DepthImageConfig, BY_HAND] = DepthImageConfig()
    """Pixels of the image that are used."""
    comparison: Annotated[DepthComparisonConfig, BY_HAND] = DepthComparisonConfig()
    """The self-check."""
    errors: Annotated[DepthErrorConfig, BY_HAND] = DepthErrorConfig()
    """Errors that the covariance assumes."""
    acceptance: Annotated[AcceptanceConfig, BY_HAND] = AcceptanceConfig(
        min_explained_share=0.6, min_inlier_share=0.45
    )
    """Limits within which a registration is accepted."""

    @model_validator(mode="after")
    def _narrows(self) -> Self:
        if self.final_scale_m and self.scale_m and self.final_scale_m > self.scale_m:
            raise ValueError(
                f"final_scale_m is {self.final_scale_m:g}, must not exceed scale_m ({self.scale_m:g}): "
                "the weights narrow from step to step"
            )
        return self

    def scales_m(self, size: float) -> tuple[float, float]:
        """Return the first and the last scale for what is seen of a relative size, m."""
        last_m = chosen(self.final_scale_m, max(0.03 * size, self.errors.noise_m))
        first_m = chosen(self.scale_m, max(0.10 * size, last_m))
        return first_m, min(last_m, first_m)


class SignedDistanceConfig(MethodConfig):
    """Registration of depth points in the target's distance field, without a search for matches."""

    kind: str = "signed_distance"
    """Selects this method."""
    tuning: SignedDistanceTuning = SignedDistanceTuning()
    """Limits and numbers of the method that are outside the public interface; change them only to study
    it."""
