"""How many messages there were, how many the log holds, and what the services counted."""

from collections import Counter, defaultdict
from dataclasses import dataclass, field

from rpod_analysis.log import Logged
from rpod_schemas.summary import FrameCount
from rpod_schemas.topics import SENSOR_CACHE
from rpod_schemas.types import Diagnostic

_PUBLISHED = "published/"
_DROPPED = "dropped"
_PASSED_OVER = (f"{_DROPPED}/", "incomplete/")
"""By sensor: complete but not the newest, and never complete before a newer one was."""


@dataclass
class Account:
    """Takes a log's messages and diagnostics, in the order of arrival."""

    logged: Counter[str] = field(default_factory=Counter)
    first: dict[str, int] = field(default_factory=dict)
    """Lowest sequence number, by topic."""
    last: dict[str, int] = field(default_factory=dict)
    """Highest sequence number, by topic."""
    counters: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    """Last value of every counter, by service; the lives of a service that was restarted add up."""
    _lives: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))

    def take(self, logged: Logged) -> None:
        """Count a message."""
        name, sequence = logged.topic, logged.sequence
        self.logged[name] += 1
        self.first[name] = min(sequence, self.first.get(name, sequence))
        self.last[name] = max(sequence, self.last.get(name, sequence))

    def hear(self, diagnostic: Diagnostic) -> None:
        """Take a service's counters."""
        now, ended = self.counters[diagnostic.name], self._lives[diagnostic.name]
        for name, text in diagnostic.values.items():
            if text.isdecimal():
                value = int(text)
                if value + ended[name] < now[name]:
                    ended[name] = now[name]
                now[name] = value + ended[name]

    def frames(self) -> dict[str, FrameCount]:
        """Return the counts of every topic in the log.

        Published is what the publishers counted, else the highest sequence number. What a publisher had sent
        before it could still be recovered (its cache is 90 messages) was before the log's time.
        """
        counts: dict[str, FrameCount] = {}
        for topic, logged in sorted(self.logged.items()):
            counted = sum(counters[_PUBLISHED + topic] for counters in self.counters.values())
            before = self.first[topic] - 1 if self.first[topic] > SENSOR_CACHE else 0
            published = max((counted or self.last[topic]) - before, logged)
            counts[topic] = FrameCount(published=published, logged=logged, missed=published - logged)
        return counts

    def dropped(self, status_topic: str) -> int:
        """Return the frames that the estimator passed over: the one that publishes this status."""
        total = 0
        for counters in self.counters.values():
            if _PUBLISHED + status_topic in counters:
                by_sensor = [value for name, value in counters.items() if name.startswith(_PASSED_OVER)]
                total += sum(by_sensor) if by_sensor else counters[_DROPPED]
        return total
