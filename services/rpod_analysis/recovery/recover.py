"""Writes a readable log from a damaged one: copies complete records, and counts the lost messages."""

import os
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    Channel,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    Schema,
)
from mcap.summary import Summary
from mcap.writer import CompressionType, Writer

from rpod_analysis.errors import CannotWriteError, NoLogError, NothingRecoveredError, NotMcapError
from rpod_analysis.log.log_file import RECOVERED, beside, summary_is_whole
from rpod_analysis.recovery.salvage import DAMAGE, DamagedChunk, Found, Gap, is_mcap, scan
from rpod_schemas.logs import PROFILE, RECOVERY, RecoveredTopic, Recovery
from rpod_schemas.texts import reason_of


def recover(source: Path, out: Path | None = None) -> Recovery:
    """Write a new, indexed log with all complete records of a truncated or damaged one, which is not changed.

    Args:
        source: any MCAP file.
        out: file to write, which must not exist; by default ``run.recovered.mcap`` beside ``run.mcap``.

    Raises:
        NoLogError: the file is missing or cannot be read.
        NotMcapError: the file contains nothing of an MCAP file.
        NothingRecoveredError: it is damaged, and no message in it can be read.
        CannotWriteError: the new file already exists, or it cannot be written.
    """
    target = out or beside(source, RECOVERED)
    try:
        stream = source.open("rb")
        size = stream.seek(0, 2)
    except OSError as error:
        raise NoLogError(source, reason_of(error)) from error
    with stream:
        try:
            with target.open("xb") as written:
                recovery = _copy(stream, written, source=source, out=target, size=size)
        except FileExistsError as error:
            raise CannotWriteError(target, "already exists; give another name with --out") from error
        except OSError as error:
            target.unlink(missing_ok=True)
            raise CannotWriteError(target, reason_of(error)) from error
        except BaseException:  # also Ctrl-C: a part of a log would take the log's place
            target.unlink(missing_ok=True)
            raise
    return recovery


def _copy(stream: IO[bytes], written: IO[bytes], *, source: Path, out: Path, size: int) -> Recovery:
    copier = _Copier(written, stream)
    for found in scan(stream):
        copier.take(found)
    if not copier.records and not is_mcap(stream):
        raise NotMcapError(source)
    recovery = copier.recovery(source=source, out=out, size=size)
    if not recovery.messages and not recovery.whole:
        raise NothingRecoveredError(recovery)
    copier.finish(recovery)
    written.flush()
    os.fsync(written.fileno())
    return recovery


@dataclass
class _Account:
    """Number of messages found in a channel, and evidence of lost ones."""

    had: int = 0
    first_ns: int = 0
    last_ns: int = 0
    sequence: int = 0
    indexed: int = 0
    """Number of messages in damaged chunks, by the index that follows them."""
    skipped: int = 0
    """Number of missing sequence numbers at damaged places."""
    after_damage: bool = False

    def take(self, message: Message) -> None:
        self.first_ns = min(message.log_time, self.first_ns) if self.had else message.log_time
        self.last_ns = max(message.log_time, self.last_ns)
        if self.had and self.after_damage:
            self.skipped += max(message.sequence - self.sequence - 1, 0)
        self.had += 1
        self.sequence, self.after_damage = message.sequence, False

    def cut(self, end_ns: int | None) -> int:
        """Return the number of further messages up to a time, estimated from the rate.

        Messages that came only at the beginning, such as those of a service's start, have no rate: they ended
        longer ago than they lasted.
        """
        span_ns = self.last_ns - self.first_ns
        if end_ns is None or self.had < 2 or not 0 < end_ns - self.last_ns <= span_ns:
            return 0
        return int((self.had - 1) * (end_ns - self.last_ns) / span_ns)


@dataclass
class _Definitions:
    """Schemas and channels of the source; those of complete chunks take precedence."""

    sure: dict[tuple[type, int], Schema | Channel] = field(default_factory=dict)
    doubtful: dict[tuple[type, int], Schema | Channel] = field(default_factory=dict)

    def channel(self, number: int) -> Channel | None:
        found = self._of(Channel, number)
        return found if isinstance(found, Channel) else None

    def schema(self, number: int) -> Schema | None:
        found = self._of(Schema, number)
        return found if isinstance(found, Schema) else None

    def _of(self, kind: type, number: int) -> Schema | Channel | None:
        return self.sure.get((kind, number)) or self.doubtful.get((kind, number))

    def add(self, definition: Schema | Channel, *, sure: bool) -> None:
        known = self.sure if sure else self.doubtful
        known.setdefault((type(definition), definition.id), definition)


