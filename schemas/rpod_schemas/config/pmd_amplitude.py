"""Parameters of the 2018 paper's amplitude technique: lines and a circle in the image, EPnP, and the hybrid.

Klionovska et al., Robotics 7(1), 2018, section 3.3. The paper names the steps and no threshold; those below
were found on emulated frames of both its scenarios.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Config, NonNegative, Positive, Share
from rpod_schemas.config.pmd_methods import Count, IcpReverseCalibrationConfig
from rpod_schemas.config.sensor import MethodConfig


class EdgeImageConfig(Config):
    """From the amplitude to its edges and lines (section 3.3.1, steps 1 to 5)."""

    white_percentile: Annotated[float, Field(gt=0, le=100)] = 75.0
    """The percentile of the lit pixels' amplitude that becomes 255; brighter ones are clipped. The paper's
    images come with 8 bits; a glint must not leave the rest of them dark."""
    dark_share: Share = 0.02
    """A pixel is lit where its amplitude exceeds this share of the image's brightest hundredth."""
    min_lit: Count = 200
    """Fewer lit pixels are no image of the target."""
    gamma: Positive = 0.5
    """Exponent of the grey levels: below 1 it lifts dark faces (1 is the paper's). Lines are found on this
    image and measured on the linear one: an unlinear scale shifts blurred edges."""
    low_pass_px: Positive = 1.0
    """Standard deviation of the low-pass filter."""
    canny_low: Positive = 30.0
    """Gradient from which a pixel continues an edge, grey levels (Sobel, 3 x 3)."""
    canny_high: Positive = 80.0
    """Gradient from which a pixel starts an edge, grey levels."""
    background_share: Share = 0.05
    """An edge may be a silhouette where the amplitude on its darker side is below this share of white. Lines
    of the model before the background are sought among these alone; 0 seeks every line among all edges."""
    hough_distance_px: Positive = 1.0
    """Step of the accumulator in a line's distance."""
    hough_angle_deg: Positive = 1.0
    """Step of the accumulator in a line's angle."""
    hough_votes: Count = 12
    """Least edge pixels that vote for a line."""
    min_segment_px: Positive = 8.0
    """Shortest finite line."""
    max_gap_px: NonNegative = 5.0
    """Longest gap within a finite line."""

    @model_validator(mode="after")
    def _thresholds_are_ordered(self) -> Self:
        if self.canny_low > self.canny_high:
            raise ValueError("canny_low must not exceed canny_high: edges start where they are strong")
        return self


class LineMatchConfig(Config):
    """Which of the image's lines belong to the projected wireframe, and how they are measured."""

    angle_deg: Annotated[float, Field(gt=0, lt=90)] = 12.0
    """Most that a line and its model line differ in direction, at first."""
    reach_m: Positive = 0.12
    """Most that they are apart, at the target's distance, at first."""
    narrowing: Annotated[float, Field(gt=0, le=1)] = 0.35
    """Both limits shrink by this in each further round."""
    band_px: Positive = 1.5
    """Edge pixels this near to a line measure it."""
    min_pixels: Annotated[int, Field(ge=2)] = 8
    """Fewer measure no line."""
    min_seen_share: Share = 0.3
    """Lines of which less can be seen, beside the image or behind other parts, are not sought."""
    min_turn_deg: Annotated[float, Field(gt=0, lt=90)] = 15.0
    """Neighbouring lines that meet at less in the image intersect in no corner."""


class CircleConfig(Config):
    """The circle of the nose's end, sought on its plane as predicted, where it is round (Hough transform)."""

    radius_px: Count = 24
    """Radius of the predicted circle on the image drawn of its plane."""
    radius_tolerance: Annotated[float, Field(gt=0, lt=1)] = 0.2
    """Most that a circle's radius differs from the model's, as a share of it."""
    reach_m: Positive = 0.12
    """Most that its centre is from the predicted one, at first; it narrows as that of the lines."""
    votes: Positive = 10.0
    """Least votes of the accumulator; of more circles the one nearest to the prediction is taken."""
    min_radius_px: Positive = 3.0
    """Smaller circles in the camera's image are not sought."""
    min_cosine: Share = 0.35
    """Of the angle between the line of sight and the circle's axis: seen more obliquely it is not sought."""
    min_rim_share: Share = 0.5
    """Least share of the rim on which there is an edge."""


class EpnpConfig(MethodConfig):
    """The 2018 paper's amplitude technique: lines and a circle, their corners and centre, EPnP."""

    kind: str = "epnp"
    """Selects this method."""
    points: Literal["front", "all"] = "front"
    """front: the paper's, the largest face that is seen and the extreme circle before it; all: corners and
    circles of every face that is seen."""
    min_face_share: Share = 0.05
    """Faces smaller than this share of the largest have no lines in the wireframe (``all`` only)."""
    edges: EdgeImageConfig = EdgeImageConfig()
    """The image's lines."""
    lines: LineMatchConfig = LineMatchConfig()
    """Their match with the wireframe."""
    circle: CircleConfig = CircleConfig()
    """The nose."""
    rounds: Count = 3
    """How often features are matched and the pose solved, each from the last pose, with narrower limits."""
    polish_iterations: Annotated[int, Field(ge=0)] = 10
    """Gauss-Newton steps on the reprojection error after EPnP; 0 for the paper's pose."""
    min_points: Annotated[int, Field(ge=4)] = 4
    """Fewer corners and centres are no registration: EPnP needs four."""
    min_relief: Share = 0.05
    """Least extent of the points across their common plane, as a share of that along it: coplanar corners
    alone are ambiguous in their tilt, and degenerate for EPnP."""
    outlier_px: Positive = 3.0
    """A point that reprojects farther off, and farther than all others, is dropped, the pose solved anew."""
    max_error_px: Positive = 2.0
    """A larger root mean square of the reprojection errors is no registration."""
    max_turn_deg: Positive = 15.0
    """A pose farther from the prediction in attitude is not believed."""
    max_shift_share: Positive = 0.15
    """A pose farther from the prediction in position, as a share of the distance, is not believed."""
    noise_px: Positive = 0.3
    """Least standard deviation of a point's coordinate that the covariance assumes."""
    max_sigma_deg: Positive = 8.0
    """A pose whose covariance says more about some axis is not believed."""


class HybridConfig(MethodConfig):
    """Both techniques of the 2018 paper on every frame, and the arbitration between them."""

    kind: str = "hybrid"
    """Selects this method."""
    depth: IcpReverseCalibrationConfig = IcpReverseCalibrationConfig()
    """The first technique."""
    amplitude: EpnpConfig = EpnpConfig()
    """The second technique."""
    max_depth_cost_m2: Positive = 0.003
    """A depth registration with a larger mean squared residual is not believed."""
    min_inlier_share: Share = 0.45
    """Nor is one with fewer inliers among the points that could have matched."""
    min_explained_share: Share = 0.6
    """Nor is one that explains a smaller share of the depth image."""
    agreement: Positive = 16.8
    """The techniques agree where the squared difference of their poses, by the sum of their covariances, is
    below this: the 99 % quantile of chi squared with six degrees of freedom. Only then they are fused."""
    redundant_points: Annotated[int, Field(ge=4)] = 6
    """Where they disagree, the amplitude's pose is taken if it rests on so many points, else the depth's."""
