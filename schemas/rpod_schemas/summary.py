"""``summary.json``: the results of a run in numbers (ICD section 6).

An unknown value is null, and so is a block without known values: latency if the clock is not the wall clock,
errors without truth.
"""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from rpod_schemas.config.base import Config, NonNegative, Share

Count = Annotated[int, Field(ge=0)]


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and value != value else value  # noqa: PLR0124 - NaN


Known = Annotated[NonNegative | None, BeforeValidator(_known)]
"""A number, or null if it is unknown; NaN is unknown."""
KnownShare = Annotated[Share | None, BeforeValidator(_known)]
"""A share, or null if it is unknown."""


class FrameCount(Config):
    """Numbers of messages of one topic."""

    published: Count
    """Number of messages from all publishers while the log was open."""
    logged: Count
    """Number of messages in the log."""
    missed: Count
    """Number of messages that were published but are not in the log."""


class LostFrames(Config):
    """Frames that the estimator did not use for one kind of reason."""

    frames: Count
    """Number of frames."""
    last: str
    """The last reason, with its figures and the remedy."""


class InputAccount(Config):
    """Numbers of a sensor's frames by their outcome at the estimator, as it counts them."""

    used: Count
    """Number of frames whose measurement was accepted."""
    not_used: dict[str, LostFrames]
    """Frames that were not used, by kind of reason."""


class BodyAccount(Config):
    """Checks of a known body's pose by the frames of a sensor, as the estimator reports them."""

    in_place: Count = 0
    """Number of frames that show it where its pose says."""
    elsewhere: Count = 0
    """Number of frames that do not, although it must be seen there."""
    unseen: Count = 0
    """Number of frames in which it gives no ranges, so that it is not checked."""
    hidden: Count = 0
    """Number of frames in which too little of it is visible to decide."""
    last: str = ""
    """The last sentence that reported it to the operator, with figures and remedy."""


class EstimateCount(Config):
    """Numbers of frames and estimates."""

    count: Count
    """Number of estimates in the log."""
    accepted: Count
    """Number of frames whose measurement was accepted."""
    rejected: Count
    """Number of frames whose measurement was rejected, with a reason in their status."""
    dropped: Count
    """Number of frames that the estimator passed over in favour of newer ones, complete or not."""
    unscored: Count
    """Number of estimates without truth at their stamp."""
    lost_s: NonNegative
    """Time in LOST or ACQUIRING after the first acquisition, s."""


class ErrorSize(Config):
    """Size of an error over the tracked frames."""

    rms: NonNegative
    """Root mean square."""
    p95: NonNegative
    """95th percentile."""
    max: NonNegative
    """Largest value."""


class ErrorSummary(Config):
    """Errors of the estimates in the tracked frames (ICD section 1, Errors)."""

    attitude_deg: ErrorSize
    """Angle of Log(R_truth^T R_estimate), deg."""
    position_m: ErrorSize
    """Length of the position error, m."""
    roll_deg_rms: NonNegative
    """RMS attitude error about the target's x, deg."""
    pitch_deg_rms: NonNegative
    """RMS attitude error about the target's y, deg."""
    yaw_deg_rms: NonNegative
    """RMS attitude error about the target's z, deg."""
    x_m_rms: NonNegative
    """RMS position error along the sensor's x, right, m."""
    y_m_rms: NonNegative
    """RMS position error along the sensor's y, down, m."""
    z_m_rms: NonNegative
    """RMS position error along the sensor's boresight, m."""


class TruthError(Config):
    """Errors of the truth itself at the tracked frames, by the covariance that it states."""

    attitude_deg_rms: NonNegative
    """RMS angle of the truth's attitude error, deg."""
    position_m_rms: NonNegative
    """RMS length of the truth's position error, m."""
    attitude_share: Share
    """Part of the mean squared attitude error that may be the truth's; at 1 the error carries no information
    about the estimates."""
    position_share: Share
    """Part of the mean squared position error that may be the truth's."""


class FrameError(Config):
    """Errors of a frame that the target's file names, in the tracked frames of the sensors."""

    attitude_deg: ErrorSize
    """Angle of the attitude error, deg."""
    position_m: ErrorSize
    """Length of the position error at the frame's place, lever arm included, m."""


class Durations(Config):
    """Statistics of durations, s."""

    p50: float
    """Median, s."""
    p99: float
    """99th percentile, s."""
    max: float
    """Largest value, s."""


