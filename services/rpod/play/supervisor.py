"""Starts services as processes, watches them, and stops them in order."""

import logging
import signal
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from pydantic import BaseModel

from rpod.errors import ServiceDiedError
from rpod.service_process import ServiceFiles, close_pipe
from rpod_runtime.process.processes import end_process

log = logging.getLogger(__name__)

_STOP_TIMEOUT_S = 60.0
"""Longest time that one service may take to finish, on a loaded machine too."""
_TAIL_LINES = 8


@dataclass
class _Service:
    process: subprocess.Popen[bytes]
    files: ServiceFiles
    optional: bool
    config: BaseModel
    down: bool = False
    """Whether it was killed on purpose, and is not missed until it is started again."""

    def died(self, name: str, code: int) -> ServiceDiedError:
        return ServiceDiedError(name, code, self.files.last_lines(_TAIL_LINES), self.files.log)


class Supervisor:
    """Processes of one run; at the end those that still run are stopped, the last started first.

    After a ``KeyboardInterrupt`` the supervisor does not wait for them.
    """

    def __init__(self, directory: Path, say: Callable[[str], None]) -> None:
        self._say = say
        self._directory = directory
        self._services: dict[str, _Service] = {}

    def start(self, verb: str, config: BaseModel, *, optional: bool = False) -> None:
        """Start ``rpod <verb>`` with a configuration; an optional service may end at any time.

        A service that is started again adds to its file of log lines.
        """
        files = ServiceFiles(self._directory, verb)
        files.write_config(config)
        process = files.start([verb, "--config", str(files.config)], {})
        self._services[verb] = _Service(process, files, optional, config)

    def log_of(self, verb: str) -> Path:
        """Return the file with a service's log lines."""
        return self._services[verb].files.log

    def pid_of(self, verb: str) -> int:
        """Return the number of a service's process."""
        return self._services[verb].process.pid

    def check(self) -> None:
        """Check that all services run. An optional one that has ended is reported once.

        Raises:
            ServiceDiedError: a service does not run; the error names the first one, with its last log lines.
        """
        for name, service in list(self._services.items()):
            code = service.process.poll()
            if code is None or service.down:
                continue
            died = service.died(name, code)
            if not service.optional:
                raise died
            log.warning("the run goes on without %s: %s", name, died if code else "it was closed")
            close_pipe(self._services.pop(name).process)

    def signal(self, verb: str, number: signal.Signals) -> None:
        """Send a signal to a service, if it runs."""
        service = self._services.get(verb)
        if service is not None and service.process.poll() is None:
            service.process.send_signal(number)

    def kill(self, verb: str) -> None:
        """Kill a service on purpose; ``restart`` starts it again."""
        service = self._services.get(verb)
        if service is not None:
            service.down = True
            service.process.kill()
            service.process.wait()

    def restart(self, verb: str) -> None:
        """Start a service again that was killed on purpose."""
        service = self._services.get(verb)
        if service is not None and service.down:
            close_pipe(service.process)
            self.start(verb, service.config, optional=service.optional)

    def stop(self, verb: str) -> None:
        """Ask a service to finish, wait, and kill it if it does not.

        Raises:
            ServiceDiedError: the service ended with an error. It is no error if a service that is still
                starting, and does not handle signals yet, ends by this signal, or if an optional service has
                ended.
        """
        service = self._services.pop(verb, None)
        if service is None:
            return
        self._say(f"stopping {verb}")
        if service.down:
            close_pipe(service.process)
            return
        try:
            code, forced = end_process(service.process, _STOP_TIMEOUT_S)
        finally:
            close_pipe(service.process)
        if forced:
            log.error("%s did not stop within %g s; it was killed", verb, _STOP_TIMEOUT_S)
        if code not in (0, -signal.SIGTERM) and not service.optional:
            raise service.died(verb, code)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is KeyboardInterrupt:
            return  # a second interrupt: end at once; the services end when their pipes close
        for name in reversed(list(self._services)):
            try:
                self.stop(name)
            except ServiceDiedError as died:
                if not isinstance(error, ServiceDiedError):
                    log.error("%s", died)
