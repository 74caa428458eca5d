"""Parameters of the global search in LIDAR scans, and of the tracker that ray-casts the target."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import Count, NonNegative, Positive, Share
from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.config.tuning import (
    BUDGET,
    BY_HAND,
    FIRST_STEP,
    GRID,
    ONE_IN_TWENTY,
    POPULATION_LIDAR,
    UNKNOWN_ANGLE,
    UNKNOWNS,
    Limit,
    Provenance,
    Tuning,
)


class ScanModelConfig(Tuning):
    """Assumed statistics of a scan, which neither the sensor states nor the scan shows."""

    sigma_range_m: Annotated[
        Positive | None, Provenance("physics", "the sensor's own message, if it states one")
    ] = None
    """Standard deviation of a range, m; None for the one that the sensor states, or 0.05 m if it states
    none."""
    noise_scale: Annotated[Positive, Provenance("physics", "the sensor's own message is taken as it is")] = (
        1.0
    )
    """Ratio of the assumed standard deviation of a range to ``sigma_range_m``."""
    least_range_m: Annotated[
        Positive, Provenance("physics", "LIDARs for rendezvous state larger ranges in their data sheets")
    ] = 100.0
    """Least range from which a white surface at normal incidence returns every other pulse, m. No sensor is
    assumed to be weaker."""
    surest_detection: Annotated[
        Annotated[float, Field(gt=0, lt=1)],
        Provenance("hand, mock-up", "a prior: holes, edges and mirrors lose a few rays of any sensor"),
    ] = 0.95
    """Largest expected probability that a ray which meets the target returns: holes, edges and mirrors lose
    returns, and the brightness of a surface does not show that."""
    slack_sigmas: Annotated[
        Positive,
        Provenance("hand, mock-up", "8 mm beside the documented LIDAR's 25 mm: less than a scan can show"),
    ] = 0.32
    """Standard deviation of the target's faces about their model, in those of a range; ``slack_share`` limits
    it."""
    slack_share: Annotated[
        Share, Provenance("physics", "models of satellites are right within 1 to 3 % of their size")
    ] = 0.01
    """Largest standard deviation of the faces about their model, as a share of the target's radius."""
    clutter_share: Annotated[float, Field(gt=0, lt=1), BY_HAND] = 0.02
    """Share of rays whose return, or missing return, carries no information."""
    clutter_depth_m: Annotated[
        Positive,
        Provenance(
            "hand, mock-up",
            "a length of the beam, in which clutter may lie anywhere; only its logarithm counts",
        ),
    ] = 20.0
    """Depth over which such returns are spread, m."""


class PessimisticConfig(Tuning):
    """Values that replace the fields of the same names in a scan's model, for a worse sensor or target."""

    noise_scale: Annotated[
        Positive, Provenance("hand, mock-up", "twice the error that the sensor states; the factor is chosen")
    ] = 2.0
    """Ratio of the assumed standard deviation of a range to ``sigma_range_m``."""
    slack_sigmas: Annotated[Positive, BY_HAND] = 1.2
    """Standard deviation of the target's faces about their model, in those of a range."""
    slack_share: Annotated[
        Share, Provenance("physics", "models of satellites are right within 1 to 3 % of their size")
    ] = 0.03
    """Largest such standard deviation, as a share of the target's radius."""
    clutter_share: Annotated[float, Field(gt=0, lt=1), BY_HAND] = 0.05
    """Share of rays whose return, or missing return, carries no information."""


class ScanAcceptanceConfig(Tuning):
    """Limits of likelihood and of agreeing rays within which a pose explains a scan.

    The limits must hold with the scan's model or with the pessimistic one, because materials, noise and
    target are never known exactly.
    """

    max_deficit: Annotated[NonNegative, Limit("deficit_sigmas"), POPULATION_LIDAR] = 0.83
    """Largest deficit, expected minus actual log likelihood, in its standard deviations."""
    inconsistent_share: Annotated[Share, Limit("disagreeing_share"), POPULATION_LIDAR] = 0.05
    """Share of rays that may be inconsistent with the pose or missing; two standard deviations of their
    number are added, which matter if returns are few."""
    pessimistic: PessimisticConfig = PessimisticConfig()
    """Model of a sensor with larger errors than it states, and of a target that differs from its file."""


