"""One log while it is recorded: the file, its first records, and the counts with which it is closed."""

import json
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from itertools import chain
from typing import Self

from rpod_logger.publisher_ends import Endings
from rpod_logger.writer import LogFile, channel_topic
from rpod_runtime import Received
from rpod_runtime.delivery.accounting import FARTHEST, Publication
from rpod_schemas.control import StatusReply
from rpod_schemas.logs import (
    BUS,
    COMPLETENESS,
    CONFIGURATION,
    COUNTS,
    PUBLISHERS,
    SOFTWARE,
    STATUS,
    BusRecord,
    Completeness,
    Numbers,
    OutageTime,
    TopicCount,
    shortfalls,
)
from rpod_schemas.rmw.wire import UNNUMBERED
from rpod_schemas.topics import Namespace

_NOTHING = Endings()
_MOST_RUNS = 10_000
"""Largest number of runs of sequence numbers that a file lists: a publisher has one, and one more after each
jump."""


@dataclass(frozen=True)
class Totals:
    """Numbers of messages since the logger started, by topic."""

    received: Counter[str] = field(default_factory=Counter)
    missed: Counter[str] = field(default_factory=Counter)
    recovered: Counter[str] = field(default_factory=Counter)
    duplicates: Counter[str] = field(default_factory=Counter)
    rejected: Counter[str] = field(default_factory=Counter)

    def since(self, before: Self) -> Self:
        """Return the differences from earlier totals."""
        return type(self)(
            **{each.name: getattr(self, each.name) - getattr(before, each.name) for each in fields(self)}
        )

    def of(self, topic: str) -> dict[str, int]:
        """Return the totals of one topic, by name."""
        return {each.name: getattr(self, each.name)[topic] for each in fields(self)}

    @property
    def topics(self) -> set[str]:
        """Topics with any count."""
        return {topic for each in fields(self) for topic in getattr(self, each.name)}


@dataclass
class _Run:
    """Messages of one publisher in the file whose sequence numbers rise without a jump."""

    topic: str
    first: int
    numbered: bool
    last: int = 0
    messages: int = 0

    def continues_with(self, sequence: int) -> bool:
        """Return whether a sequence number belongs to this run."""
        return not self.numbered or self.last < sequence <= self.last + FARTHEST


class Recording:
    """An open log. It raises ``OSError`` if the disk refuses data.

    Args:
        file: the file.
        before: the totals at its opening.
        continues: name of the file that it continues; None if there is none.
    """

    def __init__(self, file: LogFile, before: Totals, *, continues: str | None = None) -> None:
        self.file = file
        self._before = before
        self._opened_s = time.monotonic()
        self.opened_ns = time.time_ns()
        """Time at which the file was opened, ns of UTC."""
        self._continues = continues
        self._runs: dict[Publication, list[_Run]] = {}
        self._run_count = 0
        self._repeated: Counter[str] = Counter()
        self._unlisted: Counter[str] = Counter()
        """Number of messages of runs that are not listed, because there are too many, by topic."""
        self._clock_jumps_s: list[float] = []

    @property
    def age_s(self) -> float:
        """Time since the file was opened, by the monotonic clock."""
        return time.monotonic() - self._opened_s

    def write(self, received: Received) -> None:
        """Append a message."""
        self.file.write(received)
        publication, sequence = (received.key, received.attachment.gid), received.attachment.sequence
        runs = self._runs.get(publication, [])
        if not runs or not runs[-1].continues_with(sequence):
            if self._run_count >= _MOST_RUNS:
                self._unlisted[received.topic.name] += 1
                return
            self._run_count += 1
            numbered = received.attachment is not UNNUMBERED
            runs.append(_Run(received.topic.name, first=sequence, numbered=numbered))
            self._runs[publication] = runs
        run = runs[-1]
        run.last = sequence
        run.messages += 1

    def repeat(self, latched: Iterable[Received]) -> None:
        """Append latched messages that were received before this file was opened."""
        for received in latched:
            self.file.write(received)
            self._repeated[received.topic.name] += 1

    def describe(self, services: Mapping[str, StatusReply], version: str) -> None:
        """Add software version, configuration and status of the services; later records replace earlier."""
        digests = {status.target_digest for status in services.values() if status.target_digest}
        contents = {status.target_content for status in services.values() if status.target_content}
        software = {
            "name": "rpod",
            "version": version,
            "target_digest": " ".join(sorted(digests)),
            "target_content": " ".join(sorted(contents)),
        }
        self.file.add_metadata(SOFTWARE, software)
        self.file.add_metadata(
            CONFIGURATION, {name: json.dumps(status.configuration) for name, status in services.items()}
        )
        self.file.add_metadata(
            STATUS,
            {name: status.model_dump_json(exclude={"configuration"}) for name, status in services.items()},
        )

    def note_clock_jump(self, jump_s: float) -> None:
        """Remember that this machine's clock jumped."""
        self._clock_jumps_s.append(round(jump_s, 3))

    def counts(self, totals: Totals) -> dict[str, TopicCount]:
        """Return the numbers of messages of each topic since the log was opened."""
        new, written = totals.since(self._before), self._unlisted.copy()
        for run in chain.from_iterable(self._runs.values()):
            written[run.topic] += run.messages
        return {
            topic: TopicCount(**new.of(topic), written=written[topic], repeated=self._repeated[topic])
            for topic in sorted({*new.topics, *written, *self._repeated})
        }

    def _publishers(self, keys: Namespace) -> dict[str, str]:
        """Return the record of the publishers; the publisher of a message without a number is unknown."""
        numbers: dict[str, list[dict[str, str | int]]] = defaultdict(list)
        for (key, gid), run in ((who, run) for who, runs in self._runs.items() for run in runs):
            if run.numbered:
                each = Numbers(key=key, gid=gid.hex(), first=run.first, last=run.last, messages=run.messages)
                numbers[channel_topic(keys, run.topic)].append(each.model_dump())
        return {topic: json.dumps(each) for topic, each in numbers.items()}

    def close(
        self,
        totals: Totals,
        keys: Namespace,
        *,
        reasons: tuple[str, ...] = (),
        endings: Endings = _NOTHING,
    ) -> None:
        """Add the counts and the record of completeness, and finish the file.

        Args:
            totals: the totals at the close.
            keys: the facility's part of the key space.
            reasons: reasons why the file is not complete, beside those that follow from the counts.
            endings: records about publishers that ended, and about the link.
        """
        counts = {channel_topic(keys, name): count for name, count in self.counts(totals).items()}
        written = {topic: count.written + count.repeated for topic, count in counts.items()}
        if self._unlisted:
            reasons += (f"more than {_MOST_RUNS:,} publishers, or jumps of them: not all are listed",)
        reasons += endings.reasons + shortfalls(counts, written)
        completeness = Completeness(
            complete=not reasons,
            reasons=reasons,
            continues=self._continues,
            clock_jumps_s=tuple(self._clock_jumps_s),
        )
        self.file.add_metadata(PUBLISHERS, self._publishers(keys))
        self.file.add_metadata(COUNTS, {topic: count.model_dump_json() for topic, count in counts.items()})
        outages = tuple(OutageTime(begin_ns=each.begin_ns, end_ns=each.end_ns) for each in endings.outages)
        bus = BusRecord(outages=outages, unconfirmed=endings.unconfirmed)
        self.file.add_metadata(BUS, bus.record())
        self.file.add_metadata(COMPLETENESS, completeness.record())
        self.file.close()
