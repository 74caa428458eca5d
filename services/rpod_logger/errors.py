"""The errors of the logger."""

import errno
from pathlib import Path

from rpod_runtime.errors import RefusedError

_REMEDIES = {
    errno.ENOSPC: "make room on the disk",
    errno.EDQUOT: "make room in the quota",
    errno.EFBIG: "lower split_bytes or raise the limit on a file's size",
    errno.EROFS: "make the directory writable",
    errno.EACCES: "make the directory writable",
    errno.EPERM: "make the directory writable",
}
_REMEDY = "check the disk and its mount"


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
    """The disk does not take the log: why, what became of the file, and what to do.

    Args:
        path: the file.
        error: what the system said.
        closed: whether the file could still be closed; None where there is none.
    """

    def __init__(self, path: Path, error: Exception, *, closed: bool | None = None) -> None:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        remedy = _REMEDIES.get(error.errno or 0, _REMEDY) if isinstance(error, OSError) else _REMEDY
        became = {
            True: "; it is closed and readable",
            False: "; it could not be closed: 'rpod recover' makes it readable",
            None: "",
        }[closed]
        super().__init__(f"cannot write {path}: {reason}{became}; {remedy}, then use start to record again")
