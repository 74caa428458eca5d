"""Faults that an operator requests: lost depth, glints, blackout and silence."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["dropout", "glints", "blackout", "silence"]

_LOST_SHARE = {"dropout": 0.6, "glints": 0.4, "blackout": 1.0}
_PATCHES = 12
"""Number of patches along each side of the image; a fault takes whole patches, not single pixels."""


@dataclass(frozen=True)
class Fault:
    """One fault with its start and its end."""

    kind: Kind
    start_ns: int
    end_ns: int


@dataclass
class Faults:
    """The faults that were requested."""

    _faults: list[Fault] = field(default_factory=list)

    def add(self, fault: Fault) -> None:
        """Add a fault."""
        self._faults.append(fault)

    def at(self, stamp_ns: int) -> Kind | None:
        """Return the fault at a stamp, the last requested one if there are several; None if there is none."""
        for fault in reversed(self._faults):
            if fault.start_ns <= stamp_ns < fault.end_ns:
                return fault.kind
        return None


def takes_amplitude(kind: Kind | None) -> bool:
    """Return whether a fault removes the amplitude as well as the depth, as saturated pixels do."""
    return kind in {"glints", "blackout"}


def lost_cells(
    kind: Kind | None, shape: tuple[int, ...], *, seed: int, number: int
) -> NDArray[np.bool_] | None:
    """Return a mask, of the given shape, of the cells that a fault removes; None for no fault."""
    if kind is None or kind == "silence":
        return None
    generator = np.random.default_rng([seed, number, 0xFA17])
    lost = generator.random((_PATCHES, _PATCHES)) < _LOST_SHARE[kind]
    rows = np.arange(shape[0]) * _PATCHES // shape[0]
    columns = np.arange(shape[1]) * _PATCHES // shape[1]
    return lost[np.ix_(rows, columns)]
