"""A recorder without a bus, and what its logs hold."""

import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader

from rpod_logger.recorder import Recorder
from rpod_runtime import Received
from rpod_runtime.delivery.accounting import SequenceAccount
from rpod_runtime.health import HealthBook
from rpod_schemas.config.facility.logger import LoggerConfig
from rpod_schemas.logs import COMPLETENESS, COUNTS, Completeness, TopicCount, check_completeness


class Desk:
    """A recorder with its health and account, as the daemon would have them."""

    def __init__(self, directory: Path, **settings: Any) -> None:
        self.health = HealthBook("logger")
        self.account = SequenceAccount()
        config = LoggerConfig(directory=directory, name="run", **settings)
        self.recorder = Recorder(config, version="1.2.3", health=self.health, account=self.account)

    def put(self, received: Received) -> None:
        self.account.take(received.key, received.attachment)
        self.recorder.put(received)

    def counter(self, name: str) -> int:
        return self.health.counters().get(name, 0)


def read(path: Path | str) -> list[tuple[str, int]]:
    """Return topic and sequence number of every message of a closed log, in the order of the file."""
    with Path(path).open("rb") as stream:
        return [
            (channel.topic, message.sequence)
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False)
        ]


def readable(path: Path, topic: str | None = None) -> list[int]:
    """Return the sequence numbers, of one topic or all, in a log that may have no end."""
    topics: dict[int, str] = {}
    numbers: list[int] = []
    for record in _records(path):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and topic in (None, topics[record.channel_id]):
            numbers.append(record.sequence)
    return numbers


def early_metadata(path: Path, name: str) -> dict[str, str]:
    """Return a metadata record of a log that may have no end."""
    found = [r.metadata for r in _records(path) if isinstance(r, Metadata) and r.name == name]
    return found[-1] if found else {}


def _records(path: Path) -> Iterator[Any]:
    with path.open("rb") as stream, suppress(McapError, struct.error):
        yield from StreamReader(stream).records


def metadata(path: Path | str, name: str) -> dict[str, str]:
    with Path(path).open("rb") as stream:
        found = [item.metadata for item in make_reader(stream).iter_metadata() if item.name == name]
    return found[-1] if found else {}


def counts(path: Path | str) -> dict[str, TopicCount]:
    return {topic: TopicCount.model_validate_json(text) for topic, text in metadata(path, COUNTS).items()}


def completeness(path: Path | str) -> Completeness:
    """Return what a file says of itself, held against what is in it."""
    with Path(path).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    messages: Counter[str] = Counter()
    for number, count in summary.statistics.channel_message_counts.items():
        messages[summary.channels[number].topic] += count
    return check_completeness(metadata(path, COMPLETENESS), metadata(path, COUNTS), messages)
