"""``rpod driver check`` from its arguments to its exit code."""

import json
import sys
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from threading import Event
from typing import Any

from rich.table import Table
from rich.text import Text

from rpod import __version__
from rpod.console import table_console
from rpod.errors import failed
from rpod_driver.check import CheckResult, Level, Observations, Observer, Options, judge
from rpod_driver.check.live import watch
from rpod_driver.check.surface import Surface
from rpod_driver.registered import adapters
from rpod_runtime import BusError, Node
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK, EXIT_USAGE
from rpod_schemas.config.base import Config, Name, check, read_document
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.config.service import BusConfig, ServiceConfig
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.errors import ConfigurationError, SchemaError
from rpod_schemas.sensors import sensor_kinds

_SILENCE = "silence"
"""Fault of a sensor from which no frame arrived."""
_STYLES = {Level.OK: "green", Level.NOTE: "cyan", Level.FAIL: "bold red", Level.UNCHECKED: "yellow"}


class _Estimate(Config):
    against: Name
    """Prefix of an estimate."""


@dataclass(frozen=True)
class CheckOptions:
    """Properties of a sensor from the command line."""

    name: str
    kind: str | None
    config: Path | None
    source: Path | None
    connect: str | None
    rate_hz: float | None
    target: str | None
    against: str | None = None
    wait: bool = False
    search: bool = False


def check_command(options: CheckOptions, *, duration_s: float, as_json: bool) -> int:
    """Watch a sensor, print a result a line, and return 0 if none of them fails, 1 if one does."""
    try:
        driver, bus = _driver(options)
        target = _target(options)
        known = Options(
            rate_hz=options.rate_hz,
            source=_source(options.source),
            surface=Surface.of(target) if target else None,
            against=_prefix(options),
        )
    except SchemaError as error:
        return failed("driver check", error)
    for name, value in (("duration", duration_s), ("rate", options.rate_hz)):
        if value is not None and not 0.0 < value < inf:
            reason = f"--{name} is {value:g}; give a finite number above 0"
            return failed("driver check", reason, EXIT_USAGE)
    observer = Observer(driver.kind, driver.name, known)
    config = ServiceConfig(instance="driver-check", bus=bus)
    if not as_json:
        print(f"watching {driver.name} ({driver.kind}) for {duration_s:g} s", file=sys.stderr)
    try:
        with Node(config, version=__version__, stop=Event()) as node:
            seen = watch(node, observer, duration_s=duration_s, stop=node.stop)
    except BusError as error:
        return failed("driver check", error)
    except KeyboardInterrupt:
        return failed("driver check", "interrupted")
    results = judge(seen)
    if options.search and target:
        if not as_json:
            print("searching for the target in some frames; this may take minutes", file=sys.stderr)
        results.append(_searched(seen, target))
    wrong = [each for each in results if each.level is Level.FAIL]
    if as_json:
        print(json.dumps(_document(driver, duration_s, results), indent=2))
    else:
        show(results)
    return EXIT_FAILURE if wrong else EXIT_OK


def _driver(options: CheckOptions) -> tuple[DriverConfig, BusConfig]:
    if options.config:
        driver = driver_of(options.config, options.kind)
    else:
        kind = options.kind or kind_of_name(options.name)
        driver = check(DriverConfig, {"kind": kind, "name": options.name}, source="rpod driver check")
    # A driver waits for its router; a check reports that there is none.
    bus = driver.bus.model_dump() | {"wait": options.wait}
    bus |= {"connect": options.connect} if options.connect else {}
    return driver, check(BusConfig, bus, source="rpod driver check")


def kind_of_name(name: str) -> str:
    """Return the kind whose name a sensor's name begins with; that of a PMD camera for any other name."""
    return next((kind.name for kind in sensor_kinds() if name.startswith(kind.name)), "pmd")


def driver_of(file: Path, kind: str | None = None) -> DriverConfig:
    """Return kind, name and bus of the configuration of any driver, with or without ``device``.

    Args:
        file: configuration for ``rpod driver run``, or for a driver of one's own.
        kind: kind of the sensor, if the file names none; else it is that of the driver that accepts the file.

    Raises:
        ConfigurationError: the file cannot be read, a field is wrong, or nothing tells the kind.
    """
    document = read_document(file)
    facts = {field: document[field] for field in ("kind", "name", "bus") if field in document}
    if "kind" not in facts:
        facts["kind"] = kind or _kind_by_adapters(document, file)
    return check(DriverConfig, facts, source=file)


def _kind_by_adapters(document: dict[str, Any], file: Path) -> str:
    kinds: dict[str, list[str]] = {}
    for each in adapters():
        with suppress(ConfigurationError):
            kinds.setdefault(check(each.config, document, source=file).kind, []).append(each.name)
    if len(kinds) == 1:
        return next(iter(kinds))
    fitting = " and ".join(f"{', '.join(names)} ({kind})" for kind, names in kinds.items())
    reason = f"drivers of several kinds accept the file: {fitting}" if kinds else "no driver accepts the file"
    raise ConfigurationError(file, "kind", f"is missing, and {reason}; write it there, or give --kind")


def _source(path: Path | None) -> SourceConfig:
    return SourceConfig() if path is None else check(SourceConfig, read_document(path), source=path)


def _target(options: CheckOptions) -> Any:
    """Return the target of ``--target``, None without it."""
    from rpod_target import TargetError, load_target  # noqa: PLC0415 - needs the extra [target]

    if options.target is None:
        if options.search:
            raise ConfigurationError("--search", "", "needs --target, the target to search")
        return None
    try:
        return load_target(options.target)
    except TargetError as error:
        raise ConfigurationError("--target", "", str(error)) from error


def _searched(seen: Observations, target: Any) -> CheckResult:
    from rpod_driver.searched import searched  # noqa: PLC0415 - loads the methods of pose estimation

    return searched(seen, target)


def _prefix(options: CheckOptions) -> str | None:
    if options.against is None:
        return None
    if options.target is None:
        raise ConfigurationError("--against", "", "needs --target, the target of the estimate")
    return check(_Estimate, {"against": options.against}, source="option").against


def _document(driver: DriverConfig, duration_s: float, results: list[CheckResult]) -> dict[str, Any]:
    return {
        "sensor": driver.name,
        "kind": driver.kind,
        "duration_s": duration_s,
        "ok": not any(each.level is Level.FAIL for each in results),
        "faults": list(dict.fromkeys(fault for each in results for fault in each.faults)),
        "verdicts": [each.model_dump(mode="json") | {"remedy": each.remedy} for each in results],
    }


def show(results: list[CheckResult]) -> None:
    """Print a result a line."""
    table = Table(box=None, pad_edge=False)
    for column in ("line", "result", "figures and remedy"):
        table.add_column(column, overflow="fold")
    for each in _folded(results):
        faults = f" [{', '.join(each.faults)}] {each.remedy}" if each.faults else ""
        table.add_row(each.line, Text(each.level, _STYLES[each.level]), each.text + faults)
    table_console().print(table)


def _folded(results: list[CheckResult]) -> list[CheckResult]:
    """Return the results to show; if no frame arrived, those with a cause, and one line for the others."""
    told = [each for each in results if each.level is not Level.UNCHECKED]
    if not any(each.level is Level.FAIL and _SILENCE in each.faults for each in told):
        return results
    rest = len(results) - len(told)
    causes = sorted(told, key=lambda each: each.level is not Level.FAIL)
    return [
        *causes,
        CheckResult(line="others", level=Level.UNCHECKED, text=f"{rest} further checks need frames"),
    ]
