"""What a replay of a log came to: the new estimates beside the old."""

from rpod_schemas.config.base import Config, NonNegative
from rpod_schemas.summary import Consistency, Count, Durations, ErrorSize, ErrorSummary, Tracking


class Side(Config):
    """One of the two runs of an estimator over the same log."""

    frames: Count
    """Frames that it answered with a status."""
    estimates: Count
    """Odometry messages."""
    accepted: Count
    """Frames whose measurement was accepted."""
    lost_s: NonNegative
    """Time in LOST or ACQUIRING after the first acquisition."""
    modes: Tracking
    """How well the target was held."""
    error: ErrorSummary | None
    """Over the tracked frames; null where there is no truth."""
    consistency: Consistency | None
    """Over the tracked frames with truth and a covariance."""


class Difference(Config):
    """New poses against old ones at the same stamps."""

    common: Count
    """Stamps at which both have an estimate."""
    identical: Count
    """Of them, those with the very same pose."""
    attitude_deg: ErrorSize
    """Angle between the two."""
    position_m: ErrorSize
    """Distance between the two."""


class ReplayReport(Config):
    """``rpod replay --json``."""

    log: str
    """The log that was replayed, the first file where there are several."""
    out: str
    """The new log: truth, old estimates, and new ones under ``replay``."""
    as_live: bool
    """Whether just the frames were taken that the live run took."""
    frames: Count
    """Handed to the estimator."""
    missing: Count
    """Frames that the live run took and the log has not."""
    refused: dict[str, int]
    """Messages that could not be used, by topic."""
    processing_s: Durations | None
    """Of the frames handed to the estimator, on this machine."""
    old: Side | None
    """As logged; null where no estimator was."""
    new: Side | None
    """As replayed; null where there was no frame."""
    difference: Difference | None
    """Null where there is no common stamp."""
