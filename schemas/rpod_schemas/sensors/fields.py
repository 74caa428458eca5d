"""Annotations of configuration fields whose models are looked up among the installed ones."""

from rpod_schemas.config.sensor import MethodConfig, Registered
from rpod_schemas.errors import SchemaError
from rpod_schemas.registry import METHODS, SENSORS, UnknownNameError, names
from rpod_schemas.sensors import Role, method, methods, sensor_kind


class WrongRoleError(SchemaError):
    """Raised for a method that has another role."""

    def __init__(self, name: str, role: Role, known: tuple[str, ...]) -> None:
        super().__init__(f"{name!r} is no method for {role}, known are {', '.join(known)}")


EMULATED = Registered(lambda kind: sensor_kind(kind).emulated, lambda: names(SENSORS))
"""Annotation of a sensor to emulate."""
HEARD = Registered(lambda kind: sensor_kind(kind).heard, lambda: names(SENSORS))
"""Annotation of a sensor that the estimator uses."""


def chosen(sensor: str, role: Role, *, default: str = "") -> Registered:
    """Return the annotation of a sensor kind's method.

    Args:
        sensor: name of the kind.
        role: role of the method.
        default: method for a document that names none; if empty, the document must name one.
    """

    def known() -> tuple[str, ...]:
        return tuple(each.name for each in methods(sensor, role))

    def model_of(name: str) -> type[MethodConfig]:
        if f"{sensor}.{name}" not in names(METHODS):
            raise UnknownNameError(METHODS, name, known())
        found = method(sensor, name)
        if found.role != role:
            raise WrongRoleError(name, role, known())
        return found.config

    return Registered(model_of, known, default)
