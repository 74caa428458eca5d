"""The errors of the logger."""

import errno
from pathlib import Path

from rpod_runtime.errors import RefusedError
from rpod_schemas.texts import remedy_of

_REMEDY = "check the disk and its mount"
_REMEDIES = {errno.EFBIG: "lower split_bytes or raise the limit of the file size", errno.ENOENT: _REMEDY}
"""Remedies of a logger, in place of those that any program gives."""
BY_QUERY = "use start to record again"
BY_ITSELF = "the logger begins by itself"


class LoggerError(RefusedError):
    """Root of the errors that this package raises, when a command cannot be carried out."""


class AlreadyRecordingError(LoggerError):
    """A log is already open."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"already recording to {path}; use split to go on in a new file")


class NotRecordingError(LoggerError):
    """No log is open."""

    def __init__(self) -> None:
        super().__init__("not recording; use start to open a log")


class CannotWriteError(LoggerError):
    """The log cannot be written; the text gives the reason, the state of the file, and the remedy.

    Args:
        path: the file.
        error: the error of the system.
        closed: whether the file could still be closed; None if there is no file.
        again: what begins the next recording.
    """

    def __init__(
        self, path: Path, error: Exception, *, closed: bool | None = None, again: str = BY_QUERY
    ) -> None:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        remedy = _REMEDY
        if isinstance(error, OSError):
            remedy = _REMEDIES.get(error.errno or 0) or remedy_of(error, "set another directory") or remedy
        became = {
            True: "; the file is closed and readable",
            False: "; the file could not be closed: 'rpod recover' makes it readable",
            None: "",
        }[closed]
        super().__init__(f"cannot write {path}: {reason}{became}; {remedy}, then {again}")
