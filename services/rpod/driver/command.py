"""``rpod driver list`` and ``rpod driver run`` from their arguments to their exit codes."""

import json
import sys
from pathlib import Path
from threading import Event
from typing import Any

from rpod import __version__
from rpod.reloading import run_reloading
from rpod_driver import DriverError, host
from rpod_driver.registered import Adapter, adapter, adapters
from rpod_runtime.lifecycle import EXIT_FAILURE, EXIT_OK, EXIT_USAGE
from rpod_schemas.config.base import check, read_document
from rpod_schemas.config.driver import DriverConfig
from rpod_schemas.errors import SchemaError


def list_command(*, as_json: bool) -> int:
    """Print the installed drivers; return the exit code."""
    try:
        found = adapters()
    except SchemaError as error:
        print(f"rpod driver list: {error}", file=sys.stderr)
        return EXIT_FAILURE
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


def _checked(found: Adapter, file: Path, options: dict[str, Any]) -> DriverConfig:
    document = read_document(file)
    bus = document.get("bus") or {}
    if isinstance(bus, dict):  # otherwise the check below reports the error
        document["bus"] = bus | {key: value for key, value in options.items() if value}
    return check(found.config, document, source=file)
