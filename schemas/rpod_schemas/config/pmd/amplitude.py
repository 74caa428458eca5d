"""Parameters of the 2018 paper's amplitude technique: lines and a circle in the image, EPnP, and the hybrid.

Klionovska et al., Robotics 7(1), 2018, section 3.3. The paper gives the steps but no thresholds; those below
were chosen on emulated frames of both its scenarios.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from rpod_schemas.config.base import Config, Count, NonNegative, Positive, Share
from rpod_schemas.config.pmd.lengths import chosen
from rpod_schemas.config.pmd.methods import IcpReverseCalibrationConfig
from rpod_schemas.config.sensor import MethodConfig


class EdgeImageConfig(Config):
    """Steps from the amplitude image to its edges and lines (section 3.3.1, steps 1 to 5)."""

    white_percentile: Annotated[float, Field(gt=0, le=100)] = 75.0
    """Percentile of the lit pixels' amplitude that becomes 255; brighter pixels are clipped. The paper's
    images have 8 bits; with the maximum, a glint would leave the other pixels dark."""
    dark_share: Share = 0.02
    """Share of the amplitude of the image's brightest hundredth above which a pixel is lit."""
    min_lit: Count = 200
    """Least number of lit pixels in an image of the target."""
    gamma: Positive = 0.5
    """Exponent of the grey levels; below 1 it brightens dark faces (1 is the paper's). Lines are found in
    this image and measured in the linear one, because a nonlinear scale shifts blurred edges."""
    low_pass_px: Positive = 1.0
    """Standard deviation of the low-pass filter, px."""
    canny_low: Positive = 30.0
    """Gradient from which a pixel continues an edge, grey levels (Sobel, 3 x 3)."""
    canny_high: Positive = 80.0
    """Gradient from which a pixel starts an edge, grey levels."""
    background_share: Share = 0.05
    """Share of white below which the amplitude on the darker side of a silhouette edge lies. Model lines in
    front of the background are searched among silhouette edges only; with 0 every line is searched among all
    edges."""
    hough_distance_px: Positive = 1.0
    """Step of the accumulator in a line's distance, px."""
    hough_angle_deg: Positive = 1.0
    """Step of the accumulator in a line's angle, deg."""
    hough_votes: Count = 12
    """Least number of edge pixels that vote for a line."""
    min_segment_px: Positive = 8.0
    """Least length of a finite line, px."""
    max_gap_px: NonNegative = 5.0
    """Largest gap within a finite line, px."""

    @model_validator(mode="after")
    def _thresholds_are_ordered(self) -> Self:
        if self.canny_low > self.canny_high:
            raise ValueError(
                f"canny_low is {self.canny_low:g}, must not exceed canny_high ({self.canny_high:g}): "
                "an edge starts at a strong gradient and continues at a weaker one"
            )
        return self


class LineMatchConfig(Config):
    """Matches of the image's lines with the projected wireframe, and their measurement."""

    angle_deg: Annotated[float, Field(gt=0, lt=90)] = 12.0
    """Largest difference in direction of a line and its model line in the first round, deg."""
    reach_m: Positive | None = None
    """Largest distance of a line from its model line in the first round, at the target's distance, m. If left
    out, it is 0.12 m for the mock-up, and in proportion for what is seen of another target."""
    narrowing: Annotated[float, Field(gt=0, le=1)] = 0.35
    """Factor on both limits in each further round."""
    band_px: Positive = 1.5
    """Distance from a line within which edge pixels measure it, px."""
    min_pixels: Annotated[int, Field(ge=2)] = 8
    """Least number of edge pixels that measure a line."""
    min_seen_share: Share = 0.3
    """Least visible share of a line that is searched; the rest is beside the image or behind other parts."""
    min_turn_deg: Annotated[float, Field(gt=0, lt=90)] = 15.0
    """Least angle in the image at which neighbouring lines intersect in a corner, deg."""


