"""Runs a service whose file is read again at SIGHUP; what cannot change without a restart is named."""

import logging
from collections.abc import Callable
from threading import Event

from pydantic import BaseModel

from rpod_runtime import lifecycle

log = logging.getLogger(__name__)


def run_reloading(
    instance: str,
    body: Callable[[Event], None],
    checked: BaseModel,
    read: Callable[[], BaseModel] | None,
) -> int:
    """Run a service with a checked configuration; ``read`` reads it again. Return the exit code."""
    started = checked.model_dump(mode="json")
    level = str(started["log_level"])
    if read is None:
        return lifecycle.run(instance, body, log_level=level)

    def reload() -> str:
        new = read().model_dump(mode="json")
        rest = sorted(name for name in new if name != "log_level" and new[name] != started.get(name))
        if rest:
            log.warning("a restart is needed for the changes of %s", ", ".join(rest))
        return str(new["log_level"])

    return lifecycle.run(instance, body, log_level=level, reload=reload)
