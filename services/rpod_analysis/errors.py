"""Errors of this package. Each text is one line and says what to do."""

from collections.abc import Sequence
from pathlib import Path

from rpod_schemas.errors import RpodError


class AnalysisError(RpodError):
    """Root of the errors that this package raises."""


class NoLogError(AnalysisError):
    """There is no such file, or it cannot be read."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")


class NotMcapError(AnalysisError):
    """The file is something else."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: is no MCAP log")


class TruncatedLogError(AnalysisError):
    """The log was not closed, so that it has no index."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: the log is truncated; 'rpod recover {path}' makes a readable one of it")


class DamagedLogError(AnalysisError):
    """The log cannot be read where it should be readable."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: the log is damaged ({reason}); 'rpod recover {path}' saves what is whole")


class CannotWriteError(AnalysisError):
    """A file cannot be written."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")


class NoEstimatesError(AnalysisError):
    """No estimator spoke while the log was open."""

    def __init__(self, path: Path, prefix: str) -> None:
        super().__init__(f"{path}: no estimates in the log ({prefix}/odometry, {prefix}/status)")


class NoEstimatorError(AnalysisError):
    """A log does not say how its estimator was configured."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: the log holds no estimator's configuration; give one with --config")


class NothingToPlayError(AnalysisError):
    """No topic of a log fits what is to be played."""

    def __init__(self, path: Path, patterns: Sequence[str]) -> None:
        asked = f" that fits {', '.join(patterns)}" if patterns else ""
        super().__init__(f"{path}: no topic of a known type in the log{asked}")


class FramesDifferError(AnalysisError):
    """Truth and estimate are not of the same frame."""

    def __init__(self, path: Path, truth: str, estimate: str) -> None:
        super().__init__(f"{path}: the truth is in frame {truth!r}, the estimate in {estimate!r}")


class CalibrationError(AnalysisError):
    """The logs do not tell a camera's distance errors."""
