"""One service that is kept alive: its process, what it reports, and when it is started again."""

import logging
import signal
import socket
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from rpod.service_process import ServiceFiles, close_pipe
from rpod.up.reserve import Reserve
from rpod.up.resolved import ResolvedService
from rpod_runtime.process.awake import AwakeClock
from rpod_runtime.process.lifecycle import EXIT_OK, EXIT_USAGE
from rpod_runtime.process.notify import AT_WORK, IN_RESERVE
from rpod_runtime.process.processes import end_process
from rpod_runtime.process.reserve import RESERVE
from rpod_schemas.config.facility.hosts import BackoffConfig

log = logging.getLogger(__name__)

_STARTING_S = 1.0
"""Time that a service that is not ready yet gets to end by itself, s; a compilation cannot be interrupted."""

DaemonState = Literal["starting", "ready", "failing", "waiting", "ended", "refused", "stopping", "stopped"]
"""``waiting`` is the wait before a restart, ``ended`` is over for good, ``refused`` has a wrong
configuration."""


@dataclass
class Backoff:
    """Wait before the next restart: doubled each time, the first one again after a steady while."""

    config: BackoffConfig
    _next_s: float = field(init=False)

    def __post_init__(self) -> None:
        self._next_s = self.config.first_s

    def next_s(self, worked_s: float) -> float:
        """Return the wait after a process that was at work for a time, s."""
        if worked_s >= self.config.steady_s:
            self._next_s = self.config.first_s
        wait_s, self._next_s = self._next_s, min(2.0 * self._next_s, self.config.max_s)
        return wait_s