class ProjectiveIcpTuning(Tuning):
    """Steps, scales and limits of the tracker that ray-casts the target."""

    points: Annotated[Count, BUDGET] = 100
    """Number of returns that the coarse steps use."""
    coarse_steps: Annotated[int, Field(ge=0), BUDGET] = 5
    """Number of coarse steps, which align ``points`` returns in the distance field."""
    near_share: Annotated[Share, BY_HAND] = 0.95
    """Share of a scan above which a prediction that explains it needs no coarse steps: they let the target
    slide in directions that its faces leave undetermined."""
    sure_surplus: Annotated[NonNegative, BY_HAND] = 0.3
    """Excess of the actual over the expected log likelihood, for each return, above which the faces alone are
    sufficient, if they determine all motions."""
    fine_steps: Annotated[Count, BUDGET] = 3
    """Number of fine steps, which align all returns with the faces."""
    widest_share: Annotated[Positive, FIRST_STEP] = 0.05
    """Distance above which a return is an outlier in the first step, as a share of the target's radius; never
    below that of the last step."""
    narrowest_sigmas: Annotated[
        Positive,
        Provenance(
            "physics", "one in 16,000 normal errors is larger; with 3 and 5, 400 scans had the same errors"
        ),
    ] = 4.0
    """Distance above which a return is an outlier in the last step, in standard deviations of a range."""
    steep_cosine: Annotated[float, Field(ge=0, le=1), BY_HAND] = 0.55
    """Cosine of incidence on a face below which outliers are found by their distance from its plane, not by
    that along the ray: otherwise a small error of its position would reject all returns of a steep face."""
    outline_sigmas: Annotated[Positive, BY_HAND] = 2.0
    """Standard deviation of the distance of a return beyond the outline, in those of a range."""
    min_points: Annotated[int, Field(ge=6), UNKNOWNS] = 6
    """Least number of returns, and of returns on faces, of a registration."""
    unobserved_deg: Annotated[Positive, UNKNOWN_ANGLE] = 104.0
    """Standard deviation of a rotation that neither faces nor outline determine, deg. That of a position is
    the target's radius."""
    model: ScanModelConfig = ScanModelConfig()
    """Statistics of the scans."""
    acceptance: ScanAcceptanceConfig = ScanAcceptanceConfig()
    """Limits within which a registration explains its scan."""


class ProjectiveIcpConfig(MethodConfig):
    """Tracking by ray casting: each return is aligned with the face that its own ray meets."""

    kind: str = "projective_point_to_plane"
    """Selects this method."""
    tuning: ProjectiveIcpTuning = ProjectiveIcpTuning()
    """Limits and numbers of the method that are outside the public interface; change them only to study
    it."""


class SearchLevelConfig(Tuning):
    """One pass of the search."""

    attitudes: Count
    """Number of attitudes, evenly spread over SO(3), that are compared with a few returns of the scan."""
    compared: Count
    """Number of the best of these attitudes that are compared with more returns."""
    refined: Count
    """Number of the best of these that are aligned with the scan."""


