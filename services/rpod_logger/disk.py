"""The file of a log on the disk: a write is either complete or has no effect.

Disk space for the end of the file is reserved in a second file without a name, which the system deletes when
the process ends. When the disk is full, this space is released, so that the log can still be closed.
"""

import errno
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

_FULL = (errno.ENOSPC, errno.EDQUOT)


class DiskFile:
    """A new file to which data are appended. It never overwrites an existing file.

    Raises:
        OSError: the file cannot be created, or the disk has no room for it and its reserve.

    ``refuses`` tells whether the disk counts as full by an injected fault.
    """

    def __init__(
        self, path: Path, *, reserve_bytes: int, refuses: Callable[[], bool] = lambda: False
    ) -> None:
        self.path = path
        self._refuses = refuses
        if refuses():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.full = False
        """Whether the disk is full and the reserve is in use."""
        self._reserve: IO[bytes] | None = _allocate(path.parent, reserve_bytes)
        try:
            self._stream = path.open("xb", buffering=0)
        except OSError:
            self._reserve.close()
            raise
        self._size = 0
        self.appended: Callable[[bytes], None] = lambda _: None
        """Gets all data that were appended."""
        _sync_directory(path.parent)

    def write(self, data: bytes) -> int:
        """Append all data. If that fails, remove the part already appended and raise ``OSError``."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._append(rest) :]
        except OSError:
            with suppress(OSError):
                self._stream.truncate(self._size)
            raise
        self._size += len(data)
        self.appended(data)
        return len(data)

    def _append(self, data: memoryview) -> int:
        try:
            if self._refuses() and self._reserve is not None:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return self._stream.write(data)
        except OSError as error:
            if error.errno not in _FULL or self._reserve is None:
                raise
        self.full = True
        self._reserve.close()
        self._reserve = None
        return self._stream.write(data)

    def tell(self) -> int:
        """Return the size of the file, bytes."""
        return self._size

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def sync(self) -> None:
        """Write buffered data of the system to the disk."""
        os.fsync(self._stream.fileno())

    @property
    def vanished(self) -> bool:
        """Whether the file was deleted or its mount is gone."""
        try:
            found = self.path.stat()
        except OSError:
            return True
        return not os.path.samestat(found, os.fstat(self._stream.fileno()))

    def close(self) -> None:
        """Close the file and release the reserve."""
        if self._reserve is not None:
            self._reserve.close()
        self._stream.close()


def _allocate(directory: Path, size: int) -> IO[bytes]:
    file: IO[bytes] = TemporaryFile(dir=directory, buffering=0)  # noqa: SIM115 - as long as the log
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except OSError:
        file.close()
        raise
    return file


def _sync_directory(directory: Path) -> None:
    """Make a new file name survive a power failure, if the file system supports that."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
