"""Metadata of a log: the names of its records and their contents (ICD section 5).

Values of metadata records are JSON unless stated otherwise. A file may contain a record more than
once: early, in case the process dies, and again at the close. The last one counts.
"""

import json
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import Field, TypeAdapter

from rpod_schemas.config.base import Config

PROFILE = "ros2"
SCHEMA_ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"
OPAQUE = "opaque"
"""Schema name of messages that were recorded as opaque bytes, from keys that are not ROS topics."""
OPAQUE_ENCODING = "application/octet-stream"
"""Encoding of such messages."""

SOFTWARE = "software"
"""Record of plain text: ``name``, ``version``, and, if a service reported them, ``target_digest`` (of the
parameters) and ``target_content`` (of the arrays)."""
CONFIGURATION = "configuration"
"""Record of each service's resolved configuration, by instance."""
STATUS = "status"
"""Record of each service's last status without its configuration, by instance."""
COUNTS = "counts"
"""Record of a ``TopicCount`` for each topic, by the channel's topic; only in a file that was closed."""
PUBLISHERS = "publishers"
"""Record of a list of ``Numbers`` for each topic, by the channel's topic; only in a file that was closed."""
REPLAY = "replay"
"""First part of the topics of estimates that were made from a log, and name of their configuration."""
RECOVERY = "recovery"
"""Record of a ``Recovery`` under ``recovery``; only in a file that was recovered from a damaged one."""
COMPLETENESS = "completeness"
"""Record of the fields of ``Completeness``, the file's own record; only in a file that was closed."""

BUS = "bus"
"""Record of the fields of ``BusRecord``: outages, and ends of publishers; only in a file that was closed."""

QOS_METADATA = "offered_qos_profiles"
"""Channel metadata: quality of service in rosbag2's YAML."""
HASH_METADATA = "topic_type_hash"
"""Channel metadata: RIHS01 hash of the type, as rosbag2 names it."""
KEY_METADATA = "key"
"""Channel metadata of a key that is no known ROS topic: the key of publication."""
GID_METADATA, SESSION_METADATA = "publisher", "session"
"""Channel metadata of a topic that has one publisher at a time: gid of the publisher, hexadecimal digits, and
Zenoh identity of its session. Another publisher of the same topic has a channel of its own."""
ENCODING_METADATA = "encoding"
"""Channel metadata of a key that is no known ROS topic: the encoding that the publisher stated."""

Total = Annotated[int, Field(ge=0)]


class TopicCount(Config):
    """Counts of a topic's messages while a file was open."""

    received: Total = 0
    """Number of messages that arrived at the logger."""
    written: Total = 0
    """Number of messages in the file, without the repeated ones."""
    repeated: Total = 0
    """Number of latched messages from before the file, with which it begins."""
    missed: Total = 0
    """Number of messages that never arrived, by gaps in the publishers' sequence numbers."""
    recovered: Total = 0
    """Number of received messages that were first missed, then fetched from the publisher's cache."""
    duplicates: Total = 0
    """Number of messages that arrived again and were left out."""
    rejected: Total = 0
    """Number of messages that arrived without a usable attachment and were left out."""

    @property
    def lost(self) -> int:
        """Number of messages that arrived but are not in the file: the queue was full, or the disk failed."""
        return self.received - self.written


class Numbers(Config):
    """Range of sequence numbers of one publisher instance in a file, without the repeated messages.

    The ranges of all publishers of a topic together are the sequence numbers of its messages, except for
    missed ones. They allow a reader to count the messages again.
    """

    key: str
    """Key on which the instance published."""
    gid: str
    """Identifier of the instance, hexadecimal digits; a publisher that restarted is another instance."""
    first: Total
    last: Total
    messages: Total
    """Number of the publisher's messages."""


NUMBERS = TypeAdapter(list[Numbers])
"""The numbers of a topic's publishers, as they stand in the record ``publishers``."""


class RecoveredTopic(Config):
    """A topic in a recovered log."""

    messages: Total = 0
    """Number of messages in the recovered log."""
    lost: Total = 0
    """Estimated number of lost messages: by the summary if it is intact, else by indexes, sequence numbers
    and rate."""
    last_ns: int | None = None
    """Arrival of the last message, ns of UTC; None if there is none."""


