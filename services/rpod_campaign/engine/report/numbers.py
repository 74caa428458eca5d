"""Numbers as tables show them; a dash for a missing one."""

import math
from collections.abc import Mapping
from typing import Any

NONE = "-"


def number(value: float | None, form: str = ".3g", *, unit: str = "") -> str:
    """Return a number in a format, with its unit."""
    if value is None or not math.isfinite(value):
        return NONE
    return f"{value:{form}}{unit}"


def milliseconds(value_s: float | None) -> str:
    """Return a time in ms."""
    return number(None if value_s is None else 1e3 * value_s, ".2f")


def millimetres(value_m: float | None, form: str = ".1f") -> str:
    """Return a length in mm."""
    return number(None if value_m is None else 1e3 * value_m, form)


def percent(value: float | None) -> str:
    """Return a share in percent."""
    return number(None if value is None else 100.0 * value, ".1f", unit=" %")


def word(value: Any) -> str:
    """Return a parameter as a word."""
    if value is None:
        return NONE
    return f"{value:g}" if isinstance(value, float) else str(value)


def printed(values: Mapping[Any, Any], key: Any) -> str:
    """Return the value that a paper prints; blank if it prints none."""
    return str(values[key]) if key in values else ""


def in_world(name: str, world: str, surroundings: str = "none") -> str:
    """Return a name, followed by its world and its surroundings where they are not the usual ones."""
    unusual = (world,) * (world != "documented") + (surroundings,) * (surroundings != "none")
    return ", ".join((name, *unusual))
