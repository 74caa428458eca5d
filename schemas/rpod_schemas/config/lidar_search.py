"""Parameters of the global search in LIDAR scans, and of the tracker that casts the target."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import NonNegative, Positive, Share
from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.config.tuning import BUDGET, BY_HAND, UNKNOWNS, WIDE_PRIOR, Provenance, Tuning

Count = Annotated[int, Field(gt=0)]


class ScanModelConfig(Tuning):
    """What a method assumes of a scan's statistics beyond what sensor and scan tell."""

    sigma_range_m: Annotated[
        Positive | None, Provenance("physics", "the sensor's own message, where it tells")
    ] = None
    """Standard deviation of a range; None for what the sensor says of itself, 0.05 m where it does not."""
    noise_scale: Annotated[
        Positive, Provenance("physics", "the sensor's own message is believed as it is")
    ] = 1.0
    """Standard deviation over that."""
    least_range_m: Annotated[
        Positive, Provenance("physics", "LIDARs for rendezvous state larger ranges in their data sheets")
    ] = 100.0
    """Range at which a white surface at normal incidence gives a return for every other pulse, at least. No
    sensor is assumed to be weaker."""
    surest_detection: Annotated[
        Annotated[float, Field(gt=0, lt=1)],
        Provenance("hand, mock-up", "a prior: holes, edges and mirrors lose a few rays of any sensor"),
    ] = 0.95
    """A ray that meets the target is never expected to come back with a larger probability: holes, edges and
    mirrors lose what the brightness of a surface does not tell."""
    slack_m: Annotated[Positive, BY_HAND] = 0.008
    """Standard deviation of the target's faces about their model."""
    clutter_share: Annotated[float, Field(gt=0, lt=1), BY_HAND] = 0.02
    """Share of rays whose return, or its lack, says nothing."""
    clutter_depth_m: Annotated[Positive, BY_HAND] = 20.0
    """Depth over which such returns are spread."""


class ScanVerdictConfig(Tuning):
    """When a pose explains a scan: by the likelihood, and by the share of rays that agree.

    Either the scan's model or the pessimistic one must be content: what is known of materials, noise and
    target is never exact.
    """

    max_deficit: Annotated[NonNegative, BY_HAND] = 1.0
    """Expected minus actual log likelihood is at most this many of its standard deviations, and ..."""
    max_deficit_per_return: Annotated[NonNegative, BY_HAND] = 0.05
    """... this much a return on top."""
    inconsistent_share: Annotated[Share, BY_HAND] = 0.055
    """Share of rays that may contradict the pose, or be missing; two standard deviations of their number more
    where returns are few."""
    pessimistic: Annotated[
        ScanModelConfig,
        Provenance(
            "hand, mock-up", "a sensor worse than it says, and a target not as drawn; how much is chosen"
        ),
    ] = ScanModelConfig(noise_scale=2.0, slack_m=0.03, clutter_share=0.05)
    """A sensor that errs more than it says, and a target that was not built as drawn."""


class ProjectiveIcpTuning(Tuning):
    """Steps, scales and limits of the tracker that casts the target."""

    points: Annotated[Count, BUDGET] = 100
    """Returns that the first steps work on."""
    coarse_steps: Annotated[int, Field(ge=0), BUDGET] = 5
    """Steps in the distance field, on ``points`` returns."""
    near_share: Annotated[Share, BY_HAND] = 0.95
    """A prediction that explains this share of a scan is not drawn in: those steps let the target slide along
    what its faces leave open."""
    fine_steps: Annotated[Count, BUDGET] = 3
    """Steps to the faces, on all returns."""
    widest_m: Annotated[Positive, BY_HAND] = 1.0
    """Scale beyond which a return is an outlier, of the first step."""
    narrowest_m: Annotated[
        Positive, Provenance("paper", "2015 paper, Table 1: outliers of four times sigma_RANGE, 25 mm")
    ] = 0.1
    """The same of the last step; it covers 4-sigma outliers."""
    steep_cosine: Annotated[float, Field(ge=0, le=1), BY_HAND] = 0.55
    """Of the incidence on a face, below which the distance from its plane tells outliers, not that along the
    ray: a steep face would else lose all its returns by the least error of its place."""
    outline_m: Annotated[Positive, BY_HAND] = 0.05
    """Standard deviation of the distance of a return that lies beyond the outline."""
    min_points: Annotated[int, Field(ge=6), UNKNOWNS] = 6
    """Fewer returns, or fewer of them on faces, are no registration."""
    unobserved_m: Annotated[Positive, WIDE_PRIOR] = 1.0
    """Standard deviation of a position that no face determines."""
    unobserved_deg: Annotated[Positive, WIDE_PRIOR] = 20.0
    """Standard deviation of a rotation that no face determines."""
    model: ScanModelConfig = ScanModelConfig()
    """Of the scans."""
    verdict: ScanVerdictConfig = ScanVerdictConfig()
    """When a registration explains its scan."""


