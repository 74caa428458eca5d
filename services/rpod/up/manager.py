"""``rpod up``: keeps the services of a facility alive without systemd, until it is stopped by a signal."""

import logging
import os
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from rpod.up.daemon import Daemon, DaemonState
from rpod.up.host_state import STOP_TIMEOUT_S, DaemonStatus, FacilityStatus, held, write_status
from rpod.up.reserve import ReserveState
from rpod.up.resolved import ResolvedFacility, resolve_facility
from rpod_runtime.process.awake import AwakeClock
from rpod_schemas.errors import ConfigurationError

log = logging.getLogger(__name__)

_TURN_S = 0.05
"""Time between two looks at the processes: the longest time until an end is noticed."""
_STATUS_S = 1.0


@dataclass
class Asked:
    """Requests by signals. They are plain flags: a handler that sets an event could wait for its own lock."""

    stop: bool = False
    stop_s: float = 0.0
    """Time of the first signal that asks to stop, monotonic clock."""
    reload: bool = False


class FacilityManager:
    """All services of a facility, each kept alive."""

    def __init__(self, facility: ResolvedFacility, sockets: Path) -> None:
        self._facility = facility
        clock = AwakeClock()
        self._daemons = [
            Daemon(service, state=facility.state, sockets=sockets, backoff=facility.file.backoff, clock=clock)
            for service in facility.services
        ]
        self._shown: list[tuple[DaemonState, int | None, ReserveState]] = []
        self._next_s = 0.0

    def run(self, asked: Asked, tell: Callable[[FacilityStatus], None]) -> None:
        """Start the services, keep them alive until stopped, and stop them, the last one first."""
        try:
            for daemon in self._daemons:
                daemon.start()
            while not asked.stop:
                if asked.reload:
                    asked.reload = False
                    self._reload()
                for daemon in self._daemons:
                    daemon.turn()
                self._write(tell)
                time.sleep(_TURN_S)
        finally:
            for daemon in reversed(self._daemons):
                daemon.stop(STOP_TIMEOUT_S)
                daemon.close()
            with suppress(OSError):
                tell(self.status())

    def status(self) -> FacilityStatus:
        """Return the present state of all services."""
        services = tuple(
            DaemonStatus(
                name=each.name,
                state=each.shown_state,
                pid=each.pid,
                up_s=round(each.up_s, 3),
                restarts=each.restarts,
                last_end=each.last_end,
                message=each.message,
                memory_bytes=_memory_bytes(each.pid),
                reserve=each.reserve.state,
                reserve_pid=each.reserve.pid,
                reserve_bytes=_memory_bytes(each.reserve.pid),
                log=str(each.log),
            )
            for each in self._daemons
        )
        return FacilityStatus(name=self._facility.file.name, up=True, pid=os.getpid(), services=services)

    def _reload(self) -> None:
        """Read the facility's file again, and pass the configurations on to the services that run."""
        try:
            new = {service.name: service for service in resolve_facility(self._facility.path).services}
        except ConfigurationError as error:
            log.error("SIGHUP: the file is refused and nothing changes: %s", error)
            return
        for daemon in self._daemons:
            if daemon.name in new:
                daemon.reload(new.pop(daemon.name))
            else:
                log.warning("%s is not in the file any more; it ends with the next 'rpod down'", daemon.name)
        for name in new:
            log.warning("%s is new in the file; it is started with the next 'rpod up'", name)

    def _write(self, tell: Callable[[FacilityStatus], None]) -> None:
        """Write the state at each change, and once a second."""
        shown: list[tuple[DaemonState, int | None, ReserveState]] = [
            (each.shown_state, each.pid, each.reserve.state) for each in self._daemons
        ]
        changed = shown != self._shown
        if not changed and time.monotonic() < self._next_s:
            return
        status = self.status()
        try:
            write_status(self._facility.state, status)
        except OSError as error:  # a full disk must not end what keeps the facility alive
            log.error("the state cannot be written: %s", error)
        if changed:
            with suppress(OSError):  # standard output that is closed must not end it either
                tell(status)
        if changed and status.healthy:
            log.info("ready: all services of %s are at work", status.name)
        self._shown, self._next_s = shown, time.monotonic() + _STATUS_S


def keep_up(facility: ResolvedFacility, *, asked: Asked, tell: Callable[[FacilityStatus], None]) -> None:
    """Keep a facility up until stopped. Raises ``AlreadyUpError``, ``OSError``."""
    with ExitStack() as stack:
        stack.enter_context(held(facility.state))
        # short: the path of a socket has at most 107 bytes
        sockets = Path(stack.enter_context(TemporaryDirectory(prefix="rpod-", ignore_cleanup_errors=True)))
        FacilityManager(facility, sockets).run(asked, tell)


def _memory_bytes(pid: int | None) -> int | None:
    """Return the resident memory of a process, from proc(5); None where that cannot be read."""
    if pid is None:
        return None
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")
