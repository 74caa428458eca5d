"""The installed sensor kinds and methods: the project's own and those of other packages."""

from rpod_schemas.registry import METHODS, SENSORS, check_type, names
from rpod_schemas.sensors.kind import Method, Part, Role, SensorKind

__all__ = ["Method", "Part", "Role", "SensorKind", "method", "methods", "sensor_kind", "sensor_kinds"]


def sensor_kind(name: str) -> SensorKind:
    """Return a kind by its name. Raises ``UnknownNameError``, ``RegistryError``."""
    kind: SensorKind = check_type(SENSORS, name, SensorKind)
    return kind


def sensor_kinds() -> tuple[SensorKind, ...]:
    """Return all kinds in the order of their names. Raises ``RegistryError``."""
    return tuple(sensor_kind(name) for name in names(SENSORS))


def method(sensor: str, name: str) -> Method:
    """Return a method of a sensor kind by its name. Raises ``UnknownNameError``, ``RegistryError``."""
    found: Method = check_type(METHODS, f"{sensor}.{name}", Method)
    return found


def methods(sensor: str, role: Role | None = None) -> tuple[Method, ...]:
    """Return the methods of a sensor kind in the order of their names, those of one role or all."""
    prefix = f"{sensor}."
    found = (method(sensor, name.removeprefix(prefix)) for name in names(METHODS) if name.startswith(prefix))
    return tuple(each for each in found if role in (None, each.role))