class Daemon:
    """A service and its present process. Everything runs in the service manager's one thread."""

    def __init__(
        self,
        service: ResolvedService,
        *,
        state: Path,
        sockets: Path,
        backoff: BackoffConfig,
        clock: AwakeClock | None = None,
    ) -> None:
        self.name, self.service = service.name, service
        self._clock = clock or AwakeClock()
        """Counts the time in which the manager itself ran: if it stood still, it must not conclude that
        services hang."""
        self.state: DaemonState = "stopped"
        self.message = ""
        self.restarts = 0
        self.last_end = ""
        """How the last process ended."""
        self._files = ServiceFiles(state, service.name)
        self.log = self._files.log
        self._backoff = Backoff(backoff)
        self.reserve = Reserve(service.name, lambda: self._spawn(in_reserve=True))
        self._process: subprocess.Popen[bytes] | None = None
        self._born_s = 0.0
        """Time at which the process was started, monotonic clock; the other times are the manager's own."""
        self._started_s = self._ready_s = self._heard_s = 0.0
        self._due_s = 0.0
        self._hang_s = service.settings.hang_s
        """Limit of the present process, which was told of it when it was started."""
        self._reason = ""
        self._at_work, self._reload_due = True, False
        self._address = sockets / service.name
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(str(self._address))

    @property
    def pid(self) -> int | None:
        """Process identifier, while there is a process."""
        return self._process.pid if self._process else None

    @property
    def shown_state(self) -> DaemonState:
        """State for the operator: a service that runs and cannot do its work is failing."""
        return "failing" if self.state in ("starting", "ready") and not self._at_work else self.state

    @property
    def up_s(self) -> float:
        """Time since the present process was started, s."""
        return time.monotonic() - self._born_s if self._process else 0.0

    def start(self) -> None:
        """Start a process, or call the one in reserve; where the machine has no room, try again later."""
        try:
            self._process = self.reserve.take() or self._spawn()
        except OSError as error:
            self.last_end = f"could not be started: {error}"
            self._wait(0.0)
            return
        self._born_s = time.monotonic()
        self._started_s = self._heard_s = self._clock.now_s()
        self._ready_s, self._hang_s = 0.0, self.service.settings.hang_s
        self.state, self.message, self._reason = "starting", "", ""
        self._at_work, self._reload_due = True, False
        log.info("%s: started, process %d", self.name, self._process.pid)

    def _spawn(self, *, in_reserve: bool = False) -> subprocess.Popen[bytes]:
        self._files.write_config(self.service.config)
        environment = {
            "NOTIFY_SOCKET": str(self._address),
            "WATCHDOG_USEC": str(round(1e6 * self.service.settings.hang_s)),
            "WATCHDOG_PID": "",
        }
        if in_reserve:
            environment[RESERVE] = "1"
        return self._files.start(self.service.arguments(self._files.config), environment)

    def turn(self) -> None:
        """Read the process's reports, notice its end or a hang, and start it again when that is due."""
        self._listen()
        self._files.shorten_log()
        if self._process is not None:
            code = self._process.poll()
            if code is not None:
                self._note_end(code)
            elif self.state in ("starting", "ready"):
                self._kill_if_late()
                if self.state == "ready" and self.service.settings.reserve:
                    self.reserve.update(self._clock.now_s() - self._ready_s)
        elif self.state == "waiting" and self._clock.now_s() >= self._due_s:
            self.restarts += 1
            self.start()

    def reload(self, service: ResolvedService) -> None:
        """Take another configuration. Fields that may change apply at once, all others at the next start."""
        if service != self.service:
            self.reserve.drop()
        self.service = service
        try:
            self._files.write_config(service.config)
        except OSError as error:
            log.error("%s: its configuration cannot be written: %s", self.name, error)
        if self.state == "ready":
            self.send(signal.SIGHUP)
        self._reload_due = self.state == "starting"  # a process does not handle the signal yet

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process, if there is one."""
        if self._process is not None:
            self._process.send_signal(number)

    def stop(self, timeout_s: float) -> None:
        """Ask the process to finish, wait, and kill it if it does not.

        A service that is still starting gets less time.
        """
        self.reserve.drop()
        if self._process is not None:
            timeout_s = min(timeout_s, _STARTING_S) if self.state == "starting" else timeout_s
            self.state = "stopping"
            if end_process(self._process, timeout_s).forced:
                log.error("%s did not stop within %g s; it was killed", self.name, timeout_s)
            self._release()
        self.state = "stopped"

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()
        self._address.unlink(missing_ok=True)

    def _listen(self) -> None:
        with suppress(BlockingIOError):
            while True:
                told = self._socket.recv(4096).decode(errors="replace").splitlines()
                if self._process is not None:
                    self._take(dict(line.split("=", 1) for line in told if "=" in line))

    def _take(self, told: dict[str, str]) -> None:
        if IN_RESERVE in told:
            self.reserve.warm()
            return
        self._heard_s = self._clock.now_s()
        self.message = told.get("STATUS", self.message)
        if "READY" in told and self.state == "starting":
            self._at_work = True
            self.state, self._ready_s = "ready", self._heard_s
            log.info("%s: ready after %.1f s", self.name, self._heard_s - self._started_s)
            if self._reload_due:
                self._reload_due = False
                self.send(signal.SIGHUP)
        if AT_WORK in told:
            self._at_work = told[AT_WORK] != "0"
            level = logging.INFO if self._at_work else logging.ERROR
            log.log(level, "%s: %s", self.name, self.message)

    def _kill_if_late(self) -> None:
        """Kill a process that does not become ready in time, or whose main loop hangs."""
        settings, now_s = self.service.settings, self._clock.now_s()
        late = now_s - self._started_s > settings.start_timeout_s and settings.verb != "driver"
        if self.state == "starting" and late and self._at_work:  # else it has reported the reason
            self._reason = f"was not ready after {settings.start_timeout_s:g} s"
        elif self.state == "ready" and now_s - self._heard_s > self._hang_s:
            self._reason = f"hung for {self._hang_s:g} s"
        if self._reason:
            self.send(signal.SIGKILL)  # its end is noticed in one of the next turns

    def _note_end(self, code: int) -> None:
        """Note how the process has ended, and whether another one is started."""
        worked_s = self._clock.now_s() - self._ready_s if self._ready_s else 0.0
        how = f"was killed by {_signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
        self.last_end = f"{self._reason}, {how}" if self._reason else how
        self._release()
        if code > 0:
            self.message = self._last_line()
        policy = self.service.settings.restarts
        if code == EXIT_USAGE:
            self.state = "refused"
            log.error("%s: its configuration is refused; correct it: %s", self.name, self._last_line())
        elif policy == "never" or (policy == "on_failure" and code == EXIT_OK):
            self.state = "ended"
            log.info("%s: %s", self.name, self.last_end)
        else:
            self._wait(worked_s)

    def _wait(self, worked_s: float) -> None:
        wait_s = self._backoff.next_s(worked_s)
        self.state, self._due_s = "waiting", self._clock.now_s() + wait_s
        last = self._last_line()
        log.error(
            "%s: %s; to be started again in %g s; last line: %s", self.name, self.last_end, wait_s, last
        )

    def _release(self) -> None:
        if self._process is not None:
            close_pipe(self._process)
        self._process = None

    def _last_line(self) -> str:
        return next(iter(self._files.last_lines(1)), "none")


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