class _Copier:
    """Writes the records found in the source to a new file."""

    def __init__(self, written: IO[bytes], stream: IO[bytes]) -> None:
        self.records = 0
        self._writer = Writer(written, compression=CompressionType.LZ4)
        self._started = False
        self._summary = _whole_summary(stream)
        self._definitions = _Definitions()
        if self._summary:
            for schema in self._summary.schemas.values():
                self._definitions.add(schema, sure=True)
            for channel in self._summary.channels.values():
                self._definitions.add(channel, sure=True)
        self._schemas: dict[int, int] = {}
        self._channels: dict[int, int] = {}
        self._accounts: dict[int, _Account] = defaultdict(_Account)
        self._damage: Counter[str] = Counter()
        self._orphans = 0
        self._closed = False
        self._behind_damage = False
        """Whether the following indexes belong to a lost chunk."""
        self._cut_ns: int | None = None

    def take(self, found: Found) -> None:
        """Process the next item found in the source."""
        if isinstance(found, Gap | DamagedChunk):
            self._note_damage(found)
            return
        self.records += 1
        if isinstance(found, Schema | Channel):
            self._definitions.add(found, sure=True)
            return
        match found:
            case Message():
                self._behind_damage = False
                self._write(found)
            case MessageIndex() if self._behind_damage:
                self._accounts[found.channel_id].indexed += len(found.records)
            case Header():
                self._start(found.profile)
            case Footer():
                self._closed = True
            case Metadata() | Attachment():
                self._copy(found)

    def _note_damage(self, found: Gap | DamagedChunk) -> None:
        self._behind_damage = True
        self._damage["places"] += 1
        for account in self._accounts.values():
            account.after_damage = True
        if isinstance(found, Gap):
            self._damage["bytes"] += found.end - found.start
            return
        self.records += 1
        self._damage["bytes"] += found.size
        self._damage["over_limit"] += found.over_limit
        for definition in found.definitions:
            self._definitions.add(definition, sure=False)
        for message in found.whole:
            self._write(message)
        self._cut_ns = found.end_ns or self._cut_ns

    def _start(self, profile: str = PROFILE) -> None:
        if not self._started:
            self._writer.start(profile=profile, library="rpod recover")
            self._started = True

    def _write(self, message: Message) -> None:
        channel = self._definitions.channel(message.channel_id)
        if channel is None:
            self._orphans += 1
            return
        self._start()
        self._writer.add_message(
            self._registered(channel),
            log_time=message.log_time,
            data=message.data,
            publish_time=message.publish_time,
            sequence=message.sequence,
        )
        self._accounts[message.channel_id].take(message)

    def _registered(self, channel: Channel) -> int:
        if channel.id not in self._channels:
            self._channels[channel.id] = self._writer.register_channel(
                channel.topic, channel.message_encoding, self._schema(channel.schema_id), channel.metadata
            )
        return self._channels[channel.id]

    def _schema(self, number: int) -> int:
        schema = self._definitions.schema(number)
        if schema is None:
            return 0
        if number not in self._schemas:
            self._schemas[number] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
        return self._schemas[number]

    def _copy(self, record: Metadata | Attachment) -> None:
        self._start()
        if isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
        else:
            self._writer.add_attachment(
                create_time=record.create_time,
                log_time=record.log_time,
                name=record.name,
                media_type=record.media_type,
                data=record.data,
            )

    def recovery(self, *, source: Path, out: Path, size: int) -> Recovery:
        """Return the counts of the recovery."""
        topics: dict[str, RecoveredTopic] = {}
        for number in {*self._accounts, *(self._summary.channels if self._summary else ())}:
            account = self._accounts[number]
            channel = self._definitions.channel(number)
            name = channel.topic if channel else f"channel {number}"
            before = topics.get(name, RecoveredTopic())
            topics[name] = RecoveredTopic(
                messages=before.messages + account.had,
                lost=before.lost + self._lost(number, account),
                last_ns=max(before.last_ns or 0, account.last_ns) or None,
            )
        return Recovery(
            source=str(source),
            out=str(out),
            size_bytes=size,
            unreadable_bytes=self._damage["bytes"],
            damaged_places=self._damage["places"],
            chunks_over_limit=self._damage["over_limit"],
            closed=self._closed,
            messages=sum(topic.messages for topic in topics.values()),
            without_definition=self._orphans,
            topics=dict(sorted(topics.items())),
        )

    def _lost(self, number: int, account: _Account) -> int:
        if self._summary and self._summary.statistics:
            return max(self._summary.statistics.channel_message_counts.get(number, 0) - account.had, 0)
        return max(account.skipped, account.indexed) + account.cut(self._cut_ns)

    def finish(self, recovery: Recovery) -> None:
        """Add the counts and close the new file."""
        self._start()
        self._writer.add_metadata(RECOVERY, {"recovery": recovery.model_dump_json()})
        self._writer.finish()  # type: ignore[no-untyped-call]


def _whole_summary(stream: IO[bytes]) -> Summary | None:
    """Return the summary if there is one with a right checksum.

    It contains the number of messages, and the channels that a lost first chunk defined.
    """
    stream.seek(0)
    with suppress(*DAMAGE, OSError):
        summary = make_reader(stream).get_summary()
        return summary if summary and summary_is_whole(stream) else None
    return None
