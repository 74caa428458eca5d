"""Starts services as processes, watches them, and stops them in order.

Each service gets a configuration file and a log file in the run's folder, a session of its own (so
that Ctrl-C reaches the supervisor alone) and a pipe that closes when the supervisor is gone.
"""

import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from pydantic import BaseModel

from rpod.errors import ServiceDiedError
from rpod_runtime.lifecycle import SUPERVISED

log = logging.getLogger(__name__)

_STOP_TIMEOUT_S = 20.0
_TAIL_LINES = 8


@dataclass
class _Service:
    process: subprocess.Popen[bytes]
    log: Path
    optional: bool

    def close(self) -> None:
        """Release the resources of a process that has ended."""
        if self.process.stdin:
            self.process.stdin.close()

    def tail(self) -> list[str]:
        return self.log.read_text("utf-8", errors="replace").splitlines()[-_TAIL_LINES:]


class Supervisor:
    """Processes of one run; on leaving, whatever still runs is stopped, the last started first.

    On leaving by ``KeyboardInterrupt`` nobody is waited for.
    """

    def __init__(self, directory: Path, say: Callable[[str], None]) -> None:
        self._say = say
        self._configurations = directory / "config"
        self._logs = directory / "logs"
        self._services: dict[str, _Service] = {}

    def start(self, verb: str, config: BaseModel, *, optional: bool = False) -> None:
        """Start ``rpod <verb>`` with a configuration; an optional one may end as it likes."""
        self._configurations.mkdir(exist_ok=True)
        self._logs.mkdir(exist_ok=True)
        file = self._configurations / f"{verb}.json"
        file.write_text(config.model_dump_json(indent=2), "utf-8")
        output = self._logs / f"{verb}.log"
        with output.open("wb") as stream:
            process = subprocess.Popen(
                [sys.executable, "-m", "rpod", verb, "--config", str(file)],
                stdin=subprocess.PIPE,
                stdout=stream,
                stderr=stream,
                start_new_session=True,
                env=os.environ | {SUPERVISED: "1"},
            )
        self._services[verb] = _Service(process, output, optional)

    def log_of(self, verb: str) -> Path:
        """Return the file with a service's log lines."""
        return self._services[verb].log

    def check(self) -> None:
        """Check that all services run. An optional one that has ended is reported and forgotten.

        Raises:
            ServiceDiedError: names the first that does not, with its last lines.
        """
        for name, service in list(self._services.items()):
            code = service.process.poll()
            if code is None:
                continue
            died = ServiceDiedError(name, code, service.tail(), service.log)
            if not service.optional:
                raise died
            log.warning("the run goes on without %s: %s", name, died if code else "it was closed")
            self._services.pop(name).close()

    def stop(self, verb: str) -> None:
        """Ask a service to finish, wait, and kill it if it does not.

        Raises:
            ServiceDiedError: it ended with an error. A service that is asked while it still starts
                knows no signals yet and ends by this one: that is no error. Nor is any end of an
                optional one, nor that it has ended before.
        """
        service = self._services.pop(verb, None)
        if service is None:
            return
        self._say(f"stopping {verb}")
        process = service.process
        process.terminate()
        try:
            code = process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            log.error("%s does not stop within %g s; ended by force", verb, _STOP_TIMEOUT_S)
            process.kill()
            code = process.wait()
        finally:
            service.close()
        if code not in (0, -signal.SIGTERM) and not service.optional:
            raise ServiceDiedError(verb, code, service.tail(), service.log)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is KeyboardInterrupt:
            return  # asked again: ends at once, and the services follow as their pipes close
        for name in reversed(list(self._services)):
            try:
                self.stop(name)
            except ServiceDiedError as died:
                if not isinstance(error, ServiceDiedError):
                    log.error("%s", died)
