"""Settings of an O3R by paths: its configuration is nested JSON, a driver's settings are not."""

from collections.abc import Iterator, Mapping
from typing import Any

from rpod_driver.errors import DriverError
from rpod_schemas.config.driver import Setting

_WRITABLE = ("acquisition", "mode", "processing", "state")
"""Parts of a port's settings that can be written; ``data`` and ``info`` describe the head."""
_TOLD = "version"
"""Part of ``acquisition`` and ``processing`` that can only be read."""


def scalars(port: Mapping[str, Any]) -> Iterator[tuple[str, Setting]]:
    """Yield path and value of each setting of a port's configuration, as ``acquisition/framerate``."""
    for name in _WRITABLE:
        if name in port:
            yield from _below(name, port[name])


def _below(path: str, value: Any) -> Iterator[tuple[str, Setting]]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            if name != _TOLD:
                yield from _below(f"{path}/{name}", inner)
    elif isinstance(value, bool | int | float | str):
        yield path, value


def nested(settings: Mapping[str, Setting]) -> dict[str, Any]:
    """Return settings as a port's configuration.

    Raises:
        DriverError: a path does not begin with a part of the port that can be written.
    """
    port: dict[str, Any] = {}
    for path, value in settings.items():
        *folders, name = path.split("/")
        if (folders or [name])[0] not in _WRITABLE:
            raise DriverError(
                f"setting {path!r} is none of the head's port; it begins with one of {', '.join(_WRITABLE)}, "
                "as acquisition/framerate"
            )
        place = port
        for folder in folders:
            place = place.setdefault(folder, {})
        place[name] = value
    return port