class Recovery(Config):
    """Result of the recovery of a damaged log."""

    source: str
    """Path of the damaged file, which is not changed."""
    out: str
    """Path of the new file."""
    size_bytes: Total
    """Size of the damaged file, bytes."""
    unreadable_bytes: Total
    """Number of bytes of the damaged file that belong to no complete record."""
    damaged_places: Total
    """Number of contiguous blocks of such bytes."""
    chunks_over_limit: Total = 0
    """Number of chunks that were not read, because they announce more than the limit; unreadable as well."""
    closed: bool
    """Whether the end of the file exists; if not, the data after the last record are unknown."""
    messages: Total
    """Number of messages in the new file."""
    without_definition: Total
    """Number of messages left out because their channel's definition is lost."""
    topics: dict[str, RecoveredTopic]
    """Topics by the channel's name."""

    @property
    def whole(self) -> bool:
        """Whether nothing was lost."""
        return self.closed and not self.unreadable_bytes and not self.without_definition


def _value(text: str) -> Any:
    """Return a value of a record. Raises ``ValueError`` if the text is no JSON, or is nested without end."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("is nested too deeply") from error


class _Record(Config):
    """Content of a metadata record, each field as JSON."""

    def record(self) -> dict[str, str]:
        """Return the metadata record."""
        return {name: json.dumps(value) for name, value in self.model_dump(mode="json").items()}


class Completeness(_Record):
    """Completeness of a file: whether it contains all messages that were published while it was open."""

    complete: bool
    """Whether nothing was missed, lost or rejected, and the file was closed properly."""
    reasons: tuple[str, ...] = ()
    """Reasons why the file is not complete."""
    continues: str | None = None
    """Name of the preceding file, if it ends at the message at which this one begins."""
    clock_jumps_s: tuple[float, ...] = ()
    """Jumps of the logger's clock while the file was open, s; ``log_time`` includes them."""

    @classmethod
    def of_record(cls, record: Mapping[str, str]) -> Self:
        """Return the completeness in a file's metadata record; a file without one was not closed.

        Raises:
            ValueError: the record holds something else.
        """
        if not record:
            return cls(complete=False, reasons=("the file was not closed",))
        return cls.model_validate({name: _value(text) for name, text in record.items()})

    def with_reasons(self, reasons: tuple[str, ...]) -> Self:
        """Return the completeness with additional reasons."""
        more = tuple(reason for reason in reasons if reason not in self.reasons)
        return self.model_copy(
            update={"complete": self.complete and not more, "reasons": self.reasons + more}
        )


class OutageTime(Config):
    """A time in which the logger had no link to the router, ns of UTC."""

    begin_ns: int
    end_ns: int | None = None
    """None if it lasted at the close of the file."""


class BusRecord(_Record):
    """Events of the bus while a file was open, beside the messages."""

    outages: tuple[OutageTime, ...] = ()
    """Times without a link to the router; each is also a reason why the file is not complete."""
    unconfirmed: tuple[str, ...] = ()
    """Publishers of other software that ended. They do not state their last number, so it is not known
    whether that message arrived. This does not make the file incomplete."""

    @classmethod
    def of_record(cls, record: Mapping[str, str]) -> Self:
        """Return what a file's metadata record says; fields of later versions are left out.

        Raises:
            ValueError: the record holds something else.
        """
        return cls.model_validate({name: _value(record[name]) for name in cls.model_fields if name in record})


def shortfalls(counts: Mapping[str, TopicCount], messages: Mapping[str, int]) -> tuple[str, ...]:
    """Return the reasons why a file is not complete, a sentence each; empty for a complete file.

    Args:
        counts: the counts in the file's metadata, by the channel's topic.
        messages: number of messages in the file, by the channel's topic.
    """
    reasons = []
    for topic in sorted({*counts, *messages}):
        count, found = counts.get(topic, TopicCount()), messages.get(topic, 0)
        for what, number in (
            ("missed on the bus", count.missed),
            ("lost in the logger", count.lost),
            ("rejected", count.rejected),
        ):
            if number:
                reasons.append(f"{topic}: {number} {what}")
        if found != count.written + count.repeated:
            reasons.append(f"{topic}: {found} in the file, {count.written + count.repeated} by its account")
    return tuple(reasons)


def check_completeness(
    record: Mapping[str, str], counts: Mapping[str, str], messages: Mapping[str, int]
) -> Completeness:
    """Check a closed file's record of completeness against its counts and its messages.

    Args:
        record: the record ``COMPLETENESS``, empty if there is none.
        counts: the record ``COUNTS``, empty if there is none.
        messages: number of messages in the file, by the channel's topic (MCAP's statistics).

    Returns:
        The record; each inconsistency is added to its reasons and makes it incomplete.

    Raises:
        ValueError: a record holds something else.
    """
    said = Completeness.of_record(record)
    account = {topic: TopicCount.model_validate_json(text) for topic, text in counts.items()}
    return said.with_reasons(shortfalls(account, messages) if record else ())