class GlobalSearchTuning(Tuning):
    """Numbers of candidates and limits of the global search."""

    levels: Annotated[tuple[SearchLevelConfig, ...], BUDGET] = Field(
        default=(
            SearchLevelConfig(attitudes=900, compared=120, refined=16),
            SearchLevelConfig(attitudes=2000, compared=200, refined=20),
            SearchLevelConfig(attitudes=12000, compared=1500, refined=150),
        ),
        min_length=1,
    )
    """Passes of the search. The next one begins if the one before found nothing that explains the scan; scans
    with fewer than ``sure_returns`` begin with the second."""
    model_points: Annotated[Count, BUDGET] = 240
    """Number of surface points that represent the target while attitudes are compared."""
    truncation_share: Annotated[Positive, BY_HAND] = 0.07
    """Distance above which the cost is constant, as a share of the target's radius."""
    truncation_sigmas: Annotated[Positive, BY_HAND] = 6.0
    """Least value of this distance, in standard deviations of a range."""
    coarse_points: Annotated[Count, BUDGET] = 128
    """Number of returns with which candidates are coarsely aligned."""
    coarse_steps: Annotated[Count, BUDGET] = 6
    """Number of steps of this alignment, in the distance field, for each candidate."""
    most_returns: Annotated[Count, BUDGET] = 900
    """Number of returns above which rows and columns of a scan are left out."""
    sure_returns: Annotated[Count, BY_HAND] = 60
    """Least number of returns, counted as for ``sufficient_returns``, with which the first candidate that
    surely explains them ends the search: its actual log likelihood exceeds the expected one by
    ``sure_surplus`` for each return."""
    sure_surplus: Annotated[NonNegative, BY_HAND] = 0.3
    """Excess of the actual over the expected log likelihood of a sure candidate, for each return."""
    sufficient_returns: Annotated[int, Field(ge=0), BY_HAND] = 70
    """Least number of returns with which the faces are assumed to determine a pose. In scans with fewer, the
    best poses are refined on the outline and by samples after the alignment. In others, the outline is used
    for poses that explain about half of the scan, and if the best pose has a rival. A return from a target
    smaller than 1,000 standard deviations of a range counts less, by the information that it carries."""
    rival_log_likelihood: Annotated[Positive, BY_HAND] = 25.0
    """Largest difference of log likelihood between the best pose and a rival."""
    siblings: Annotated[Count, BUDGET] = 2
    """Number of best distinct poses whose turns must have been tried; 1 if the best pose is sure."""
    turned: Annotated[Count, BUDGET] = 5
    """Largest number of poses whose turns are tried."""
    turns: Annotated[Count, BUDGET] = 6
    """Number of best turns of each pose that are aligned with the scan: quarter turns about the axes, and
    near-symmetries."""
    finished: Annotated[Count, BUDGET] = 4
    """Number of best distinct poses that are refined to the end."""
    few_finished: Annotated[Count, BUDGET] = 12
    """Number of best distinct poses that are refined to the end if returns are few: all that may be right
    must be known before one is believed."""
    few_turns: Annotated[Count, BUDGET] = 32
    """Number of turns of the best pose that are tried at the end if returns are few."""
    few_closures: Annotated[Count, BUDGET] = 3
    """Largest number of times that this is done, since a turn may be likelier than the pose before it."""
    max_sigma_deg: Annotated[
        Positive, Provenance("physics", "an error of 10 deg has then a probability below 0.5 %")
    ] = 3.5
    """Largest standard deviation of an accepted attitude about its worst axis, deg."""
    distinct_deg: Annotated[NonNegative, GRID] = 5.0
    """Angle between two attitudes, deg, below which their poses are the same."""
    min_points: Annotated[int, Field(ge=6), UNKNOWNS] = 6
    """Least number of returns of a scan that is searched."""
    ambiguous_weight: Annotated[float, Field(gt=0.5, lt=1), ONE_IN_TWENTY] = 0.95
    """Weight of the best hypothesis below which the result is ambiguous."""
    few_weight: Annotated[
        float,
        Field(gt=0.5, lt=1),
        Provenance("physics", "the share of accepted poses that may be wrong"),
    ] = 0.995
    """Weight of the best hypothesis below which the result is ambiguous if returns are few."""
    near_deg: Annotated[Positive, BY_HAND] = 45.0
    """Largest angle of an attitude from a roughly known pose, deg, in a search near that pose."""


class GlobalSearchConfig(MethodConfig):
    """Search over all attitudes that compares predicted scans with the measured one."""

    kind: str = "global"
    """Selects this method."""
    tracking: ProjectiveIcpConfig = ProjectiveIcpConfig()
    """Tracker that refines the result, and the statistics of the scans."""
    tuning: GlobalSearchTuning = GlobalSearchTuning()
    """Limits and numbers of the method that are outside the public interface; change them only to study
    it."""