class Consistency(Config):
    """Consistency of the covariance with the errors."""

    nees_mean: NonNegative
    """Mean normalised estimation error squared; its degrees of freedom if the covariance is right."""
    nees_dof: int = 6
    """Degrees of freedom: 6, 5 if the target has a free axis, or 3 if it is a sphere."""
    nees_share_in_95: Share
    """Share at or below the 95 % quantile of chi-squared: 12.59, or 11.07 and 7.81 with 5 and 3 degrees of
    freedom."""


class Innovation(Config):
    """Consistency of the innovations with their covariances."""

    nis_mean: NonNegative
    """Mean normalised innovation squared; its degrees of freedom if the covariances are right."""
    nis_dof: int = 6
    """Degrees of freedom, as for the NEES."""
    nis_share_in_95: Share
    """Share at or below the 95 % quantile of chi-squared."""


class IntegrityCount(Config):
    """Integrity of the estimates as the estimator stated it, compared with the truth."""

    misleading: Count | None
    """Number of estimates with an error above its protection level while the state was nominal or caution;
    null without truth."""
    alerts: Count
    """Number of times that the state became alert."""
    availability: KnownShare
    """Share of the results, from the first estimate on, with both levels below the alert limits."""


class MountDifference(Config):
    """Error of one sensor's stated mount less that of another, as estimated last, chaser axes.

    It does not say which of the two is wrong. Along the line of sight it contains the offset of the ranges.
    """

    position_m: tuple[float, float, float]
    """Difference of the places, m."""
    position_sigma_m: tuple[NonNegative, NonNegative, NonNegative]
    """Its standard deviations, m."""
    attitude_deg: tuple[float, float, float]
    """Difference of the attitudes, a rotation vector, deg."""
    attitude_sigma_deg: tuple[NonNegative, NonNegative, NonNegative]
    """Its standard deviations, deg."""

    @property
    def text(self) -> str:
        """The difference in words, with its standard deviations."""
        place = _with_sigmas(self.position_m, self.position_sigma_m, 1e3, ".1f")
        turn = _with_sigmas(self.attitude_deg, self.attitude_sigma_deg, 1.0, ".3f")
        return f"{place} mm, {turn} deg along the chaser's x, y, z; which of them is wrong is not known"


def _with_sigmas(values: tuple[float, ...], sigmas: tuple[float, ...], scale: float, form: str) -> str:
    pairs = zip(values, sigmas, strict=True)
    return ", ".join(f"{scale * value:{form}} (sigma {scale * sigma:{form}})" for value, sigma in pairs)


class LogCompleteness(Config):
    """Completeness of the log, checked against its contents."""

    complete: bool | None
    """Whether the log contains all messages that were published while it was open; null if it does not state
    this."""
    reasons: tuple[str, ...]
    """Reasons why the log is not complete, a sentence each."""
    unconfirmed: tuple[str, ...] = ()
    """Publishers of other software that ended without stating their last number, a sentence each; this does
    not make the log incomplete."""


class Tracking(Config):
    """Shares of time and frames in TRACKING, and of the wrong frames among them.

    Time runs from the estimator's first status to its last; a mode lasts until the next status.
    """

    tracked_time_share: KnownShare = None
    """Share of the time in TRACKING."""
    longest_untracked_s: Known = None
    """Longest time without a track, s, before the first one and at the end too."""
    first_tracking_s: Known
    """Time from the first stamp of the run to the first frame in TRACKING, s."""
    tracking_share: KnownShare
    """Share of the frames in TRACKING, from the first such frame on."""
    coasting_share: KnownShare = None
    """Share of the frames in COASTING, from the first frame in TRACKING on: predictions within the alert
    limit."""
    worse_than_10deg_or_0_3m_share: KnownShare
    """Share of the tracked frames whose attitude error exceeds 10 degrees or position error 0.3 m."""


class Handover(Config):
    """Handovers from one sensor to another, the worst of them."""

    count: Count
    """Number of handovers."""
    gap_s: NonNegative
    """Longest time from the last accepted frame of another sensor to the first of the new one, s."""
    jump_m: Known
    """Largest change of the position error between successive estimates around a handover, as far as it
    exceeds the covariance of the earlier one, m; null without truth."""
    jump_deg: Known
    """The same of the attitude error, deg."""
    change_m: Known = None
    """Largest such change as a whole, m."""
    change_deg: Known = None
    """The same of the attitude error, deg."""


