"""A second process of a service that is kept alive: warm, off the bus, it takes over when the first ends."""

import logging
import subprocess
import time
from collections.abc import Callable
from typing import Literal

from rpod.service_process import close_pipe
from rpod_runtime.process.processes import end_process

log = logging.getLogger(__name__)

ReserveState = Literal["none", "starting", "ready"]

AFTER_S = 5.0
"""Time that a service has to be at work before its reserve is started: until then its first pose needs the
processor, and a service that fails at once gets no reserve."""
PAUSE_S = 60.0
"""Time until the next try after a process in reserve has ended by itself."""
_END_S = 1.0
"""Time that it gets to end by itself, s; a compilation cannot be interrupted."""


class Reserve:
    """The process in reserve of one service.

    Args:
        name: name of the service, for log lines.
        spawn: starts the process.
    """

    def __init__(self, name: str, spawn: Callable[[], subprocess.Popen[bytes]]) -> None:
        self._name, self._spawn = name, spawn
        self._process: subprocess.Popen[bytes] | None = None
        self._warm = False
        self._due_s = 0.0

    @property
    def state(self) -> ReserveState:
        """Whether there is a process, and whether it is warm."""
        return "none" if self._process is None else "ready" if self._warm else "starting"

    @property
    def pid(self) -> int | None:
        """Process identifier, while there is a process."""
        return self._process.pid if self._process else None

    def update(self, worked_s: float) -> None:
        """Start the process once its service has been at work for a while, and notice its end."""
        if self._process is None:
            if worked_s >= AFTER_S and time.monotonic() >= self._due_s:
                self._start()
            return
        code = self._process.poll()
        if code is not None:
            self._release()
            self._due_s = time.monotonic() + PAUSE_S
            text = "%s: the process in reserve ended with exit code %d; the next one starts in %g s"
            log.error(text, self._name, code, PAUSE_S)

    def _start(self) -> None:
        try:
            self._process = self._spawn()
        except OSError as error:
            self._due_s = time.monotonic() + PAUSE_S
            text = "%s: no process in reserve: %s; the next try is in %g s"
            log.error(text, self._name, error, PAUSE_S)

    def warm(self) -> None:
        """Note that the process is warm."""
        if self._process is not None and not self._warm:
            self._warm = True
            log.info("%s: process %d is in reserve", self._name, self._process.pid)

    def take(self) -> subprocess.Popen[bytes] | None:
        """Call the process to work and return it, also if it is not warm yet; None if there is none."""
        process, self._process, self._warm = self._process, None, False
        if process is None or process.stdin is None:
            return None
        try:
            process.stdin.write(b"\n")
            process.stdin.flush()
        except OSError:  # it has ended
            _end(process)
            return None
        return process

    def drop(self) -> None:
        """End the process, if there is one."""
        if self._process is not None:
            _end(self._process)
            self._process, self._warm = None, False

    def _release(self) -> None:
        if self._process is not None:
            close_pipe(self._process)
        self._process, self._warm = None, False


def _end(process: subprocess.Popen[bytes]) -> None:
    end_process(process, _END_S)
    close_pipe(process)
