"""Errors of this package. Each text is one line and contains the remedy where there is one."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from rpod_schemas.errors import RpodError
from rpod_schemas.logs import Recovery


class AnalysisError(RpodError):
    """Root of the errors that this package raises."""


class NoLogError(AnalysisError):
    """The file does not exist, or it cannot be read."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")


class NotMcapError(AnalysisError):
    """The file is not an MCAP log."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: is not an MCAP log; give the .mcap file of a run, or its folder")


class DifferentRunsError(AnalysisError):
    """Files that are to be read as one log are of different runs."""

    def __init__(self, first: Path, second: Path, topic: str) -> None:
        super().__init__(
            f"{second}: is of another run than {first}: both have {topic}, and no publisher in common; give "
            "the files of one run, or 'rpod report' the files by their names, which compares runs"
        )


class NothingRecoveredError(AnalysisError):
    """A damaged log holds no message that can be recovered."""

    def __init__(self, recovery: Recovery) -> None:
        self.recovery = recovery
        orphans = f"; {recovery.without_definition} messages lack the definition of their channel"
        limit = (
            f"; {recovery.chunks_over_limit} chunks announce too many bytes and were not read: if you trust "
            "the file, repeat with --no-limits"
        )
        super().__init__(
            f"{recovery.source}: no message can be recovered of its {recovery.size_bytes} bytes, of which "
            f"{recovery.unreadable_bytes} could not be read; no log is written"
            f"{orphans if recovery.without_definition else ''}{limit if recovery.chunks_over_limit else ''}"
        )


class TruncatedLogError(AnalysisError):
    """The log was not closed, so that it has no index."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: the log is truncated; 'rpod recover {path}' writes a readable one")


class DamagedLogError(AnalysisError):
    """The log has damaged bytes."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(
            f"{path}: the log is damaged ({reason}); 'rpod recover {path}' saves its undamaged records"
        )


class LogLimitError(AnalysisError):
    """A log announces more than a limit allows."""

    def __init__(self, path: Path, what: str, found: int, most: int) -> None:
        super().__init__(
            f"{path}: {found:,} {what}, at most {most:,} are read; "
            "if you trust the file, repeat with --no-limits"
        )


class CannotWriteError(AnalysisError):
    """A file cannot be written."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")


class BeyondEndError(AnalysisError):
    """Playing begins after the end of the log."""

    def __init__(self, path: Path, start_s: float, length_s: float) -> None:
        super().__init__(
            f"{path}: ends after {length_s:.1f} s, before --from {start_s:g}; give an earlier time"
        )


class NoSensorDataError(AnalysisError):
    """The log has no frames of the configured sensors."""

    def __init__(self, path: Path, wanted: Sequence[str], others: Sequence[str]) -> None:
        held = f"it holds {', '.join(others)}" if others else "it holds no images and no points"
        super().__init__(
            f"{path}: holds no message of {', '.join(wanted)}, where the configured sensors have their "
            f"frames; {held}; name the topics of this log under sensors.0.source.topics, with --config"
        )


class NothingReplayedError(AnalysisError):
    """No frame of a log was replayed."""

    def __init__(self, path: Path, *, as_live: bool) -> None:
        why = (
            "it has no statuses of a run that used its frames; leave out --as-live"
            if as_live
            else "none of its frames is complete, in the time from --from to --to"
        )
        super().__init__(f"{path}: no frame was replayed: {why}")


class NoEstimatesError(AnalysisError):
    """The log contains no estimates."""

    def __init__(self, path: Path, prefix: str) -> None:
        super().__init__(
            f"{path}: no estimates in the log ({prefix}/odometry, {prefix}/status); "
            "'rpod replay' computes them from its sensor data"
        )


class NoEstimatorError(AnalysisError):
    """A log does not contain the configuration of an estimator."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: no configuration of an estimator in the log; give one with --config")


class NothingToPlayError(AnalysisError):
    """No topic of a log matches the topics to play."""

    def __init__(self, path: Path, patterns: Sequence[str]) -> None:
        matching = f" matches {', '.join(patterns)}; choose others with --topics" if patterns else ""
        super().__init__(f"{path}: no topic of a known type in the log{matching}")


class FramesDifferError(AnalysisError):
    """Truth and estimates are given in different frames of reference.

    Args:
        path: the log.
        topics: a topic with poses in each frame of reference, by the frame.
    """

    def __init__(self, path: Path, topics: Mapping[str, str]) -> None:
        told = ", ".join(f"{topic} in frame {frame_id!r}" for frame_id, topic in topics.items())
        super().__init__(f"{path}: {told}; both must be in one frame: correct header.frame_id of a publisher")


class CalibrationError(AnalysisError):
    """The logs do not determine a calibration."""


class NoFramesError(CalibrationError):
    """A log has no frame of any sensor."""

    def __init__(self, log: str) -> None:
        super().__init__(
            f"{log}: no frame of any sensor in the log; run the sensor's driver beside the logger"
        )


class NoTruthError(CalibrationError):
    """A log has no truth."""

    def __init__(self, log: str, topic: str) -> None:
        super().__init__(
            f"{log}: no truth in the log ({topic}); let the robots or a motion capture system publish it "
            "beside the logger"
        )
