"""Parameters of the methods that estimate a pose from LIDAR scans."""

from typing import Annotated, Literal

from pydantic import Field

from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.base import Config, Count, NonNegative, Positive
from rpod_schemas.config.sensor import MethodConfig


class TemplateMatchingConfig(MethodConfig):
    """On-line template matching (2015 paper, section 2)."""

    kind: str = "template_matching"
    """Selects this method."""
    step_deg: Annotated[float, Field(ge=5, le=90)] = 30.0
    """Step Delta of the grid of Euler angles, deg: 60, 30 and 10 give 196, 1183 and 26011 templates."""
    variant: Literal["plain", "fast", "cued"] = "plain"
    """Choice of the templates. plain: every template is ray-cast and correlated. fast (section 2.2): every
    one is ray-cast, and correlated if its spread about the boresight is similar to the scan's. cued: only a
    share whose extent is similar to the scan's is ray-cast."""
    tau: Positive = 0.1
    """Largest relative difference of the spreads D_BOR in the fast variant (Eq. 3)."""
    cued_share: Annotated[float, Field(gt=0, le=1)] = 0.1
    """Share of the templates that the cued variant ray-casts."""
    centroid_offset: bool = True
    """Whether the position is corrected by the offset of the template's own centroid; the paper takes the
    scan's centroid uncorrected."""
    near_deg: Positive = 45.0
    """Largest angle of a template from a roughly known pose, deg, in a search near that pose."""
    candidates: Count = 10
    """Largest number of candidates that are refined and checked."""
    choice: Literal["first", "best_explained"] = "best_explained"
    """Choice among accepted candidates: the first in the order of the templates' cost, or the one that
    explains most of the scan."""
    distinct_deg: NonNegative = 45.0
    """Angle between the attitudes of two candidates, deg, below which only the better one is kept."""
    min_points: Annotated[int, Field(ge=3)] = 6
    """Least number of returns of a scan that is searched."""


class ScanComparisonConfig(Config):
    """The self-check: the target is ray-cast at the solution and compared with the scan, ray by ray."""

    tolerance_m: Positive | None = None
    """Largest difference of measured and predicted range that agree, m. If left out, it follows from the
    error of a range that the sensor states: ten standard deviations, 0.25 m for 25 mm, so that most of the
    4-sigma outliers agree."""
    margin_deg: Positive = 0.2
    """Angle around a ray within which all predictions must agree with its own, deg; else, as at outlines, the
    ray is not compared."""
    sure_range_m: Positive = 180.0
    """Range up to which the sensor surely detects a white surface at normal incidence, m. A predicted echo
    that is weaker than the one from there may be missing. With the printed reading of the detection threshold
    it is 150 m."""


class IcpNearestNeighbourConfig(MethodConfig):
    """ICP from measured points to the target's surface."""

    kind: str = "icp_nearest_neighbour"
    """Selects this method."""
    matcher: Literal["nearest_neighbour", "normal_shooting"] = "nearest_neighbour"
    """Partner of a point: the surface's closest point, or the closest face along its normal."""
    metric: Literal["point_to_point", "point_to_plane"] = "point_to_plane"
    """Residuals that a step minimises: distances to the closest points, as in the paper, or distances along
    the lines to them. The latter let faces slide, so that a tenth of the steps converges."""
    resistance: Positive = 0.01
    """Weight of the points' own motion in a step (point_to_plane only); it holds the target in directions
    that no face determines."""
    iterations: Count = 200
    """Largest number of iterations."""
    step_m: Positive | None = None
    """Motion of the target's surface in one step below which the iterations end, m. If left out, it is 0.004
    standard deviations of a range, 0.1 mm for 25 mm."""
    patience: Count = 20
    """Number of steps without a lower f_CONV after which the iterations end as well."""
    gate_m: Positive | None = None
    """Distance from the surface up to which a point is never an outlier, m. If left out, it covers 4-sigma
    outliers: twelve standard deviations of a range, 0.3 m for 25 mm."""
    gate_spread: Positive = 3.0
    """Distance from the surface above which a point beyond gate_m is an outlier, robust standard
    deviations."""
    min_points: Annotated[int, Field(ge=6)] = 6
    """Least number of returns, and of inliers, of a registration."""
    sigma_range_m: Positive | None = None
    """Standard deviation of a range for the covariance, m; the spread of the residuals if that is larger. If
    left out, it is the one that the sensor states, or 0.05 m if it states none."""
    unobserved_m: Positive | None = None
    """Standard deviation of a position that no face determines, m; if left out, the target's radius."""
    unobserved_deg: Positive = 20.0
    """Standard deviation of a rotation that no face determines, deg."""
    comparison: ScanComparisonConfig = ScanComparisonConfig()
    """The self-check."""
    acceptance: AcceptanceConfig = AcceptanceConfig(min_explained_share=0.97, min_tracked_share=0.9)
    """Limits within which a registration is accepted."""
