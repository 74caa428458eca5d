"""A process on the bus, as far as the logger knows it: what it has published, and what of it has arrived.

A service says in its diagnostics how many messages of each topic it has published so far, and which of its
diagnostics is the last one. Whatever it has published beyond the numbers that arrived is missing.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from rpod_runtime import Received
from rpod_runtime.bus.link import utc
from rpod_schemas.texts import is_count
from rpod_schemas.topics import DIAGNOSTICS
from rpod_schemas.types import CLOSING, PUBLISHED, Diagnostic

_MOST_TOPICS, _MOST_GIDS = 1000, 64


class Departure(NamedTuple):
    """Time at which the liveliness token of a publisher vanished."""

    awake_s: float
    """Time in which the logger was awake until then, s."""
    stamp_ns: int
    """The same moment, ns of UTC."""


@dataclass
class BusProcess:
    """The messages that one process has published, by its Zenoh session. Its memory is bounded.

    Counts of messages are by topic. Times are seconds of the monotonic clock.
    """

    session: str
    """Zenoh identity of its session."""
    service: str = ""
    """Name of the service; empty for a process that sends no diagnostics of rpod."""
    gid: bytes = b""
    """Publisher of its diagnostics."""
    published: dict[str, int] = field(default_factory=dict)
    """Messages that it has published, by its newest report."""
    published_before: dict[str, int] = field(default_factory=dict)
    """The same by its first report: what may have been sent before the logger was there."""
    reported_s: float = 0.0
    """Time of its newest report."""
    closing: bool = False
    """Whether its newest report is its last one."""
    arrived: dict[str, dict[bytes, int]] = field(default_factory=dict)
    """Last number that arrived, by topic and gid."""
    topics: set[str] = field(default_factory=set)
    """Recorded topics of which it has, or had, a publisher."""
    departures: dict[str, Departure] = field(default_factory=dict)
    """Publishers that have gone, by topic."""
    missing_before: dict[str, int] = field(default_factory=dict)
    """Messages that an earlier file already reports as missing."""

    @property
    def departed(self) -> Departure | None:
        """When a service of rpod has ended; None if it runs, and for a process of other software."""
        return self.departures.get(DIAGNOSTICS.name) if self.service else None

    @property
    def is_running_service(self) -> bool:
        """Whether it is a service that has not gone."""
        return bool(self.service) and DIAGNOSTICS.name in self.topics and self.departed is None

    def note_message(self, received: Received) -> None:
        """Note that a message has arrived."""
        by_gid, gid = self.arrived.setdefault(received.topic.name, {}), received.attachment.gid
        if gid in by_gid or len(by_gid) < _MOST_GIDS:
            by_gid[gid] = received.attachment.sequence

    def note_diagnostic(self, diagnostic: Diagnostic, received: Received) -> None:
        """Take the numbers of published messages from diagnostics, if they are those of a service of rpod."""
        counters = {name: int(text) for name, text in diagnostic.values.items() if is_count(text)}
        if any(name.startswith(PUBLISHED) for name in counters):
            self.service, self.gid = diagnostic.name, received.attachment.gid
            self.closing = diagnostic.values.get(CLOSING) == "true"
            self.note_report(counters, received.arrival_s)

    def note_report(self, counters: Mapping[str, int], now_s: float) -> None:
        """Take the numbers of published messages from a service's counters."""
        numbers = {
            name.removeprefix(PUBLISHED): n for name, n in counters.items() if name.startswith(PUBLISHED)
        }
        self.published = {name: numbers[name] for name in sorted(numbers)[:_MOST_TOPICS]}
        self.published_before = self.published_before or dict(self.published)
        self.reported_s = now_s

    def note_publisher(self, topic: str) -> None:
        """Note that a publisher of a topic is there, for the first time or again."""
        self.departures.pop(topic, None)
        if len(self.topics) < _MOST_TOPICS:
            self.topics.add(topic)

    def note_departure(self, topic: str, departure: Departure) -> None:
        """Note that the publisher of a topic has gone."""
        if topic in self.topics:
            self.departures[topic] = departure

    def forget_publisher(self, topic: str) -> None:
        """Forget a publisher that has gone."""
        del self.departures[topic]
        self.topics.discard(topic)

    def is_silent(self, since_s: float) -> bool:
        """Return whether a report is due, because the newest one is neither the last nor of after a time."""
        return self.reported_s < since_s and not self.closing

    def missing(self) -> list[str]:
        """Return which messages were published and have not arrived, a text for each topic."""
        texts = []
        for topic in sorted(self.topics - {DIAGNOSTICS.name}):  # the last diagnostics arrived by themselves
            published, arrived = self.published.get(topic, 0), self._last_number(topic)
            sent_before_the_logger = not arrived and published <= self.published_before.get(topic, 0)
            if arrived + self.missing_before.get(topic, 0) < published and not sent_before_the_logger:
                texts.append(f"{topic}: {published} published, {arrived} arrived")
        return texts

    def note_missing_as_reported(self) -> None:
        """Note that a file reports the messages that are missing now, so that the next one does not."""
        self.missing_before = {
            topic: max(0, n - self._last_number(topic)) for topic, n in self.published.items()
        }

    def _last_number(self, topic: str) -> int:
        """Return the number of messages of a topic up to the last one that arrived, of all its publishers."""
        return sum(self.arrived.get(topic, {}).values())

    def __str__(self) -> str:
        return f"{self.service} (session {self.session}, gid {self.gid.hex()})"

    def incomplete_at_close(self, since_s: float) -> str:
        """Return why a service's last numbers are not known when a file is closed; empty if they are.

        Args:
            since_s: time since which it should have reported its numbers.
        """
        if self.departed is not None:
            return f"{self} was there until {utc(self.departed.stamp_ns)} and has not come back since"
        if not self.is_running_service:
            return ""
        if self.is_silent(since_s):
            return f"{self} did not answer at the close: its last numbers are not known"
        missing = self.missing()
        return f"{self}, at the close: {'; '.join(missing)}" if missing else ""

    def incomplete_at_end(self, departure: Departure) -> str:
        """Return the sentence about a service that has gone without its last messages."""
        text = f"{self} ended at {utc(departure.stamp_ns)}"
        if not self.closing:
            text += " without saying its last numbers: it was killed or lost its link"
        return "; ".join([text, *self.missing()])

    def unconfirmed_end(self, topic: str, departure: Departure) -> str:
        """Return the sentence about a publisher of other software that has gone."""
        last = max(self.arrived.get(topic, {}).values(), default=0)
        return (
            f"{topic}: a publisher of session {self.session} ended at {utc(departure.stamp_ns)} without "
            f"stating its last number; the last that arrived is {last}"
        )
