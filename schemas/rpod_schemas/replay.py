"""Result of a replay of a log: the new estimates compared with the old ones."""

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
    """Number of these stamps with identical poses."""
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
    """Whether exactly the frames of the live run were used."""
    frames: Count
    """Number of frames given to the estimator."""
    missing: Count
    """Number of frames that the live run used and that the log does not contain."""
    refused: dict[str, int]
    """Messages that could not be used, by topic."""
    processing_s: Durations | None
    """Processing time of the frames given to the estimator, on this machine."""
    old: Side | None
    """Estimator of the log; null if there was none."""
    new: Side | None
    """Estimator of the replay; null if there was no frame."""
    difference: Difference | None
    """Difference of the two; null if there is no common stamp."""
