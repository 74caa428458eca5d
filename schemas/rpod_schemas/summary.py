"""``summary.json``: the results of a run in numbers (ICD section 6).

A value is null where it is not known, and so is a block of which nothing is known: latency where the
clock is not the wall's, errors where there is no truth.
"""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from rpod_schemas.config.base import Config, NonNegative, Share

Count = Annotated[int, Field(ge=0)]


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and value != value else value  # noqa: PLR0124 - NaN


Known = Annotated[NonNegative | None, BeforeValidator(_known)]
"""A number, or null where it is not known; NaN is not known."""
KnownShare = Annotated[Share | None, BeforeValidator(_known)]
"""A share, or null where it is not known."""


class FrameCount(Config):
    """The messages of one topic."""

    published: Count
    """By all its publishers while the log was open."""
    logged: Count
    """In the log."""
    missed: Count
    """Published and not in the log."""


class EstimateCount(Config):
    """Counts of frames and estimates."""

    count: Count
    """Estimates in the log."""
    accepted: Count
    """Frames whose measurement was accepted."""
    rejected: Count
    """Frames whose measurement was rejected, with a reason in their status."""
    dropped: Count
    """Frames that the estimator passed over in favour of newer ones, complete or not."""
    unscored: Count
    """Estimates without truth at their stamp."""
    lost_s: NonNegative
    """Time in LOST or ACQUIRING after the first acquisition."""


class ErrorSize(Config):
    """Size of an error over the tracked frames."""

    rms: NonNegative
    """Root mean square."""
    p95: NonNegative
    """95th percentile."""
    max: NonNegative
    """Greatest value."""


class ErrorSummary(Config):
    """Estimate against truth in the tracked frames (ICD section 1, Errors)."""

    attitude_deg: ErrorSize
    """Angle of Log(R_truth^T R_estimate)."""
    position_m: ErrorSize
    """Length of the translation error."""
    roll_deg_rms: NonNegative
    """About the target's x."""
    pitch_deg_rms: NonNegative
    """About the target's y."""
    yaw_deg_rms: NonNegative
    """About the target's z."""
    x_m_rms: NonNegative
    """Along the sensor's x, right."""
    y_m_rms: NonNegative
    """Along the sensor's y, down."""
    z_m_rms: NonNegative
    """Along the sensor's boresight."""


class Durations(Config):
    """Statistics of durations."""

    p50: float
    """The median."""
    p99: float
    """99th percentile."""
    max: float
    """The longest."""


class Consistency(Config):
    """Consistency of the covariance with the errors."""

    nees_mean: NonNegative
    """Mean normalised estimation error squared; 6 where the covariance is right."""
    nees_share_in_95: Share
    """Share at or below 12.59, the 95 % quantile of chi-squared with six degrees of freedom."""


class Innovation(Config):
    """Consistency of the innovations with their covariances."""

    nis_mean: NonNegative
    """Mean normalised innovation squared; 6 where the covariances are right."""
    nis_share_in_95: Share
    """Share at or below 12.59, the 95 % quantile of chi-squared with six degrees of freedom."""


class LogCompleteness(Config):
    """Completeness of the log, checked against its contents."""

    complete: bool | None
    """Whether all that was published while it was open is in it; null where it does not say."""
    reasons: tuple[str, ...]
    """Reasons why the log is not complete, a sentence each."""


class Tracking(Config):
    """How well the target was held."""

    first_tracking_s: Known
    """From the first stamp of the run to the first frame in TRACKING."""
    tracking_share: KnownShare
    """Share of the frames in TRACKING, from the first such frame on."""
    worse_than_10deg_or_0_3m_share: KnownShare
    """Share of the tracked frames whose attitude error exceeds 10 degrees or position error 0.3 m."""


class Summary(Config):
    """``summary.json``."""

    scenario: str | None
    """Name of the scenario."""
    seed: Count | None
    """Seed of all noise."""
    duration_s: NonNegative
    """From the first to the last stamp of truth and estimator."""
    log: str
    """The log's file, the first one where there are several."""
    logs: tuple[str, ...]
    """All files of the log, in the order of time."""
    report: str | None
    """The report's file."""
    frames: dict[str, FrameCount]
    """Counts of messages by topic."""
    estimates: EstimateCount
    """Counts of frames and estimates."""
    modes: Tracking
    """How well the target was held."""
    error: ErrorSummary | None
    """Over the tracked frames."""
    latency_s: Durations | None
    """From stamp to publication of the estimates."""
    processing_s: Durations | None
    """From the arrival of a frame's last part to publication."""
    consistency: Consistency | None
    """Over the tracked frames with a covariance."""
    innovation: Innovation | None = None
    """Innovations of all frames whose measurement was compared with the prediction, also rejected ones."""
    completeness: LogCompleteness | None = None
    """Completeness of the log."""
    unreadable: dict[str, dict[str, Count]] = Field(default_factory=dict)
    """Messages in the log that cannot be read, by topic, then by reason."""

    @property
    def missed(self) -> int:
        """Messages of all topics that were published and are not in the log."""
        return sum(count.missed for count in self.frames.values())


class Comparison(Config):
    """``comparison.json``: several runs side by side."""

    report: str
    """The page that compares them."""
    runs: tuple[Summary, ...]
    """In the order in which they were given."""
