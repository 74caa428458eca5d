"""Reading logs in tests with the MCAP library alone."""

from collections import Counter
from contextlib import suppress
from io import BytesIO
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Message


def read_closed(path: Path) -> Counter[str]:
    """Return the number of messages of each topic; every byte of a closed log is read and checked."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None, "the log was not closed"
        assert summary.statistics is not None
        counts = Counter(channel.topic for _, channel, _ in reader.iter_messages())
        assert counts.total() == summary.statistics.message_count
        assert "counts" in {item.name for item in reader.iter_metadata()}, "written at the close"
    return counts


def messages_of(path: Path, topic: str) -> list[Message]:
    """Return a topic's messages in the order of the file, up to where a log that was not closed ends."""
    messages: list[Message] = []
    reader = NonSeekingReader(_WholeReads(path.read_bytes()))
    with suppress(McapError):
        for _, _, message in reader.iter_messages(topic, log_time_order=False):
            messages.append(message)
    return messages


class _WholeReads(BytesIO):
    """The bytes of a log at one moment.

    A read beyond their end gives nothing, which the library takes as the end.
    The library would go on after a shorter read. In a log that still grows it would then read other bytes.
    """

    def read(self, size: int | None = -1) -> bytes:
        """Return `size` bytes, or none if fewer are left."""
        data = super().read(size)
        return b"" if size is not None and len(data) < size else data
