"""One log in the making: the file, what it opens with, and the account that it closes with."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from rpod_logger.writer import LogFile, channel_topic
from rpod_runtime import Received
from rpod_schemas.control import StatusReply
from rpod_schemas.logs import CONFIGURATION, COUNTS, SOFTWARE, STATUS, TopicCount
from rpod_schemas.topics import Namespace


@dataclass(frozen=True)
class Totals:
    """Messages since the logger began, by topic."""

    received: Counter[str] = field(default_factory=Counter)
    missed: Counter[str] = field(default_factory=Counter)
    duplicates: Counter[str] = field(default_factory=Counter)


class Recording:
    """An open log. What the disk refuses is raised as ``OSError``."""

    def __init__(self, file: LogFile, opened_at: Totals) -> None:
        self.file = file
        self._opened_at = opened_at
        self._written: Counter[str] = Counter()
        self._repeated: Counter[str] = Counter()

    def write(self, received: Received) -> None:
        """Append a message."""
        self.file.write(received)
        self._written[received.topic.name] += 1

    def repeat(self, latched: Iterable[Received]) -> None:
        """Append latched messages from before this file."""
        for received in latched:
            self.file.write(received)
            self._repeated[received.topic.name] += 1

    def describe(self, services: Mapping[str, StatusReply], version: str) -> None:
        """Add what is known of software and services; what is told later counts."""
        digests = {status.target_digest for status in services.values() if status.target_digest}
        software = {"name": "rpod", "version": version, "target_digest": " ".join(sorted(digests))}
        self.file.add_metadata(SOFTWARE, software)
        self.file.add_metadata(
            CONFIGURATION, {name: json.dumps(status.configuration) for name, status in services.items()}
        )
        self.file.add_metadata(
            STATUS,
            {name: status.model_dump_json(exclude={"configuration"}) for name, status in services.items()},
        )

    def counts(self, closed_at: Totals) -> dict[str, TopicCount]:
        """Return what became of each topic's messages since the log was opened."""
        received = closed_at.received - self._opened_at.received
        missed = closed_at.missed - self._opened_at.missed
        duplicates = closed_at.duplicates - self._opened_at.duplicates
        return {
            name: TopicCount(
                received=received[name],
                written=self._written[name],
                repeated=self._repeated[name],
                missed=missed[name],
                duplicates=duplicates[name],
            )
            for name in sorted({*received, *missed, *duplicates, *self._repeated})
        }

    def close(self, closed_at: Totals, keys: Namespace) -> None:
        """Add the counts and finish the file."""
        counts = self.counts(closed_at)
        self.file.add_metadata(
            COUNTS, {channel_topic(keys, name): count.model_dump_json() for name, count in counts.items()}
        )
        self.file.close()
