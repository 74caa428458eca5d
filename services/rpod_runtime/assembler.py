"""From parts to frames, and from frames to the newest complete one (ICD section 2, frame assembly).

Pure bookkeeping on stamps: parts are whatever the caller hands in, decoded only once their frame
is chosen. One slot a sensor; a frame that is passed over is counted, not processed.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Generic, TypeVar

PartT = TypeVar("PartT")

_PENDING = 8
"""Frames that may wait for parts at once; older ones are given up."""
_PATIENCE = 10
"""Frames without an optional part after which it is no longer waited for, until it is seen again."""
_REMEMBERED = 64
"""Frames whose late parts are known to belong to them."""


@dataclass(frozen=True)
class Assembled(Generic[PartT]):
    """The parts of one frame, by name."""

    stamp_ns: int
    parts: dict[str, PartT]


@dataclass
class Assembler(Generic[PartT]):
    """Collects parts that carry the same stamp; the stamps of its frames rise.

    Parts of one frame keep no order among themselves, nor with those of the next: the bus hands over each
    topic in a thread of its own.

    A frame is complete with all its required parts and, as long as they keep coming, its optional
    ones; an optional part that is missing is not waited for beyond the next frame's first part, nor, as
    ``release`` has it, once nothing comes any more.
    """

    required: frozenset[str]
    optional: frozenset[str] = frozenset()
    incomplete: int = 0
    """Frames given up: a newer one was complete first."""
    done_ns: int = -1
    """Stamp of the last complete frame: what is not newer comes too late."""
    _pending: dict[int, dict[str, PartT]] = field(default_factory=dict)
    _past: deque[int] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    _without_optional: int = 0

    def add(self, name: str, stamp_ns: int, part: PartT) -> list[Assembled[PartT]]:
        """Take a part; return the frames that it completes, oldest first."""
        if stamp_ns <= self.done_ns or stamp_ns in self._past:
            self._note_straggler(name, stamp_ns)
            return []
        self._pending.setdefault(stamp_ns, {})[name] = part
        newest_ns = max(self._pending)
        complete = [
            self._finish(pending_ns)
            for pending_ns in sorted(self._pending)
            if self._satisfied(self._pending[pending_ns], newest=pending_ns == newest_ns)
        ]
        while len(self._pending) > _PENDING:
            self._give_up(min(self._pending))
        return complete

    def release(self) -> list[Assembled[PartT]]:
        """Return the frames that lack optional parts only, oldest first: nothing comes any more."""
        ready = [stamp_ns for stamp_ns, parts in self._pending.items() if self.required <= parts.keys()]
        return [self._finish(stamp_ns) for stamp_ns in sorted(ready)]

    def _satisfied(self, parts: dict[str, PartT], *, newest: bool) -> bool:
        waits = newest and self._without_optional < _PATIENCE
        return self.required <= parts.keys() and (not waits or self.optional <= parts.keys())

    def _finish(self, stamp_ns: int) -> Assembled[PartT]:
        parts = self._pending.pop(stamp_ns)
        missing = bool(self.optional - parts.keys())
        self._without_optional = self._without_optional + 1 if missing else 0
        for older_ns in [pending_ns for pending_ns in self._pending if pending_ns < stamp_ns]:
            self._give_up(older_ns)
        self.done_ns = stamp_ns
        self._past.append(stamp_ns)
        return Assembled(stamp_ns, parts)

    def _give_up(self, stamp_ns: int) -> None:
        self._pending.pop(stamp_ns, None)
        self._past.append(stamp_ns)
        self.incomplete += 1

    def _note_straggler(self, name: str, stamp_ns: int) -> None:
        """Wait again for an optional part that comes before the next frame, if after the required ones."""
        if stamp_ns not in self._past:
            self._give_up(stamp_ns)
        elif name in self.optional and stamp_ns == self.done_ns and not self._pending:
            self._without_optional = 0


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
