"""The errors of the logger."""

from pathlib import Path

from rpod_runtime.errors import RefusedError


class LoggerError(RefusedError):
    """Root of the errors that this package raises: commands that cannot be carried out."""


class AlreadyRecordingError(LoggerError):
    """A log is open."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"already recording to {path}; use split for a new file")


class NotRecordingError(LoggerError):
    """No log is open."""

    def __init__(self) -> None:
        super().__init__("not recording; use start")


class CannotWriteError(LoggerError):
    """The disk does not take the log."""

    def __init__(self, path: Path, error: Exception) -> None:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        super().__init__(f"cannot write {path}: {reason}")
