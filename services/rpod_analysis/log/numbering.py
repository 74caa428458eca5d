"""Sequence numbers of each publisher in a log: what it published before the log began is not missed.

A log may begin in the middle, such as that of a logger which was started again. Of each publisher that was
there already it has only the later numbers, and of those that start afterwards all.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

from rpod_analysis.log.logged import Logged
from rpod_schemas.topics import SENSOR_CACHE


@dataclass
class _Publisher:
    """One publisher of a topic; all of its publishers if the log does not distinguish them."""

    session: str
    first: int
    """Lowest sequence number in the log."""
    last: int
    """Highest sequence number in the log."""


@dataclass
class Numbering:
    """Sequence numbers of a log's messages.

    Args:
        recorded_before: number of messages that all publishers of a topic had published before their first
            one in the log, as the logger recorded it, by topic. It counts for topics whose messages do not
            tell their publisher.
    """

    recorded_before: Mapping[str, int] = field(default_factory=dict)
    _start_ns: int | None = None
    """Arrival of the first message."""
    _topics: dict[str, dict[str, _Publisher]] = field(default_factory=lambda: defaultdict(dict))
    """Publishers by topic and gid."""
    _earlier: set[str] = field(default_factory=set)
    """Sessions that published before the log began: some of their messages in the log may be from before, and
    other publishers of these sessions may have published before without a message in the log."""

    def take(self, logged: Logged) -> None:
        """Take a message, in the order of arrival."""
        if self._start_ns is None:
            self._start_ns = logged.log_ns
        session = logged.session or logged.gid
        if session and logged.publish_ns < self._start_ns:
            self._earlier.add(session)
        publishers, number = self._topics[logged.topic], logged.sequence
        known = publishers.setdefault(logged.gid, _Publisher(session, number, number))
        known.first, known.last = min(number, known.first), max(number, known.last)

    def before(self, topic: str) -> int:
        """Return how many messages of a topic were published before the log began, as far as that is known.

        A publisher that starts while the log is open begins with its first number, so that a gap there is a
        loss, unless it is larger than what publishers keep for receivers that come later.
        """
        publishers = self._topics[topic]
        known = sum(
            each.first - 1
            for each in publishers.values()
            if each.first > SENSOR_CACHE or (each.first > 0 and each.session in self._earlier)
        )
        return max(known, self.recorded_before.get(topic, 0) if "" in publishers else 0)

    def published(self, topic: str) -> int:
        """Return how many messages a topic's publishers sent by their numbers, also before the log."""
        # numbers may start at 0
        return sum(each.last + (each.first == 0) for each in self._topics[topic].values())
