"""Assembles frames from their parts, and keeps the newest complete frame (ICD section 2, frame assembly).

The assembler compares stamps only. A part may be of any type; it is decoded when its frame is processed.
Each sensor has one slot. A frame that a newer one replaces is counted and not processed.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Generic, TypeVar

PartT = TypeVar("PartT")

_PENDING = 8
"""Largest number of frames that wait for parts; older ones are given up."""
_PATIENCE = 10
"""Frames in a row without an optional part after which the assembler stops waiting for that part."""
_REMEMBERED = 64
"""Number of finished frames whose late parts are still recognised."""
_HELD = 16
"""Number of messages of a lasting part that are kept, for frames that are older than the newest of them."""
_USUAL = 3
"""Number of consecutive frames with a lasting part of their own after which the next frame also waits for
one."""
_INTERVALS = 8
"""Number of recent intervals between frames; the shortest one counts as the time between two frames."""
_EXPLAINED = 64
"""Largest number of frames given up whose missing parts wait to be asked for."""


@dataclass(frozen=True)
class Assembled(Generic[PartT]):
    """The parts of one frame, by name."""

    stamp_ns: int
    parts: dict[str, PartT]


@dataclass(frozen=True)
class GivenUp:
    """A frame that never became complete."""

    stamp_ns: int
    parts: frozenset[str]
    """Names of the parts that came."""
    lacks: dict[str, int | None]
    """Needed parts that did not come: time from the frame's stamp to the nearest stamp of such a part,
    ns; None if none came lately."""


@dataclass
class Assembler(Generic[PartT]):
    """Collects parts that carry the same stamp, or nearly the same; the stamps of its frames rise.

    Parts may arrive in any order, also across frames, because the bus delivers each topic in its own thread.

    A frame is complete when it has all required parts and, as long as the sensor sends them, its optional
    parts. The assembler stops waiting for an optional part when the first part of the next frame arrives,
    or when ``release`` is called.

    A lasting part is valid until another comes. A frame takes the one with its own stamp, else the newest
    before it, else the oldest one. It waits for the first one, and for its own where the last frames had
    theirs.
    """

    required: frozenset[str]
    optional: frozenset[str] = frozenset()
    lasting: frozenset[str] = frozenset()
    """Parts without which there is no frame, but of which not every frame needs its own."""
    leading: str = ""
    """Part whose stamp is the frame's; needed only with ``within_ns``."""
    within_ns: int = 0
    """Greatest difference between the stamps of a frame's parts; at most half the time between two frames
    counts."""
    incomplete: int = 0
    """Number of frames given up because a newer one was complete first."""
    done_ns: int = -1
    """Stamp of the last complete frame, ns; a part that is not newer is late."""
    _pending: dict[int, dict[str, PartT]] = field(default_factory=dict)
    _past: deque[int] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    _without_optional: int = 0
    _held: dict[str, dict[int, PartT]] = field(default_factory=dict)
    _leads_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_INTERVALS + 1))
    _given_up: deque[GivenUp] = field(default_factory=lambda: deque(maxlen=_EXPLAINED))
    _stamps_ns: dict[str, deque[int]] = field(default_factory=dict)

    def add(self, name: str, stamp_ns: int, part: PartT) -> list[Assembled[PartT]]:
        """Add a part; return the frames that it completes, oldest first."""
        self._stamps_ns.setdefault(name, deque(maxlen=2 * _PENDING)).append(stamp_ns)
        if name in self.lasting:
            self._hold(name, stamp_ns, part)
            return self._complete()
        frame_ns = self._frame_of(name, stamp_ns)
        if frame_ns <= self.done_ns or frame_ns in self._past:
            self._note_straggler(name, frame_ns)
            return []
        self._pending.setdefault(frame_ns, {})[name] = part
        if name == self.leading and frame_ns != stamp_ns:
            self._pending[stamp_ns] = self._pending.pop(frame_ns)
        return self._complete()

    def _complete(self) -> list[Assembled[PartT]]:
        newest_ns = max(self._pending, default=0)
        complete = [
            self._finish(pending_ns)
            for pending_ns in sorted(self._pending)
            if self._is_complete(pending_ns, newest=pending_ns == newest_ns)
        ]
        while len(self._pending) > _PENDING:
            self._give_up(min(self._pending))
        return complete

    def release(self) -> list[Assembled[PartT]]:
        """Return the frames that lack only optional parts, oldest first, when no parts arrive any more."""
        ready = [stamp_ns for stamp_ns, parts in self._pending.items() if self._usable(parts)]
        return [self._finish(stamp_ns) for stamp_ns in sorted(ready)]

    def refuse(self, stamp_ns: int) -> None:
        """Leave out the frame whose leading part was refused: it is counted as refused, not as incomplete."""
        frame_ns = self._frame_of(self.leading, stamp_ns)
        if frame_ns > self.done_ns and frame_ns not in self._past:
            self._pending.pop(frame_ns, None)
            self._past.append(frame_ns)

    def take_given_up(self) -> list[GivenUp]:
        """Return the frames given up since the last call, the newest ones only."""
        given_up = list(self._given_up)
        self._given_up.clear()
        return given_up

    def _is_complete(self, stamp_ns: int, *, newest: bool) -> bool:
        parts = self._pending[stamp_ns]
        if not self._usable(parts):
            return False
        waits = newest and self._without_optional < _PATIENCE
        return (not waits or self.optional <= parts.keys()) and (not newest or self._has_own(stamp_ns))

    def _has_own(self, stamp_ns: int) -> bool:
        """Return whether a frame has its own lasting parts, as far as the last frames had theirs."""
        last = list(self._past)[-_USUAL:]
        return not any(
            len(last) == _USUAL and all(map(self._owns(name), last)) and not self._owns(name)(stamp_ns)
            for name in self.lasting
        )

    def _owns(self, name: str) -> Callable[[int], bool]:
        held = self._held[name]
        return lambda stamp_ns: any(abs(held_ns - stamp_ns) <= self.within_ns for held_ns in held)

    def _usable(self, parts: dict[str, PartT]) -> bool:
        return self.required <= parts.keys() and self.lasting <= self._held.keys()

    def _hold(self, name: str, stamp_ns: int, part: PartT) -> None:
        held = self._held.setdefault(name, {})
        held[stamp_ns] = part
        if len(held) > _HELD:
            del held[next(iter(held))]

    def _valid(self, name: str, stamp_ns: int) -> PartT:
        """Return the message of a lasting part for a frame."""
        held = self._held[name]
        before = [held_ns for held_ns in held if held_ns <= stamp_ns + self.within_ns]
        return held[max(before) if before else min(held)]

    def _frame_of(self, name: str, stamp_ns: int) -> int:
        """Return the stamp of the frame to which a part belongs: the nearest one within reach, or its own."""
        if name == self.leading:
            self._leads_ns.append(stamp_ns)
        if not self.within_ns or stamp_ns in self._pending or stamp_ns in self._past:
            return stamp_ns
        lacking = [frame_ns for frame_ns, parts in self._pending.items() if name not in parts]
        others = lacking if name == self.leading else [*lacking, *self._past]
        nearest_ns = min(others, key=lambda frame_ns: abs(frame_ns - stamp_ns), default=stamp_ns)
        return nearest_ns if abs(nearest_ns - stamp_ns) <= self._reach_ns() else stamp_ns

    def _reach_ns(self) -> int:
        intervals = [abs(later - earlier) for earlier, later in pairwise(self._leads_ns) if later != earlier]
        return min([self.within_ns, *(interval // 2 for interval in intervals)])

    def _finish(self, stamp_ns: int) -> Assembled[PartT]:
        parts = self._pending.pop(stamp_ns)
        parts |= {name: self._valid(name, stamp_ns) for name in self.lasting}
        missing = bool(self.optional - parts.keys())
        self._without_optional = self._without_optional + 1 if missing else 0
        for older_ns in [pending_ns for pending_ns in self._pending if pending_ns < stamp_ns]:
            self._give_up(older_ns)
        self.done_ns = stamp_ns
        self._past.append(stamp_ns)
        return Assembled(stamp_ns, parts)

    def _give_up(self, stamp_ns: int, part: str = "") -> None:
        parts = self._pending.pop(stamp_ns, {}).keys() | ({part} if part else set())
        missing = (self.required - parts) | (self.lasting - self._held.keys())
        lacks = {name: self._nearest(name, stamp_ns) for name in sorted(missing)}
        self._given_up.append(GivenUp(stamp_ns, frozenset(parts), lacks))
        self._past.append(stamp_ns)
        self.incomplete += 1

    def _nearest(self, name: str, stamp_ns: int) -> int | None:
        steps = (part_ns - stamp_ns for part_ns in self._stamps_ns.get(name, ()))
        return min(steps, key=abs, default=None)

    def _note_straggler(self, name: str, stamp_ns: int) -> None:
        """Wait for an optional part again if it arrives late, but before the next frame."""
        if stamp_ns not in self._past:
            self._give_up(stamp_ns, name)
        elif name in self.optional and stamp_ns == self.done_ns and not self._pending:
            self._without_optional = 0


@dataclass
class NewestFrames(Generic[PartT]):
    """Keeps the newest complete frame of each sensor."""

    _slots: dict[str, Assembled[PartT]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self._slots)

    def put(self, sensor: str, frame: Assembled[PartT]) -> bool:
        """Store a frame; return whether it replaced one that was not processed."""
        passed_over = sensor in self._slots
        self._slots[sensor] = frame
        return passed_over

    def take(self) -> tuple[str, Assembled[PartT]] | None:
        """Return the frame with the oldest stamp and its sensor; equal stamps by name; None if empty."""
        if not self._slots:
            return None
        sensor = min(self._slots, key=lambda name: (self._slots[name].stamp_ns, name))
        return sensor, self._slots.pop(sensor)
