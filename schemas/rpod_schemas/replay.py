"""Result of a replay of a log: the new estimates compared with the old ones."""

from pydantic import Field

from rpod_schemas.config.base import Config, NonNegative
from rpod_schemas.summary import (
    Consistency,
    Count,
    Durations,
    ErrorSize,
    ErrorSummary,
    IntegrityCount,
    Tracking,
)


class Side(Config):
    """Results of one of the two estimator runs over the same log."""

    frames: Count
    """Number of frames that the estimator answered with a status."""
    estimates: Count
    """Number of odometry messages."""
    accepted: Count
    """Number of frames whose measurement was accepted."""
    lost_s: NonNegative
    """Time in LOST or ACQUIRING after the first acquisition, s."""
    modes: Tracking
    """Shares of tracking."""
    error: ErrorSummary | None
    """Errors over the tracked frames; null without truth."""
    consistency: Consistency | None
    """Consistency over the tracked frames with truth and a covariance."""
    integrity: IntegrityCount | None = None
    """Misleading estimates, alerts and availability; null for a log without integrity."""


class Difference(Config):
    """Differences between new and old poses at the same stamps."""

    common: Count
    """Number of stamps at which both have an estimate."""
    identical: Count
    """Number of these stamps with identical poses."""
    attitude_deg: ErrorSize
    """Angle between the two poses, deg."""
    position_m: ErrorSize
    """Distance between the two poses, m."""


class ReplayReport(Config):
    """Object that ``rpod replay --json`` prints."""

    log: str
    """Path of the replayed log, the first file if there are several."""
    out: str
    """Path of the new log with truth, old estimates, and new ones under ``replay``."""
    replaced: bool = False
    """Whether an older file was replaced by it."""
    as_live: bool
    """Whether exactly the frames of the live run were used."""
    frames: Count
    """Number of frames given to the estimator."""
    missing: Count
    """Number of frames that the live run used and that the log does not contain."""
    refused: dict[str, int]
    """Number of messages that could not be used, by topic."""
    second_publisher: dict[str, int] = Field(default_factory=dict)
    """Number of messages that were not used because another publisher held the topic, by topic."""
    undivided: dict[str, int] = Field(default_factory=dict)
    """Number of publishers of each topic whose messages the log does not distinguish: all are used."""
    resets: Count = 0
    """Number of logged resets that were repeated."""
    unknown_resets: Count = 0
    """Number of logged resets whose request is not in the log, so that they were not repeated."""
    processing_s: Durations | None
    """Processing time of the frames given to the estimator, s, on this machine."""
    old: Side | None
    """Results of the log's estimator; null if there was none."""
    new: Side | None
    """Results of the replay's estimator; null if there was no frame."""
    difference: Difference | None
    """Difference of the two; null if there is no common stamp."""
