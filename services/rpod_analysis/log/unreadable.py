"""Messages of a log that cannot be read: they are left out and counted, and nothing ends because of them."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from rpod_schemas.cdr import NANOSECONDS, begins_with_stamp, is_known, peek_stamp
from rpod_schemas.errors import MessageRejectedError, Reason

if TYPE_CHECKING:
    from rpod_analysis.log.log import Log, Logged

_MOST_REMEMBERED = 100_000
"""Messages that are known to have been counted, so that none is counted by two readers."""
_SAMPLED = 25
"""Messages of each topic, its first ones, whose stamps show the clocks of a log."""
_LEAST_OF_A_CLOCK = 3
"""Fewer sampled stamps that agree are no clock of the log."""
_DAY_NS = 86_400 * NANOSECONDS
_FASTEST = 1_000
"""A log in lockstep may be this many times as fast as the wall clock."""


@dataclass(frozen=True)
class UnreadableKind:
    """Messages of one topic that cannot be read for one reason."""

    topic: str
    reason: str
    count: int
    example: str
    """Description of the first of these messages."""


class Unreadable:
    """Counts the messages of a log that cannot be read, by topic and reason."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[str, str]] = Counter()
        self._examples: dict[tuple[str, str], str] = {}
        self._seen: set[tuple[str, int, int, int]] = set()

    def add(self, logged: "Logged", rejection: MessageRejectedError) -> None:
        """Count a message; one that was counted before is not counted again."""
        identity = logged.topic, logged.log_ns, logged.publish_ns, logged.sequence
        if identity in self._seen:
            return
        if len(self._seen) < _MOST_REMEMBERED:
            self._seen.add(identity)
        self.note(logged.topic, str(rejection.reason), rejection.text)

    def note(self, topic: str, reason: str, example: str) -> None:
        """Count an unreadable item that is not a message, such as a metadata record."""
        self._counts[topic, reason] += 1
        self._examples.setdefault((topic, reason), example)

    @contextmanager
    def left_out(self, logged: "Logged") -> Iterator[None]:
        """Leave a message out where reading it raises ``MessageRejectedError``, and count it."""
        try:
            yield
        except MessageRejectedError as rejection:
            self.add(logged, rejection)

    @property
    def kinds(self) -> tuple[UnreadableKind, ...]:
        """The counts, by topic and reason in alphabetical order."""
        return tuple(
            UnreadableKind(topic, reason, count, self._examples[topic, reason])
            for (topic, reason), count in sorted(self._counts.items())
        )

    def by_topic(self) -> dict[str, dict[str, int]]:
        """Return how many there are by topic, then by reason: as in ``summary.json``."""
        counts: dict[str, dict[str, int]] = {}
        for kind in self.kinds:
            counts.setdefault(kind.topic, {})[kind.reason] = kind.count
        return counts


class StampCheck:
    """Finds stamps that cannot be of a log: days away from every clock that its messages are stamped by.

    A log may have several clocks: in lockstep the sensors have that of the scenario, diagnostics the wall
    clock. So the distances of stamps from arrivals are sampled, and each that several messages agree on is
    allowed for. One stamp of another year would stretch a run over all the years between.
    """

    def __init__(self, log: "Log") -> None:
        self._start_ns = log.start_ns
        self._offsets_ns = _offsets_ns(log)

    def check(self, logged: "Logged", stamp_ns: int) -> int:
        """Return a message's stamp. Raises ``MessageRejectedError`` where it cannot be of this log."""
        offset_ns = stamp_ns - logged.log_ns
        ahead_ns = min((offset_ns - known_ns for known_ns in self._offsets_ns), key=abs)
        if abs(ahead_ns) <= _DAY_NS + _FASTEST * abs(logged.log_ns - self._start_ns):
            return stamp_ns
        days = abs(ahead_ns) / _DAY_NS
        where, reason = ("ahead of", Reason.FUTURE) if ahead_ns > 0 else ("behind", Reason.LATE)
        raise MessageRejectedError(
            reason, f"stamp {days:,.0f} days {where} the log's other messages; check the publisher's clock"
        )

    def peek(self, logged: "Logged") -> int | None:
        """Return the checked stamp of a message that begins with one, else None.

        Raises:
            MessageRejectedError: there should be a stamp and is none, or it cannot be of this log.
        """
        if not is_known(logged.type) or not begins_with_stamp(logged.type):
            return None
        return self.check(logged, peek_stamp(logged.payload))


def _offsets_ns(log: "Log") -> list[int]:
    """Return how far the clocks of a log's stamps are ahead of the arrivals; without any, 0."""
    sampled: list[int] = []
    for name, info in log.topics.items():
        if not is_known(info.type) or not begins_with_stamp(info.type):
            continue
        for logged in islice(log.messages(name), _SAMPLED):
            try:
                sampled.append(peek_stamp(logged.payload) - logged.log_ns)
            except MessageRejectedError:
                continue
    ordered = np.sort(np.array(sampled, np.int64))
    clocks = np.split(ordered, np.flatnonzero(np.diff(ordered) > _DAY_NS) + 1)
    most = max((len(clock) for clock in clocks), default=0)
    least = min(_LEAST_OF_A_CLOCK, most)
    return [int(np.median(clock)) for clock in clocks if len(clock) and len(clock) >= least] or [0]
