"""``rpod run`` as a process for tests: its lines as they come, its services, and what is left of it.

Nothing here sleeps: tests wait for lines, files and processes, with a deadline.
"""

import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Condition, Event, Thread
from time import monotonic
from typing import IO, TypeVar

import psutil
from logs import messages_of

from rpod_schemas.summary import Summary
from rpod_schemas.topics import TRUTH

T = TypeVar("T")

DEADLINE_S = 300.0
_PLAYED = 100
"""Messages of truth in the log of a run that plays: 0.4 s of it."""


class Lines:
    """The lines of a stream, read by a thread."""

    def __init__(self, stream: IO[str]) -> None:
        self._lines: list[str] = []
        self._new = Condition()
        self._ended = False
        self._thread = Thread(target=self._read, args=(stream,), daemon=True)
        self._thread.start()

    def _read(self, stream: IO[str]) -> None:
        with stream:
            for line in stream:
                with self._new:
                    self._lines.append(line)
                    self._new.notify_all()
        with self._new:
            self._ended = True
            self._new.notify_all()

    def wait_for(self, pattern: str) -> str:
        """Return the first line that holds a pattern."""
        with self._new:
            self._new.wait_for(lambda: self._ended or self._found(pattern), DEADLINE_S)
            assert self._found(pattern), f"no line with {pattern!r} in: {''.join(self._lines)}"
            return self._found(pattern)[0]

    def _found(self, pattern: str) -> list[str]:
        return [line for line in self._lines if re.search(pattern, line)]

    def text(self) -> str:
        """Return everything, once the stream has ended."""
        self._thread.join(DEADLINE_S)
        assert not self._thread.is_alive()
        return "".join(self._lines)


class FacilityProcess:
    """A run and its services; ``close`` leaves nothing of it behind."""

    def __init__(self, *arguments: str, out: Path) -> None:
        self._out = out
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rpod", "run", *arguments, "--out", str(out)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout
        assert self._process.stderr
        self.stdout, self.stderr = Lines(self._process.stdout), Lines(self._process.stderr)
        self.services: dict[str, psutil.Process] = {}
        """By verb, as they were when the test last looked; processes of services by their id."""

    # --- while it runs ---

    def await_services(self) -> None:
        """Wait until all services have been started."""
        self.stderr.wait_for("waiting for")
        children = psutil.Process(self._process.pid).children(recursive=True)
        self.services = {_name_of(child): child for child in children}

    def await_playing(self) -> None:
        """Wait until the scenario plays and its truth is in the log."""
        self.await_services()
        self.stderr.wait_for(r"\d / \d")
        until(lambda: self.log.exists() and len(messages_of(self.log, f"/{TRUTH.name}")) >= _PLAYED)

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the supervisor."""
        self._process.send_signal(number)

    # --- what it leaves ---

    def finish(self) -> "Finished":
        """Wait for the end."""
        code = self.wait()
        return Finished(code, self.stdout.text(), self.stderr.text(), self.directory, self.log)

    def wait(self, timeout_s: float = DEADLINE_S) -> int:
        """Return the exit code."""
        return self._process.wait(timeout_s)

    @property
    def directory(self) -> Path:
        """The run's folder."""
        (directory,) = self._out.iterdir()
        return directory

    @property
    def log(self) -> Path:
        """The log, whether or not it is there."""
        scenario = self.directory.name.rsplit("-", 1)[0]
        return self.directory / f"{scenario}.mcap"

    def left(self) -> list[str]:
        """Return the services that do not end."""
        _, alive = psutil.wait_procs(self.services.values(), timeout=DEADLINE_S / 4)
        return [verb for verb, service in self.services.items() if service in alive]

    def close(self) -> None:
        """End by force what still runs."""
        self._process.kill()
        self._process.wait()
        for service in self.services.values():
            if service.is_running():
                service.kill()


@dataclass(frozen=True)
class Finished:
    """A run that has ended."""

    code: int
    stdout: str
    stderr: str
    directory: Path
    log: Path

    @property
    def summary(self) -> Summary:
        """What stands in ``summary.json``."""
        return Summary.model_validate_json((self.directory / "summary.json").read_text("utf-8"))


def _name_of(process: psutil.Process) -> str:
    command = process.cmdline()  # empty for one that has just ended
    return command[3] if command[1:3] == ["-m", "rpod"] else str(process.pid)


def until(condition: Callable[[], T]) -> T:
    """Wait until something holds; return what the condition gave."""
    deadline_s, pause = monotonic() + DEADLINE_S, Event()
    while not (result := condition()):
        assert monotonic() < deadline_s
        pause.wait(0.02)
    return result
