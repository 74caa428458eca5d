"""The parameters of a node: its configuration, flattened, and what can be changed while it runs.

Names are the fields joined by dots, items of a list by their number: ``sensors.0.rate_hz``. Nothing here
knows the bus.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from threading import RLock
from typing import Any

from rpod_runtime.errors import RefusedError
from rpod_schemas.messages.ros import TYPE_NAMES, ParameterValue, parameter_type

_INT64 = 2**63
Change = Callable[[Any], None]
"""Puts a new value into force; it raises ``RefusedError`` or ``ValueError`` with the reason if it cannot."""
Assignment = tuple[str, ParameterValue]


@dataclass
class Parameter:
    """A parameter and, if it can be changed while the node runs, how."""

    value: ParameterValue
    description: str = ""
    constraints: str = ""
    """Which values are possible, in words."""
    change: Change | None = None


class Parameters:
    """The parameters of a node. Safe to use from several threads."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        self._lock = RLock()
        self._items = {name: Parameter(value) for name, value in flatten(document)}
        self._told: list[Callable[[Sequence[Assignment]], None]] = []

    def offer(
        self,
        name: str,
        value: ParameterValue,
        change: Change | None = None,
        *,
        description: str = "",
        constraints: str = "",
    ) -> None:
        """Add a parameter, or take the place of the configuration's of this name.

        Args:
            name: its name.
            value: its present value.
            change: puts another value into force; without it the parameter cannot be set.
            description: one line on what it is.
            constraints: which values are possible, in words.
        """
        with self._lock:
            self._items[name] = Parameter(value, description, constraints, change)

    def renew(self, name: str, value: ParameterValue) -> None:
        """Give a parameter its present value, and leave open whether it can be set; add it if it is new."""
        with self._lock:
            known = self._items.get(name)
            self._items[name] = Parameter(value) if known is None else replace(known, value=value)

    def on_change(self, tell: Callable[[Sequence[Assignment]], None]) -> None:
        """Call ``tell`` with names and new values after each change."""
        self._told.append(tell)

    def names(self) -> list[str]:
        """Return all names, sorted."""
        with self._lock:
            return sorted(self._items)

    def get(self, name: str) -> Parameter | None:
        """Return a parameter; None if there is none of this name."""
        with self._lock:
            return self._items.get(name)

    def value(self, name: str) -> ParameterValue:
        """Return a parameter's value; None if there is none of this name, or it is not set."""
        item = self.get(name)
        return item.value if item else None

    def set(self, assignments: Sequence[Assignment]) -> None:
        """Set all of some parameters, or none of them.

        Raises:
            RefusedError: one of them cannot be set to its value; the text gives the reason.
        """
        with self._lock:
            changes = [self._checked(name, value) for name, value in assignments]
            done: list[tuple[Change, ParameterValue]] = []
            for (name, value), change in zip(assignments, changes, strict=True):
                before = self._items[name].value
                try:
                    change(value)
                except (RefusedError, ValueError) as error:
                    for undo, earlier in reversed(done):
                        with suppress(RefusedError, ValueError):
                            undo(earlier)
                    raise RefusedError(f"{name}: {error}") from error
                done.append((change, before))
            for name, value in assignments:
                self._items[name].value = value
        for tell in self._told:
            tell(assignments)

    def _checked(self, name: str, value: ParameterValue) -> Change:
        item = self._items.get(name)
        if item is None:
            raise RefusedError(f"{name}: there is no such parameter; 'ros2 param list' shows them")
        if item.change is None:
            raise RefusedError(
                f"{name}: cannot change while the service runs; "
                "write it into the configuration and start the service again"
            )
        old, new = (TYPE_NAMES[parameter_type(each)] for each in (item.value, value))
        if old != new:
            raise RefusedError(f"{name}: is of type {old}, {new} was given")
        return item.change

    def listed(self, prefixes: Sequence[str], depth: int) -> tuple[list[str], list[str]]:
        """Return the names below some prefixes and the prefixes of these names, as rclcpp does.

        Args:
            prefixes: names, or parts of names that end before a dot; all parameters if there are none.
            depth: largest number of parts after the prefix; 0 for any.
        """
        found = [name for name in self.names() if _is_below(name, prefixes, depth)]
        stems = [name.rpartition(".")[0] for name in found]
        return found, list(dict.fromkeys(stem for stem in stems if stem))


def _is_below(name: str, prefixes: Sequence[str], depth: int) -> bool:
    def shallow(rest: str) -> bool:
        return depth == 0 or rest.count(".") < depth

    if not prefixes:
        return shallow(name)
    return any(
        name == prefix or (name.startswith(f"{prefix}.") and shallow(name[len(prefix) + 1 :]))
        for prefix in prefixes
    )


def flatten(document: Any, name: str = "") -> Iterator[Assignment]:
    """Yield names and values of a document of JSON; a list of values of one type is one value."""
    parts: Iterable[tuple[Any, Any]]
    if isinstance(document, Mapping):
        parts = document.items()
    elif isinstance(document, list) and not _is_array(document):
        parts = ((str(index), item) for index, item in enumerate(document))
    else:
        yield name, _value(document)
        return
    for part, item in parts:
        yield from flatten(item, f"{name}.{part}" if name else str(part))


def _is_array(items: list[Any]) -> bool:
    kinds = {type(item) for item in items}
    return kinds <= {int, float} or (len(kinds) == 1 and kinds <= {bool, str})


def _value(item: Any) -> ParameterValue:
    if isinstance(item, list) and any(isinstance(each, float) for each in item):
        return [float(each) for each in item]
    numbers = item if isinstance(item, list) else [item]
    if any(isinstance(each, int) and not -_INT64 <= each < _INT64 for each in numbers):
        return [str(each) for each in item] if isinstance(item, list) else str(item)
    return item if isinstance(item, bool | int | float | str | list | None) else str(item)
