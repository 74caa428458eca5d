"""Runs a service whose file is read again at SIGHUP, or when an operator asks for it."""

from collections.abc import Callable, Mapping
from threading import Event
from typing import Any

from pydantic import BaseModel

from rpod_runtime.process import lifecycle
from rpod_runtime.process.reloading import reloader


def run_reloading(
    instance: str,
    body: Callable[[Event], None],
    checked: BaseModel,
    read: Callable[[], BaseModel] | None,
) -> int:
    """Run a service with a checked configuration; ``read`` reads it again. Return the exit code."""
    reloader.begin(checked, read)
    level = str(checked.model_dump(mode="json")["log_level"])
    return lifecycle.run(instance, body, log_level=level, reload=reloader.reload)


def with_bus(document: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document whose section ``bus`` has the given options of the command line.

    A section of another form is left alone: the check of the document refuses it.
    """
    bus = document.get("bus") or {}
    if not isinstance(bus, dict):
        return dict(document)
    return {**document, "bus": bus | {key: value for key, value in options.items() if value}}
