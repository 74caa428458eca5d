"""Runs a service whose file is read again at SIGHUP, or when an operator asks for it."""

from collections.abc import Callable
from threading import Event

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
