"""Registry of the sensor kinds, methods and drivers of installed packages, found by their entry points.

A package declares ``name = "module:attribute"`` under the group ``rpod.sensors``, ``rpod.methods`` or
``rpod.drivers``. An entry is loaded when it is requested by its name. Its object imports little: modules that
take long to import (emulators, compiled methods, libraries of devices) are named by a reference
``module:attribute``, which the process that needs them imports.
"""

from difflib import get_close_matches
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pkgutil import resolve_name
from typing import Any

from rpod_schemas.errors import SchemaError
from rpod_schemas.texts import shown

SENSORS, METHODS, DRIVERS = "rpod.sensors", "rpod.methods", "rpod.drivers"
"""Entry point groups: sensor kinds by ``<kind>``, methods by ``<kind>.<method>``, drivers by their name."""


class RegistryError(SchemaError):
    """Raised for an entry point that cannot be used; names the package, the entry and the reason."""

    def __init__(self, entry: EntryPoint, reason: str) -> None:
        package = entry.dist.name if entry.dist else "an unknown package"
        super().__init__(
            f"{entry.group}: {entry.name} = {entry.value!r} of the package {package!r} {reason}; "
            "repair or uninstall the package"
        )


class UnknownNameError(SchemaError):
    """Raised for a name that no installed package provides."""

    def __init__(self, group: str, name: str, known: tuple[str, ...]) -> None:
        meant = get_close_matches(name, known, n=1)
        guess = f" (did you mean {meant[0]!r}?)" if meant else ""
        listed = ", ".join(known) or "none (rpod itself provides some: install it again, as make setup does)"
        super().__init__(
            f"no installed package provides {shown(repr(name), 200)}{guess} in {group}, known are {listed}; "
            f"correct the name, or install a package that registers it under {group}"
        )


@cache
def _entries(group: str) -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=group):
        known = found.setdefault(entry.name, entry)
        if known.value != entry.value:
            other = known.dist.name if known.dist else "another package"
            raise RegistryError(entry, f"has the name of {known.value!r} of {other!r}")
    return found


def names(group: str) -> tuple[str, ...]:
    """Return the names that installed packages provide in a group, sorted; nothing is imported."""
    return tuple(sorted(_entries(group)))


def providers() -> tuple[str, ...]:
    """Return the top-level modules that provide sensor kinds and methods, sorted; nothing is imported."""
    entries = (entry for group in (SENSORS, METHODS) for entry in _entries(group).values())
    return tuple(sorted({entry.module.partition(".")[0] for entry in entries}))


@cache
def load(group: str, name: str) -> Any:
    """Return the object of a name.

    Raises:
        UnknownNameError: no installed package provides it.
        RegistryError: its package cannot be imported.
    """
    entry = _entries(group).get(name)
    if entry is None:
        alike = tuple(known for known in names(group) if known.startswith(_sensor_of(name)))
        raise UnknownNameError(group, name, alike)
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        raise RegistryError(entry, f"cannot be loaded ({error})") from error


def _sensor_of(name: str) -> str:
    """Return ``<kind>.`` for a method's name; empty for a kind's."""
    return name[: name.find(".") + 1]


def check_type(group: str, name: str, kind: type[Any]) -> Any:
    """Return the object of a name if it has a type. Raises like ``load``."""
    loaded = load(group, name)
    if not isinstance(loaded, kind):
        raise RegistryError(_entries(group)[name], f"is {type(loaded).__name__}, needs {kind.__name__}")
    return loaded


@cache
def resolve(reference: str) -> Any:
    """Return the object that ``module:attribute`` names; the module is imported."""
    return resolve_name(reference)