class FaultOutcome(Config):
    """A fault that was injected, and what navigation did during it."""

    fault: str
    """Name in the catalogue of faults."""
    where: str
    """Name of the sensor or service; empty for all sensors, or for the logger's disk."""
    size: float | None
    """Size in the catalogue's unit; null if it has none, or if it was drawn."""
    begin_s: float
    """Begin, s from the start of the run."""
    end_s: float | None
    """End, s from the start of the run; null if it lasted until the end."""
    frames: Count
    """Number of frames with a status during the fault."""
    tracking_share: KnownShare
    """Share of these frames in TRACKING."""
    coasting_share: KnownShare
    """Share of these frames in COASTING."""
    lost_after_s: Known
    """Time from the begin to the first frame in LOST or ACQUIRING; null if the track was not lost."""
    tracking_again_s: Known
    """Time from the end to the first accepted frame in TRACKING; null if there was none."""
    wrong_accepted: Count | None
    """Number of tracked estimates during the fault that are more than 10 deg or 0.3 m off; null if none could
    be scored."""
    worst_deg: Known
    """Largest attitude error of the tracked estimates during the fault, deg."""
    worst_m: Known
    """Largest position error of them, m."""


class Summary(Config):
    """Contents of ``summary.json``."""

    scenario: str | None
    """Name of the scenario."""
    target: str | None = None
    """Name or file of the target that moved and that was seen, the truth; null if no service emulated it."""
    model: str | None = None
    """Name or file of the target that the estimator looked for."""
    seed: Count | None
    """Seed of all noise."""
    duration_s: NonNegative
    """Time from the first to the last stamp of truth and estimator, s."""
    log: str
    """Path of the log, the first file if there are several."""
    logs: tuple[str, ...]
    """Paths of all files of the log, in the order of time."""
    report: str | None
    """Path of the report."""
    frames: dict[str, FrameCount]
    """Numbers of messages by topic."""
    estimates: EstimateCount
    """Numbers of frames and estimates."""
    inputs: dict[str, InputAccount] = Field(default_factory=dict)
    """Frames by their outcome at the estimator, by sensor."""
    bodies: dict[str, dict[str, BodyAccount]] = Field(default_factory=dict)
    """Checks of known bodies by the sensors' frames, by body, then by sensor."""
    modes: Tracking
    """Shares of tracking."""
    error: ErrorSummary | None
    """Errors over the tracked frames."""
    truth_error: TruthError | None = None
    """Errors of the truth itself; null if it states no covariance."""
    frame_errors: dict[str, FrameError] = Field(default_factory=dict)
    """Errors at the target's named frames, by name."""
    joint_errors: dict[str, ErrorSize] = Field(default_factory=dict)
    """Errors of the angles of the target's joints while tracked, deg, by name."""
    latency_s: Durations | None
    """Times from the stamps of the estimates to the first publication at each stamp, s."""
    processing_s: Durations | None
    """Times from the arrival of a frame's last part to publication, s."""
    consistency: Consistency | None
    """Consistency over the tracked frames with a covariance."""
    innovation: Innovation | None = None
    """Innovations of all frames whose measurement was compared with the prediction, including rejected
    ones."""
    handover: Handover | None = None
    """Handovers from one sensor to another; null if there was none."""
    integrity: IntegrityCount | None = None
    """Integrity of the estimates; null for a log without it."""
    mounts: dict[str, MountDifference] = Field(default_factory=dict)
    """Differences between the mounts of two sensors, by ``<one> and <other>``; empty where the estimator does
    not estimate mounts."""
    faults: tuple[FaultOutcome, ...] = ()
    """Faults that were injected, in the order of their beginning."""
    completeness: LogCompleteness | None = None
    """Completeness of the log."""
    unreadable: dict[str, dict[str, Count]] = Field(default_factory=dict)
    """Numbers of messages in the log that cannot be read, by topic, then by reason."""

    @property
    def differing_model(self) -> str | None:
        """Model of the target, if it is not the target itself."""
        return None if self.target in (self.model, None) else self.model

    @property
    def missed(self) -> int:
        """Number of messages of all topics that were published but are not in the log."""
        return sum(count.missed for count in self.frames.values())


class Comparison(Config):
    """Contents of ``comparison.json``: several runs side by side."""

    report: str
    """Path of the page that compares them."""
    runs: tuple[Summary, ...]
    """Summaries of the runs, in the given order."""
