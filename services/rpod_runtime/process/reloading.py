"""Reads the configuration of a running service again, and puts into force what may change while it runs.

Which fields may change stands beside them in the schema (``LIVE``). Fields on which the messages of a service
depend are not among them: a log has one configuration of each service, by which it is replayed.
"""

import json
import logging
from collections.abc import Callable
from threading import Lock
from typing import Any

from pydantic import BaseModel

from rpod_runtime.errors import RefusedError
from rpod_schemas.config.base import live_fields
from rpod_schemas.reload import ReloadReply

log = logging.getLogger(__name__)

OnChange = Callable[[BaseModel, ReloadReply], None]
"""Gets the configuration that is in force now, and what has changed."""


class Reloader:
    """The configuration of this process. Safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._config: BaseModel | None = None
        self._read: Callable[[], BaseModel] | None = None
        self._listeners: list[OnChange] = []

    def begin(self, config: BaseModel, read: Callable[[], BaseModel] | None) -> None:
        """Take the configuration with which the process starts; ``read`` reads and checks it again."""
        self._config, self._read, self._listeners = config, read, []

    def is_of(self, config: BaseModel) -> bool:
        """Return whether a configuration is the one of this process, which can be read again."""
        return self._config is config and self._read is not None

    def on_change(self, tell: OnChange) -> None:
        """Call ``tell`` after each reading; it puts into force what has changed."""
        self._listeners.append(tell)

    def reload(self) -> ReloadReply:
        """Read the configuration again.

        Raises:
            ConfigurationError: it is wrong; everything stays as it is.
            RefusedError: the service was started without a file.
            AuditError: the command cannot be recorded; everything stays as it is.
        """
        with self._lock:
            if self._config is None or self._read is None:
                raise RefusedError("started without a configuration file: there is nothing to read again")
            new, old = self._read(), self._config
            live = live_fields(type(old))
            changed = {name: getattr(new, name) for name in live if getattr(new, name) != getattr(old, name)}
            config = old.model_copy(update=changed)
            document = _plain(config)
            reply = ReloadReply(
                changed={name: document[name] for name in sorted(changed)},
                needs_restart=tuple(sorted(_differences(document, _plain(new)))),
            )
            for tell in self._listeners:
                tell(config, reply)
            self._config = config
            if "log_level" in changed:
                logging.getLogger().setLevel(str(document["log_level"]).upper())
            log.warning("the configuration was read again: %s", describe(reply))
            return reply


def describe(reply: ReloadReply) -> str:
    """Return in words what a reading has changed, and what it has not."""
    parts = [f"{name} is {_short(value)}" for name, value in reply.changed.items()] or ["nothing changes"]
    if reply.needs_restart:
        names = ", ".join(reply.needs_restart)
        parts.append(f"cannot change while it runs: {names}; restart the service, or correct the file")
    return "; ".join(parts)


def _plain(config: BaseModel) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(config.model_dump_json())
    return document


def _differences(old: Any, new: Any, place: str = "") -> list[str]:
    """Return the fields, joined by dots, in which two documents differ."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return [] if old == new else [place]
    names = sorted({*old, *new})
    inner = f"{place}." if place else ""
    return [found for n in names for found in _differences(old.get(n), new.get(n), f"{inner}{n}")]


def _short(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


reloader = Reloader()
"""The configuration of this process."""
