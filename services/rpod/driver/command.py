"""The verbs of ``rpod driver`` except ``check``, from their arguments to their exit codes."""

import json
import sys
from dataclasses import asdict
from pathlib import Path
from threading import Event
from typing import Any

from rich.table import Table

from rpod import __version__
from rpod.console import table_console
from rpod.errors import failed
from rpod.reloading import run_reloading, with_bus
from rpod_driver import DriverError, host
from rpod_driver.registered import Adapter, adapter, adapters
from rpod_driver.scaffold import ScaffoldError, scaffold
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK, EXIT_USAGE
from rpod_schemas.config.base import check, read_document
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.errors import SchemaError
from rpod_schemas.faults import ALL_FAULTS


def list_command(*, as_json: bool) -> int:
    """Print the installed drivers; return the exit code."""
    try:
        found = adapters()
    except SchemaError as error:
        return failed("driver list", error, EXIT_FAILURE)
    if as_json:
        told = [
            {"name": each.name, "title": each.title, "needs": each.needs, "tested": each.tested}
            for each in found
        ]
        print(json.dumps({"drivers": told}, indent=2))
        return EXIT_OK
    for each in found:
        print(f"{each.name:10} {each.title}")
        print(f"{'':10} tested {each.tested}" + (f"; needs {each.needs}" if each.needs else ""))
    return EXIT_OK


def run_command(name: str, file: Path, *, connect: str | None, wait: bool) -> int:
    """Run a driver until its source ends or it is stopped; return the exit code."""
    try:
        found = adapter(name)
        config = _checked(found, file, {"connect": connect, "wait": wait})
        driver = found.open(config)
    except SchemaError as error:
        print(f"rpod: {error}", file=sys.stderr)
        return EXIT_USAGE
    except DriverError as error:
        print(f"rpod: {error}", file=sys.stderr)
        return EXIT_FAILURE

    def body(stop: Event) -> None:
        host.run(driver, config, version=__version__, stop=stop)

    def read() -> DriverConfig:
        return _checked(found, file, {"connect": connect, "wait": wait})

    return run_reloading(config.instance, body, config, read)


def new_command(template: str, name: str, *, out: Path) -> int:
    """Write a driver's package; return the exit code."""
    try:
        folder = scaffold(template, name, out)
    except ScaffoldError as error:
        print(f"rpod: {error}", file=sys.stderr)
        return EXIT_USAGE
    except OSError as error:
        return failed("driver new", error)
    print(
        f"{folder}: next, pip install -e {folder} and python -m pytest {folder}; then read {folder}/README.md"
    )
    return EXIT_OK


def faults_command(*, as_json: bool) -> int:
    """Print the catalogue of faults."""
    if as_json:
        print(json.dumps([asdict(fault) for fault in ALL_FAULTS], indent=2))
        return EXIT_OK
    table = Table(box=None, pad_edge=False)
    for column in ("fault", "of", "size", "line", "cause"):
        table.add_column(column, overflow="fold")
    for fault in ALL_FAULTS:
        size = "" if fault.size is None else str(fault.size)
        table.add_row(fault.name, fault.subject, size, fault.line, fault.cause)
    table_console().print(table)
    return EXIT_OK


def _checked(found: Adapter, file: Path, options: dict[str, Any]) -> DriverConfig:
    return check(found.config, with_bus(read_document(file), options), source=file)
