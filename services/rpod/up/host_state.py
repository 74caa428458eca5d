"""The state of a facility that ``rpod up`` keeps: one folder, held by one process, read by ``rpod ps``."""

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rpod.errors import AlreadyUpError, ForeignStateError
from rpod_schemas.caches.whole_file import whole_file
from rpod_schemas.config.base import Config, check, read_document
from rpod_schemas.config.facility.hosts import FacilityFile

STOP_TIMEOUT_S = 60.0
"""Longest time that one service may take to finish, on a loaded machine too."""
_LOCK, _STATUS = "manager.pid", "status.json"
_LOOK_S, _RETRY_S = 0.5, 0.05
"""Time for which a lock is tried again, since ``rpod ps`` holds it for a moment, and time between two tries,
s."""


class DaemonStatus(Config):
    """One service in ``rpod ps``."""

    name: str
    """Name in the facility's file."""
    state: str
    """starting, ready, failing (it runs and cannot do its work, as its message says), waiting (for its
    restart), ended, refused (its configuration), stopping, stopped."""
    pid: int | None
    """Process identifier, while there is a process."""
    up_s: float
    """Age of the process, s."""
    restarts: int
    """Number of restarts since ``rpod up``."""
    last_end: str
    """How the process before ended; empty if none has."""
    message: str
    """Newest message of the service about its state."""
    memory_bytes: int | None = None
    """Resident memory of the process."""
    reserve: str = "none"
    """Its process in reserve: none, starting, ready."""
    reserve_pid: int | None = None
    """Its process identifier."""
    reserve_bytes: int | None = None
    """Resident memory of the process in reserve."""
    log: str
    """File of its log lines."""


class FacilityStatus(Config):
    """State of a facility, as ``rpod ps`` shows it."""

    name: str
    """Name of the facility."""
    up: bool
    """Whether ``rpod up`` runs."""
    pid: int | None
    """Process identifier of ``rpod up``, while it runs."""
    services: tuple[DaemonStatus, ...] = ()
    """The services in the order of the file."""

    @property
    def healthy(self) -> bool:
        """Whether every service is at work, or has come to its end."""
        return self.up and all(service.state in ("ready", "ended") for service in self.services)


def state_folder(path: Path, file: FacilityFile) -> Path:
    """Return the folder of a facility's state."""
    return (path.parent / (file.state or path.with_suffix(".state").name)).resolve()


def read_facility(path: Path) -> tuple[FacilityFile, Path]:
    """Return a facility's file and the folder of its state. Raises ``ConfigurationError``."""
    file = check(FacilityFile, read_document(path), source=path)
    return file, state_folder(path, file)


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold the folder for this process. Raises ``AlreadyUpError``, ``OSError``."""
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        _lock(descriptor, folder)
        os.ftruncate(descriptor, 0)
        os.write(descriptor, str(os.getpid()).encode())
        yield
        os.ftruncate(descriptor, 0)  # the number may soon be that of another process
    finally:
        os.close(descriptor)  # which releases it, as the end of the process does


def _lock(descriptor: int, folder: Path) -> None:
    """Lock the file of a folder. Raises ``AlreadyUpError``."""
    deadline_s = time.monotonic() + _LOOK_S
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() < deadline_s:  # perhaps a reader looks at it
                time.sleep(_RETRY_S)
                continue
            raise AlreadyUpError(folder, holder(folder)) from None
        return


def holder(folder: Path) -> int | None:
    """Return the process that holds a folder; None if none does, or it is not known which.

    Readers share the lock, so that none of them takes another one for the holder.

    Raises:
        ForeignStateError: the folder is another user's.
    """
    try:
        descriptor = os.open(folder / _LOCK, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ForeignStateError(folder, error.strerror or str(error)) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        text = os.read(descriptor, 32)
        return int(text) if text.isdigit() else None
    finally:
        os.close(descriptor)
    return None


def write_status(folder: Path, status: FacilityStatus) -> None:
    """Replace the state in one step, so that a reader never sees half of it. Raises ``OSError``."""
    with whole_file(folder / _STATUS) as stream:
        stream.write(status.model_dump_json(indent=2).encode() + b"\n")


def read_status(folder: Path, name: str) -> FacilityStatus:
    """Return the present state; that of a facility that is not up has no services."""
    pid = holder(folder)
    if pid is not None:
        with suppress(OSError, ValueError):
            return FacilityStatus.model_validate_json((folder / _STATUS).read_text("utf-8"))
    return FacilityStatus(name=name, up=pid is not None, pid=pid)
