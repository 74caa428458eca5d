"""``rpod doctor`` from its arguments to its exit code."""

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
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
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK
from rpod_schemas.config.base import check
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.config.service import BusConfig, RouterConfig
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
        bus, listen, logs = _subject(facility, connect)
    except ConfigurationError as error:
        return failed("doctor", error)
    if not as_json:
        print("checking; the disk and the link take some seconds", file=sys.stderr)
    findings = list(_examine(bus, listen, directory or logs, other_router))
    bad = [each for each in findings if each.level is Level.FAIL]
    if as_json:
        told = {"version": __version__, "ok": not bad, "findings": [asdict(each) for each in findings]}
        print(json.dumps(told, indent=2))
    else:
        _print(findings)
    return EXIT_FAILURE if bad else EXIT_OK


def _subject(facility: Path | None, connect: str | None) -> tuple[BusConfig, str | None, Path]:
    """Return the bus, the endpoint on which this host's router listens, and the folder of logs."""
    bus, listen, logs = BusConfig(), None, Path("runs")
    if facility is not None:
        resolved = resolve_facility(facility)
        bus = resolved.file.bus
        for service in resolved.services:
            if isinstance(service.config, RouterConfig):
                listen = service.config.listen
            elif isinstance(service.config, LoggerConfig):
                logs = service.config.directory
    changes = {"wait": False, "connect_timeout_s": _TIMEOUT_S} | ({"connect": connect} if connect else {})
    return check(BusConfig, bus.model_dump() | changes, source="--connect"), listen, logs


def _examine(bus: BusConfig, listen: str | None, logs: Path, other: str | None) -> Iterator[Finding]:
    yield from host.versions()
    yield host.clock()
    yield from host.room()
    yield from host.disk(logs)
    if bus.credentials is not None:
        yield _certificate(bus.credentials)
    try:
        found = list(over_bus.link(bus))
    except RpodError as error:
        remedy = "start it: rpod up, or rpod router"
        found = [
            Finding(f"link {bus.connect}", Level.FAIL if listen is None else Level.NOTE, str(error), remedy)
        ]
        reachable = False
    else:
        reachable = True
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

    warning = ExpiryWatch(folder).warning()
    if warning:
        return Finding("certificate", Level.FAIL, warning, "rpod pki renew, and copy the folder to this host")
    return Finding("certificate", Level.OK, f"{folder} can be used")


def _print(findings: list[Finding]) -> None:
    table = Table(title=f"rpod {__version__}, this host", title_justify="left")
    for heading in ("check", "", "found", "do"):
        table.add_column(heading)
    for each in findings:
        table.add_row(each.check, Text(each.level, _STYLES[each.level]), each.text, each.remedy)
    table_console().print(table)
