"""The errors of the command line and the supervisor, and how a verb reports an error."""

import sys
from pathlib import Path

from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_USAGE
from rpod_schemas.errors import ConfigurationError, RpodError
from rpod_schemas.texts import reason_of

EXIT_INTERRUPTED = 130


class RunError(RpodError):
    """Root of the errors that this package raises."""


class ServiceDiedError(RunError):
    """A service ended when it should not have."""

    def __init__(self, name: str, code: int, tail: list[str], log: Path) -> None:
        self.name = name
        how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        lines = "".join(f"\n    {line}" for line in tail)
        super().__init__(f"service {name} {how}; its last log lines (all are in {log}):{lines or ' none'}")


class NotReadyError(RunError):
    """A service was not ready in time."""

    def __init__(self, name: str, waited_s: float, log: Path) -> None:
        super().__init__(f"service {name} is not ready after {waited_s:.0f} s; see {log}")


class FailedServiceError(RunError):
    """A service runs, but cannot do its work."""

    def __init__(self, name: str, log: Path) -> None:
        lines = log.read_text("utf-8", errors="replace").splitlines() if log.is_file() else []
        first = next((line for line in lines if " ERROR " in line), "it does not say why")
        told = first.split(" ERROR ")[-1].strip().removeprefix(f"{name}: ")
        super().__init__(f"service {name} cannot do its work: {told}; see {log}")


class InterruptedRunError(RunError):
    """The operator ended the run."""


class AlreadyUpError(RunError):
    """Another process keeps this facility up."""

    def __init__(self, folder: Path, pid: int | None) -> None:
        who = "another process" if pid is None else f"process {pid}"
        super().__init__(
            f"the facility is up already: {who} holds {folder}; 'rpod ps' shows it, 'rpod down' ends it"
        )


class ForeignStateError(RunError):
    """The state of a facility cannot be read by this user."""

    def __init__(self, folder: Path, reason: str) -> None:
        super().__init__(
            f"{folder}: whether the facility is up cannot be read ({reason}); ask as the user who started it"
        )


def told(error: Exception | str) -> str:
    """Return an error in one line; of the operating system as path, reason and remedy, without its number."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    return ": ".join(str(each) for each in (error.filename, reason_of(error)) if each)


def failed(verb: str, reason: Exception | str, code: int | None = None) -> int:
    """Print the reason on standard error; return the exit code.

    Args:
        verb: the verb that failed, such as ``target new``.
        reason: why it failed, in one line.
        code: exit code; by default that of a wrong configuration or that of any other failure, by the reason.
    """
    line = told(reason).removeprefix(f"rpod {verb}: ")  # an error of the options themselves names the verb
    print(f"rpod {verb}: {line}", file=sys.stderr)
    if code is not None:
        return code
    return EXIT_USAGE if isinstance(reason, ConfigurationError) else EXIT_FAILURE
