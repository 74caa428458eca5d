"""Parameters of the methods that estimate a pose from PMD depth images."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.base import Config, NonNegative, Positive, Share
from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.config.tuning import BUDGET, BY_HAND, Tuning

Count = Annotated[int, Field(gt=0)]


class DepthImageConfig(Config):
    """What of a depth image is used."""

    ghost_share: Share = 0.08
    """Depth is dropped where the amplitude is below this share of the image's mean: close to a bright target,
    stray light gives the background a depth. Not asked where no amplitude is sent."""
    min_pixels: Annotated[int, Field(ge=100)] = 200
    """Fewer measured pixels are no image of the target."""
    stride_px: Count = 4
    """Every how many pixels, across and down, the model is rendered, and the median depth of a pixel and its
    neighbours is taken."""


class DepthComparisonConfig(Config):
    """How a pose's rendered depth is compared with the measured one: the self-check of all methods."""

    tolerance_m: Positive = 0.12
    """Measured and rendered depth agree within this; it must cover the camera's wiggling error and noise."""
    missing_weight: Share = 0.25
    """Weight of a pixel without depth where the model predicts surface: glints and dark parts lose depth, so
    it says less than a measured surface that the model contradicts (weight 1)."""


class DepthErrorConfig(Config):
    """The errors of the depth that the covariance of a registration assumes."""

    noise_m: Positive = 0.02
    """Least standard deviation of one depth residual; the residuals' own spread where that is larger."""
    effective_points: Count = 120
    """Most residuals counted as independent: neighbours share their errors."""
    bias_m: NonNegative = 0.02
    """Standard deviation of an error that all pixels share, along the line of sight (wiggling)."""
    bias_rad: NonNegative = 0.005
    """Standard deviation of the attitude error that an uneven depth error leaves, about each axis."""


class IcpReverseCalibrationConfig(MethodConfig):
    """ICP with reverse calibration: matches are looked up in the depth image around the projected model."""

    kind: str = "icp_reverse_calibration"
    """Selects this method."""
    metric: Literal["point_to_plane", "point_to_point"] = "point_to_plane"
    """point_to_point is the 2018 paper's: every visible model point goes to its nearest neighbour, with equal
    weights. point_to_plane slides along the model's faces and keeps point to point at outlines only."""
    radius_px: Count = 25
    """Radius of the neighbour search around a model point's pixel, at first."""
    direct_m: Positive = 0.24
    """The depth under a model point's pixel and its neighbours is its match where it is this near, at first;
    else, and always in point_to_point, the radius is searched."""
    scale_m: Positive = 0.15
    """Geman-McClure scale of the residuals, at first (point_to_plane only)."""
    outline_weight: Share = 0.3
    """Weight of a match found by the search beside a direct one (point_to_plane only): scattered lost depth
    looks like an outline."""
    final_share: Annotated[float, Field(gt=0, le=1)] = 0.33
    """Radius, direct match and scale narrow to this share of their first values (point_to_plane only)."""
    gate_m: Positive = 0.3
    """Longest match; a model point farther from every measurement has none."""
    cover_points: Annotated[int, Field(ge=0)] = 2000
    """Most measured points used in the opposite direction, by the target's distance field: they pull the
    model over what it leaves uncovered (point_to_plane only); 0 for none."""
    iterations: Count = 15
    """Most iterations."""
    error_m2: NonNegative = 0.0
    """The iterations end where the mean squared residual falls below this (the paper's threshold)."""
    step_m: Positive = 0.002
    """The iterations end where a step moves the target's surface by less than this."""
    unsettled_m: Positive = 0.02
    """A last step larger than this means that the iterations did not converge."""
    min_cosine: Share = 0.3
    """Of the angle between a model point's normal and the line of sight: points seen more obliquely are not
    matched. Faces that a small error of the attitude brings into view have no measurement, and drag."""
    min_matches: Annotated[int, Field(ge=6)] = 30
    """Fewer matched model points are no registration."""
    image: DepthImageConfig = DepthImageConfig()
    """What of the image is used."""
    comparison: DepthComparisonConfig = DepthComparisonConfig()
    """The self-check."""
    errors: DepthErrorConfig = DepthErrorConfig()
    """What the covariance assumes."""
    acceptance: AcceptanceConfig = AcceptanceConfig(min_explained_share=0.6, min_inlier_share=0.45)
    """When a registration is believed."""


class SignedDistanceTuning(Tuning):
    """Steps, scales and limits of the tracker by signed distance."""

    points: Annotated[Count, BUDGET] = 2000
    """Most measured points used."""
    scale_m: Annotated[Positive, BY_HAND] = 0.10
    """Geman-McClure scale in the first iteration."""
    final_scale_m: Annotated[Positive, BY_HAND] = 0.03
    """Geman-McClure scale in the last iteration."""
    iterations: Annotated[int, Field(ge=2), BUDGET] = 12
    """Iterations, over which the scale narrows geometrically."""
    unsettled_m: Annotated[Positive, BY_HAND] = 0.02
    """A last step larger than this means that the iterations did not converge."""
    image: Annotated[DepthImageConfig, BY_HAND] = DepthImageConfig()
    """What of the image is used."""
    comparison: Annotated[DepthComparisonConfig, BY_HAND] = DepthComparisonConfig()
    """The self-check."""
    errors: Annotated[DepthErrorConfig, BY_HAND] = DepthErrorConfig()
    """What the covariance assumes."""
    acceptance: Annotated[AcceptanceConfig, BY_HAND] = AcceptanceConfig(
        min_explained_share=0.6, min_inlier_share=0.45
    )
    """When a registration is believed."""

    @model_validator(mode="after")
    def _narrows(self) -> Self:
        if self.final_scale_m > self.scale_m:
            raise ValueError("final_scale_m must not exceed scale_m: the weights narrow")
        return self


class SignedDistanceConfig(MethodConfig):
    """Depth points in the target's distance field: no matches are searched."""

    kind: str = "signed_distance"
    """Selects this method."""
    tuning: SignedDistanceTuning = SignedDistanceTuning()
    """Limits and numbers that are no part of the promise; change them only to study the method."""
