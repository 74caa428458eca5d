"""Parameters of the methods that estimate a pose from LIDAR scans."""

from typing import Annotated, Literal

from pydantic import Field

from rpod_schemas.config.acceptance import AcceptanceConfig
from rpod_schemas.config.base import Config, NonNegative, Positive
from rpod_schemas.config.sensor import MethodConfig

Count = Annotated[int, Field(gt=0)]


class TemplateMatchingConfig(MethodConfig):
    """On-line template matching (2015 paper, section 2)."""

    kind: str = "template_matching"
    """Selects this method."""
    step_deg: Annotated[float, Field(ge=5, le=90)] = 30.0
    """Delta, step of the grid of Euler angles: 60, 30 and 10 give 196, 1183 and 26011 templates."""
    variant: Literal["plain", "fast", "cued"] = "plain"
    """plain: every template is cast and correlated. fast (section 2.2): every one is cast, and correlated
    where it is spread about the boresight like the scan. cued: a share, extended like the scan, is cast."""
    tau: Positive = 0.1
    """fast: largest relative difference of the spreads D_BOR (Eq. 3)."""
    cued_share: Annotated[float, Field(gt=0, le=1)] = 0.1
    """cued: share of the templates that are cast."""
    centroid_offset: bool = True
    """Correct the position by where the template's own centroid lies; the paper takes the scan's as it is."""
    near_deg: Positive = 45.0
    """How far templates may be from a pose that is known roughly, where only that is searched."""
    candidates: Count = 10
    """Most candidates that are refined and checked."""
    choice: Literal["first", "best_explained"] = "best_explained"
    """Which accepted candidate is taken: the first in the order of the templates' cost, or the one that
    explains most of the scan."""
    distinct_deg: NonNegative = 45.0
    """Candidates whose attitudes differ by less are one, the better of them."""
    min_points: Annotated[int, Field(ge=3)] = 6
    """Scans with fewer returns are not searched."""


class ScanComparisonConfig(Config):
    """The self-check: the target is cast at the solution and compared with the scan, ray by ray."""

    tolerance_m: Positive = 0.25
    """Measured and predicted range agree within this; it covers 4-sigma outliers."""
    margin_deg: Positive = 0.2
    """A prediction holds only where all rays this far beside agree with it: outlines are left undecided."""
    sure_range_m: Positive = 180.0
    """Up to where a white surface, seen squarely, is surely detected; an echo that is predicted dimmer than
    from there may be missing. With the printed reading of the detection threshold it is 150 m."""


class IcpNearestNeighbourConfig(MethodConfig):
    """ICP from measured points to the target's surface."""

    kind: str = "icp_nearest_neighbour"
    """Selects this method."""
    matcher: Literal["nearest_neighbour", "normal_shooting"] = "nearest_neighbour"
    """What a point is matched with: the surface's closest point, or the closest face along its normal."""
    metric: Literal["point_to_point", "point_to_plane"] = "point_to_plane"
    """What a step minimises: distances to the closest points, as in the paper, or distances along the lines
    to them, which lets faces slide and converges in a tenth of the steps."""
    resistance: Positive = 0.01
    """Weight with which the points' own motion counts against a step (point_to_plane only): it holds the
    target in directions that no face determines."""
    iterations: Count = 200
    """Most iterations."""
    step_m: Positive = 1e-4
    """The iterations end where a step moves the target's surface by less than this."""
    patience: Count = 20
    """They end as well where f_CONV has not fallen in this many steps."""
    gate_m: Positive = 0.3
    """A point this near to the surface is never an outlier; it covers 4-sigma outliers."""
    gate_spread: Positive = 3.0
    """Beyond gate_m a point is an outlier where it is farther than this many robust standard deviations."""
    min_points: Annotated[int, Field(ge=6)] = 6
    """Fewer returns, or fewer inliers, are no registration."""
    sigma_range_m: Positive = 0.025
    """Standard deviation of a range, for the covariance; the residuals' own spread where that is larger."""
    unobserved_m: Positive = 1.0
    """Standard deviation of a position that no face determines."""
    unobserved_deg: Positive = 20.0
    """Standard deviation of a rotation that no face determines."""
    comparison: ScanComparisonConfig = ScanComparisonConfig()
    """The self-check."""
    acceptance: AcceptanceConfig = AcceptanceConfig(min_explained_share=0.97, min_tracked_share=0.9)
    """When a registration is believed."""