class ProjectiveIcpConfig(MethodConfig):
    """Tracking by casting the target: each return against the face that its own ray meets."""

    kind: str = "projective_point_to_plane"
    """Selects this method."""
    tuning: ProjectiveIcpTuning = ProjectiveIcpTuning()
    """Limits and numbers that are no part of the promise; change them only to study the method."""


class SearchLevelConfig(Tuning):
    """One pass of the search."""

    attitudes: Count
    """Spread over all of SO(3), each compared with some of the scan."""
    compared: Count
    """Of them, the best ones that are compared with more of it."""
    refined: Count
    """Of those, the best ones that are drawn onto the scan."""


class GlobalSearchTuning(Tuning):
    """Numbers of candidates and limits of the global search."""

    levels: Annotated[
        tuple[SearchLevelConfig, ...],
        Provenance("hand, mock-up", "numbers of attitudes chosen by time and success on emulated scans"),
    ] = Field(
        default=(
            SearchLevelConfig(attitudes=900, compared=120, refined=16),
            SearchLevelConfig(attitudes=2000, compared=200, refined=20),
            SearchLevelConfig(attitudes=12000, compared=1500, refined=150),
        ),
        min_length=1,
    )
    """The next one is entered where the one before found nothing that explains the scan; scans of less than
    ``sure_returns`` begin with the second."""
    model_points: Annotated[Count, BUDGET] = 240
    """Surface points that stand for the target while attitudes are compared."""
    truncation_m: Annotated[Positive, BY_HAND] = 1.5
    """Distances beyond this cost no more."""
    coarse_points: Annotated[Count, BUDGET] = 128
    """Returns that candidates are drawn in on."""
    coarse_steps: Annotated[Count, BUDGET] = 6
    """Steps in the distance field, of each candidate."""
    most_returns: Annotated[Count, BUDGET] = 900
    """Scans with more are thinned by rows and columns."""
    sure_returns: Annotated[Count, BY_HAND] = 60
    """From so many returns on, the first candidate that explains them for sure ends the search: its actual
    log likelihood exceeds what is expected by ..."""
    sure_surplus: Annotated[NonNegative, BY_HAND] = 0.3
    """... this much a return."""
    sufficient_returns: Annotated[int, Field(ge=0), BY_HAND] = 70
    """Of scans with fewer the outline is searched too, once the best poses are drawn in; of others only for
    poses that explain them halfway, and where the best has a rival."""
    rival_log_likelihood: Annotated[Positive, BY_HAND] = 25.0
    """Poses that are behind the best by no more are its rivals."""
    siblings: Annotated[Count, BY_HAND] = 2
    """Best distinct poses that must have been turned; the best one alone where it is sure."""
    turned: Annotated[Count, BY_HAND] = 5
    """Most poses that are turned on the way there."""
    turns: Annotated[Count, BY_HAND] = 6
    """Best turns of each, by quarters about the axes and by near-symmetries, that are drawn onto the scan."""
    finished: Annotated[Count, BY_HAND] = 4
    """Best distinct poses that are finished."""
    distinct_deg: Annotated[NonNegative, BY_HAND] = 5.0
    """Poses whose attitudes differ by less are one."""
    min_points: Annotated[int, Field(ge=6), UNKNOWNS] = 6
    """Scans with fewer returns are not searched."""
    ambiguous_weight: Annotated[float, Field(gt=0.5, lt=1), BY_HAND] = 0.95
    """Below this weight of the best hypothesis the result is ambiguous."""
    near_deg: Annotated[Positive, BY_HAND] = 45.0
    """How far attitudes may be from a pose that is known roughly, where only that is searched."""


class GlobalSearchConfig(MethodConfig):
    """Search over all attitudes by predicted against measured scans."""

    kind: str = "global"
    """Selects this method."""
    tracking: ProjectiveIcpConfig = ProjectiveIcpConfig()
    """Tracker that refines the result, and the statistics of the scans."""
    tuning: GlobalSearchTuning = GlobalSearchTuning()
    """Limits and numbers that are no part of the promise; change them only to study the method."""
