"""From parts to frames, and from frames to the newest complete one (ICD section 2, frame assembly).

Pure bookkeeping on stamps: parts are whatever the caller hands in, decoded only once their frame
is chosen. One slot a sensor; a frame that is passed over is counted, not processed.
"""

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Generic, TypeVar

PartT = TypeVar("PartT")

_PENDING = 8
"""Frames that may wait for parts at once; older ones are given up."""
_PATIENCE = 10
"""Frames without an optional part after which it is no longer waited for."""


@dataclass(frozen=True)
class Assembled(Generic[PartT]):
    """The parts of one frame, by name."""

    stamp_ns: int
    parts: dict[str, PartT]


@dataclass
class Assembler(Generic[PartT]):
    """Collects parts that carry the same stamp.

    A frame is complete with all its required parts and, as long as they keep coming, its optional
    ones; an optional part that is missing is not waited for beyond the next frame's first part.
    """

    required: frozenset[str]
    optional: frozenset[str] = frozenset()
    incomplete: int = 0
    """Frames given up."""
    _pending: OrderedDict[int, dict[str, PartT]] = field(default_factory=OrderedDict)
    _without_optional: int = 0
    _done_ns: int = -1

    def add(self, name: str, stamp_ns: int, part: PartT) -> list[Assembled[PartT]]:
        """Take a part; return the frames that it completes, oldest first."""
        if stamp_ns <= self._done_ns:
            return []
        complete = [] if stamp_ns in self._pending else self._give_up_waiting()
        parts = self._pending.setdefault(stamp_ns, {})
        parts[name] = part
        if self._satisfied(parts):
            complete.append(self._finish(stamp_ns))
        while len(self._pending) > _PENDING:
            self._pending.popitem(last=False)
            self.incomplete += 1
        return complete

    def _satisfied(self, parts: dict[str, PartT]) -> bool:
        patient = self._without_optional < _PATIENCE
        return self.required <= parts.keys() and (not patient or self.optional <= parts.keys())

    def _give_up_waiting(self) -> list[Assembled[PartT]]:
        """Finish the frames that lack optional parts only: a newer frame has begun."""
        ready = [stamp_ns for stamp_ns, parts in self._pending.items() if self.required <= parts.keys()]
        return [self._finish(stamp_ns) for stamp_ns in ready]

    def _finish(self, stamp_ns: int) -> Assembled[PartT]:
        parts = self._pending.pop(stamp_ns)
        missing = bool(self.optional - parts.keys())
        self._without_optional = self._without_optional + 1 if missing else 0
        for older in [pending for pending in self._pending if pending < stamp_ns]:
            del self._pending[older]
            self.incomplete += 1
        self._done_ns = stamp_ns
        return Assembled(stamp_ns, parts)


@dataclass
class NewestFrames(Generic[PartT]):
    """One slot a sensor for its newest complete frame."""

    _slots: dict[str, Assembled[PartT]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self._slots)

    def put(self, sensor: str, frame: Assembled[PartT]) -> bool:
        """Offer a frame; return whether one was passed over for it."""
        passed_over = sensor in self._slots
        self._slots[sensor] = frame
        return passed_over

    def take(self) -> tuple[str, Assembled[PartT]] | None:
        """Return the sensor and frame with the oldest stamp, then by name; None where all slots are empty."""
        if not self._slots:
            return None
        sensor = min(self._slots, key=lambda name: (self._slots[name].stamp_ns, name))
        return sensor, self._slots.pop(sensor)
