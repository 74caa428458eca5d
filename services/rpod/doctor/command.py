"""``rpod doctor`` from its arguments to its exit code."""

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rich.table import Table
from rich.text import Text

from rpod import __version__
from rpod.console import table_console
from rpod.doctor import bus as over_bus
from rpod.doctor import host
from rpod.doctor.finding import Finding, Level
from rpod.errors import failed
from rpod.up.resolved import resolve_facility
from rpod_runtime.errors import NoRouterError, RefusedByRouterError
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK
from rpod_schemas.config.base import check
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig
from rpod_schemas.errors import ConfigurationError, RpodError

_STYLES = {Level.OK: "green", Level.NOTE: "cyan", Level.FAIL: "bold red", Level.UNCHECKED: "yellow"}
_TIMEOUT_S = 2.0


def doctor_command(
    facility: Path | None,
    *,
    connect: str | None,
    other_router: str | None,
    directory: Path | None,
    as_json: bool,
) -> int:
    """Check this host, print a finding a line, and return 0 if none of them fails, 1 if one does."""
    try:
        subject = _subject(facility, connect)
    except ConfigurationError as error:
        return failed("doctor", error)
    if not as_json:
        print("checking; the disk and the link take some seconds", file=sys.stderr)
    findings = list(_examine(subject, directory or subject.logs, other_router))
    bad = [each for each in findings if each.level is Level.FAIL]
    if as_json:
        told = {"version": __version__, "ok": not bad, "findings": [asdict(each) for each in findings]}
        print(json.dumps(told, indent=2))
    else:
        _print(findings)
    return EXIT_FAILURE if bad else EXIT_OK


@dataclass
class _Subject:
    """Things that are examined beside the host itself."""

    bus: BusConfig
    listen: str | None = None
    """Endpoint on which this host's router listens."""
    logs: Path = Path("runs")
    """Folder of the logs."""
    credentials: list[Path | None] = field(default_factory=list)
    """Folders of the credentials that services of this host have."""


def _subject(facility: Path | None, connect: str | None) -> _Subject:
    """Return what a facility's file and the options name. Raises ``ConfigurationError``."""
    found = _Subject(BusConfig())
    if facility is not None:
        resolved = resolve_facility(facility)
        found.bus = resolved.file.bus
        for service in resolved.services:
            if isinstance(service.config, RouterConfig):
                found.listen = service.config.listen
                found.credentials += service.config.credentials, service.config.link_credentials
            elif isinstance(service.config, ServiceConfig):
                found.credentials.append(service.config.bus.credentials)
            if isinstance(service.config, LoggerConfig):
                found.logs = service.config.directory
    found.credentials.append(found.bus.credentials)
    changes = {"wait": False, "connect_timeout_s": _TIMEOUT_S} | ({"connect": connect} if connect else {})
    found.bus = check(BusConfig, found.bus.model_dump() | changes, source="--connect")
    return found


def _examine(subject: _Subject, logs: Path, other: str | None) -> Iterator[Finding]:
    bus, listen = subject.bus, subject.listen
    yield from host.versions()
    yield host.clock()
    yield from host.room()
    yield from host.disk(logs)
    yield from map(_certificate, dict.fromkeys(filter(None, subject.credentials)))
    try:
        found = list(over_bus.link(bus))
        reachable = True
    except NoRouterError as error:
        level, remedy = Level.FAIL if listen is None else Level.NOTE, "start it: rpod up, or rpod router"
        found, reachable = [Finding(f"link {bus.connect}", level, str(error), remedy)], False
    except RpodError as error:  # its text says what to do
        found = [Finding(f"link {bus.connect}", Level.FAIL, str(error))]
        reachable = isinstance(error, RefusedByRouterError)
    if listen is not None:
        yield host.port(listen, reachable=reachable)
    yield from found
    if other and reachable:
        try:
            yield over_bus.routers(bus, other)
        except RpodError as error:
            yield Finding(f"router {other}", Level.FAIL, str(error), "start it, and check the firewall")


def _certificate(folder: Path) -> Finding:
    from rpod_security.credentials import ExpiryWatch  # noqa: PLC0415 - of an extra

    check, warning = f"certificate {folder.name}", ExpiryWatch(folder).warning()
    if warning:
        remedy = "rpod pki renew, and copy the folder to this host"
        return Finding(check, Level.FAIL, warning, remedy)
    return Finding(check, Level.OK, f"{folder} can be used")


def _print(findings: list[Finding]) -> None:
    table = Table(title=f"rpod {__version__}, this host", title_justify="left")
    for heading in ("check", "", "found", "do"):
        table.add_column(heading)
    for each in findings:
        table.add_row(each.check, Text(each.level, _STYLES[each.level]), each.text, each.remedy)
    table_console().print(table)
