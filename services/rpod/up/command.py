"""``rpod up``, ``rpod ps`` and ``rpod down`` from their arguments to their exit codes."""

import os
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from rpod.console import table_console
from rpod.errors import RunError, failed
from rpod.up.host_state import STOP_TIMEOUT_S, FacilityStatus, holder, read_facility, read_status
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK, configure_logging
from rpod_schemas.errors import ConfigurationError

if TYPE_CHECKING:
    from rpod.up.manager import Asked

_POLL_S = 0.1
_SAME_S = 0.5
"""Time within which a second signal counts as the first one, s: ``timeout`` sends a signal to the process
and, at once, to its group. Hand: an operator who sees no effect sends the second one later than this."""


def up_command(path: Path, *, as_json: bool) -> int:
    """Keep a facility up until a signal; return the exit code."""
    from rpod.up.manager import Asked, keep_up  # noqa: PLC0415 - as above
    from rpod.up.resolved import resolve_facility  # noqa: PLC0415 - 'ps' needs no service's configuration

    configure_logging("up")
    asked = Asked()
    before = {
        number: signal.signal(number, lambda number, _: _take(number, asked))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    try:
        facility = resolve_facility(path)
        keep_up(facility, asked=asked, tell=lambda status: _print_status(status, as_json=as_json))
    except (ConfigurationError, RunError, OSError) as error:
        return failed("up", error)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return EXIT_OK


def _take(number: int, asked: "Asked") -> None:
    """Stop at the first signal, end at once at the second: the services end when their pipes close."""
    if number == signal.SIGHUP:
        asked.reload = True
    elif not asked.stop:
        asked.stop, asked.stop_s = True, time.monotonic()
    elif time.monotonic() - asked.stop_s > _SAME_S:
        os._exit(128 + number)


def ps_command(path: Path, *, as_json: bool) -> int:
    """Show the services of a facility; exit 0 if all are at work, 1 if not."""
    try:
        file, state = read_facility(path)
        status = read_status(state, file.name)
    except (ConfigurationError, RunError) as error:
        return failed("ps", error)
    if as_json:
        print(status.model_dump_json(indent=2))
    else:
        _print(status)
    return EXIT_OK if status.healthy else EXIT_FAILURE


def down_command(path: Path, *, as_json: bool) -> int:
    """End ``rpod up`` and its services, and wait for it; return the exit code."""
    try:
        file, state = read_facility(path)
        pid = holder(state)
    except (ConfigurationError, RunError) as error:
        return failed("down", error)
    if pid is not None:
        with suppress(ProcessLookupError):  # it has ended by itself
            os.kill(pid, signal.SIGTERM)
        deadline_s = time.monotonic() + STOP_TIMEOUT_S * (len(file.services) + 1)
        while holder(state) == pid:
            if time.monotonic() > deadline_s:
                return failed("down", f"process {pid} does not end; its log lines say why")
            time.sleep(_POLL_S)
    if as_json:
        print(read_status(state, file.name).model_dump_json(indent=2))
    else:
        print(f"{file.name} is down" if pid is not None else f"{file.name} was not up")
    return EXIT_OK


def _print_status(status: FacilityStatus, *, as_json: bool) -> None:
    if as_json:
        print(status.model_dump_json(), flush=True)


def _print(status: FacilityStatus) -> None:
    if not status.up:
        print(f"{status.name} is not up; start it with 'rpod up'")
        return
    table = Table(title=f"{status.name}, process {status.pid}", title_justify="left")
    for heading in (
        "service",
        "state",
        "process",
        "age",
        "memory",
        "reserve",
        "restarts",
        "last end",
        "says",
    ):
        table.add_column(heading)
    for each in status.services:
        memory = f"{each.memory_bytes / 2**20:.0f} MiB" if each.memory_bytes else ""
        held = f"{each.reserve_bytes / 2**20:.0f} MiB" if each.reserve_bytes else ""
        reserve = "" if each.reserve == "none" else f"{each.reserve} {held}"
        table.add_row(each.name, each.state, str(each.pid or ""), f"{each.up_s:.0f} s", memory, reserve,
                      str(each.restarts), each.last_end, each.message)  # fmt: skip
    table_console().print(table)
