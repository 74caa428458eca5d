"""Messages of a log that cannot be read: they are left out and counted, and the analysis continues."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rpod_analysis.log.logged import Logged
from rpod_schemas.errors import MessageRejectedError

_MOST_REMEMBERED = 100_000
"""Largest number of counted messages that are stored, so that two readers do not count a message twice."""


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

    def add(self, logged: Logged, rejection: MessageRejectedError) -> None:
        """Count a message, unless it was counted before."""
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
    def left_out(self, logged: Logged) -> Iterator[None]:
        """Leave a message out, and count it, if reading it raises ``MessageRejectedError``."""
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
        """Return their numbers by topic, then by reason, as in ``summary.json``."""
        counts: dict[str, dict[str, int]] = {}
        for kind in self.kinds:
            counts.setdefault(kind.topic, {})[kind.reason] = kind.count
        return counts