class CircleConfig(Config):
    """Search for the circle of the nose's end in its predicted plane, where it is round (Hough transform)."""

    radius_px: Count = 24
    """Radius of the predicted circle in the image that is resampled to its plane, px."""
    radius_tolerance: Annotated[float, Field(gt=0, lt=1)] = 0.2
    """Largest difference between a circle's radius and the model's, as a share of the latter."""
    reach_m: Positive | None = None
    """Largest distance of the centre from the predicted one in the first round, m; it narrows like that of
    the lines. If left out, it is as long as theirs by default."""
    votes: Positive = 10.0
    """Least number of votes in the accumulator; of several circles the one nearest to the prediction is
    taken."""
    min_radius_px: Positive = 3.0
    """Least radius of a circle in the camera's image that is searched, px."""
    min_cosine: Share = 0.35
    """Least cosine of the angle between the line of sight and the axis of a circle that is searched."""
    min_rim_share: Share = 0.5
    """Least share of the rim that must show an edge."""


class EpnpConfig(MethodConfig):
    """The 2018 paper's amplitude technique: lines and a circle, their corners and centre, EPnP."""

    kind: str = "epnp"
    """Selects this method."""
    points: Literal["front", "all"] = "front"
    """Points of the model. front: those of the paper, the largest visible face and the extreme circle in
    front of it; all: corners and circles of every visible face."""
    min_face_share: Share = 0.05
    """Least size of a face whose lines are in the wireframe, as a share of the largest face (``all``
    only)."""
    edges: EdgeImageConfig = EdgeImageConfig()
    """Detection of the image's lines."""
    lines: LineMatchConfig = LineMatchConfig()
    """Matches of the lines with the wireframe."""
    circle: CircleConfig = CircleConfig()
    """Search for the circle of the nose."""
    rounds: Count = 3
    """Number of rounds; each matches features and solves the pose, from the last pose and with narrower
    limits."""
    polish_iterations: Annotated[int, Field(ge=0)] = 10
    """Number of Gauss-Newton steps on the reprojection error after EPnP; 0 for the paper's pose."""
    min_points: Annotated[int, Field(ge=4)] = 4
    """Least number of corners and centres of a registration; EPnP needs four."""
    min_relief: Share = 0.05
    """Least extent of the points across their common plane, as a share of that along it: coplanar corners
    alone leave the tilt ambiguous and are degenerate for EPnP."""
    outlier_px: Positive = 3.0
    """Reprojection error above which the point with the largest error is dropped and the pose solved again,
    px."""
    max_error_px: Positive = 2.0
    """Largest root mean square of the reprojection errors of a registration, px."""
    max_turn_deg: Positive = 15.0
    """Largest angle between an accepted pose and the prediction, deg."""
    max_shift_share: Positive = 0.15
    """Largest distance between an accepted pose and the prediction, as a share of the range."""
    noise_px: Positive = 0.3
    """Least standard deviation of a point's coordinate in the covariance, px."""
    max_sigma_deg: Positive = 8.0
    """Largest standard deviation of an accepted pose about any axis, deg."""

    def reaches_m(self, size: float) -> tuple[float, float]:
        """Return the reaches of lines and of circles in the first round for a relative size, m."""
        return chosen(self.lines.reach_m, 0.12 * size), chosen(self.circle.reach_m, 0.12 * size)


class HybridConfig(MethodConfig):
    """Both techniques of the 2018 paper on every frame, and the arbitration between them."""

    kind: str = "hybrid"
    """Selects this method."""
    depth: IcpReverseCalibrationConfig = IcpReverseCalibrationConfig()
    """The first technique."""
    amplitude: EpnpConfig = EpnpConfig()
    """The second technique."""
    max_depth_cost_m2: Positive | None = None
    """Largest mean squared residual of an accepted depth registration, m2. If left out, it follows as that of
    ``acceptance``."""
    min_inlier_share: Share = 0.45
    """Least share of inliers of an accepted depth registration, among the points that could have matched."""
    min_explained_share: Share = 0.6
    """Least share of the depth image that an accepted depth registration explains."""
    agreement: Positive = 16.8
    """Largest squared difference of the two poses, normalised by the sum of their covariances, with which
    they agree and are fused: the 99 % quantile of chi-squared with six degrees of freedom."""
    redundant_points: Annotated[int, Field(ge=4)] = 6
    """Least number of points with which the amplitude's pose is taken if the two disagree; with fewer the
    depth's is taken."""
