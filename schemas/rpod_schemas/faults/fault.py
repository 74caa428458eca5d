"""Faults: kinds of failures that can be injected, each with its size."""

from dataclasses import dataclass
from typing import Literal

Evidence = Literal["rate", "truth", "plane", "info"]
"""Information without which a fault cannot be seen: the sensor's nominal rate; truth, mount and target model;
a plane in view, or truth; the sensor's info message."""
Subject = Literal["messages", "scene", "link", "process", "disk"]
"""Part that has the fault: a sensor's messages, the scene that it sees, a service's link to the router, its
process, or the logger's disk."""
BOTH = ("pmd", "lidar")


@dataclass(frozen=True)
class Size:
    """Range of the sizes of a fault."""

    unit: str
    default: float | None
    """Size where none is asked for; None if it is drawn by the seed."""
    low: float
    high: float

    def __str__(self) -> str:
        """Return the bounds with their unit, and the default."""
        default = "drawn by the seed" if self.default is None else f"default {self.default:g}"
        return f"{self.low:g} to {self.high:g} {self.unit}, {default}"


@dataclass(frozen=True)
class Fault:
    """One kind of fault."""

    name: str
    """Name in queries, scenarios and results of checks."""
    cause: str
    """Description of the fault, and its usual cause."""
    line: str
    """Line of ``rpod driver check`` that reports it; empty if none does."""
    remedy: str
    """Remedy."""
    kinds: tuple[str, ...] = BOTH
    """Kinds of sensors that can have it."""
    needs: Evidence | None = None
    """Input that the check needs to see it; None if the messages alone show it."""
    in_lockstep: bool = False
    """Whether it can be injected in lockstep: each frame still comes, once, under its own stamp."""
    from_start: bool = False
    """Whether it can only be injected from the start of the sensor."""
    subject: Subject = "messages"
    """Part of the facility that has the fault."""
    size: Size | None = None
    """Sizes that can be asked for; None for a fault of one size."""

    def amount(self, asked: float | None) -> float | None:
        """Return the size that is asked for, or the default; None if it has none, or if it is drawn."""
        if asked is None and self.size is not None:
            return self.size.default
        return asked

    def can_be_in(self, kind: str) -> bool:
        """Return whether a sensor of a kind can have it; of other packages' kinds that is not known."""
        return kind in self.kinds or kind not in BOTH

    @property
    def of_sensor(self) -> bool:
        """Whether the emulator injects it, into a sensor."""
        return self.subject in ("messages", "scene")
