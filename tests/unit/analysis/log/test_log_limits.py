"""Files that ask for more than a log does: told in one line, in bounded memory, and read if that is meant."""

import tracemalloc
from contextvars import ContextVar
from io import BytesIO
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, Schema, Statistics
from synthetic_log import SyntheticRun

from rpod_analysis.errors import DamagedLogError, LogLimitError, NothingRecoveredError
from rpod_analysis.log import limits, open_log
from rpod_analysis.log.limits import LogLimits, lifted
from rpod_analysis.recovery import recover, salvage
from rpod_schemas.rmw.cdr import is_known, learn

MAGIC = b"\x89MCAP0\r\n"
MIB = 1 << 20
SCHEMA = Schema(id=1, data=b"string data\n", encoding="ros2msg", name="std_msgs/msg/String")


def written(*records) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


def log(path: Path, compression: str, data: bytes, *, announced: int, channels: int = 1) -> Path:
    """Write a log with one chunk, which announces a size of its content."""
    beginning = MAGIC + written(Header(profile="ros2", library=""))
    chunk = Chunk(
        compression=compression,
        data=data,
        message_start_time=1,
        message_end_time=2,
        uncompressed_crc=0,
        uncompressed_size=announced,
    )
    body = written(chunk)
    index = ChunkIndex(
        chunk_length=len(body),
        chunk_start_offset=len(beginning),
        compression=compression,
        compressed_size=len(data),
        message_start_time=1,
        message_end_time=2,
        message_index_length=0,
        message_index_offsets={number: len(beginning) for number in range(channels)},
        uncompressed_size=announced,
    )
    statistics = Statistics(
        attachment_count=0,
        channel_count=channels,
        channel_message_counts={0: 1},
        chunk_count=1,
        message_count=1,
        message_start_time=1,
        message_end_time=2,
        metadata_count=0,
        schema_count=1,
    )
    named = [
        Channel(id=number, topic=f"t{number}", message_encoding="cdr", metadata={}, schema_id=1)
        for number in range(channels)
    ]
    before = beginning + body + written(DataEnd(data_section_crc=0))
    summary = written(SCHEMA, *named, index, statistics)
    end = written(Footer(summary_start=len(before), summary_offset_start=0, summary_crc=0))
    path.write_bytes(before + summary + end + MAGIC)
    return path


def bomb(compression: str) -> bytes:
    """Return 64 MiB of zeros, compressed."""
    zeros = bytes(64 * MIB)
    if compression == "lz4":
        return lz4.frame.compress(zeros, store_size=False)
    return zstandard.ZstdCompressor().compress(zeros)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_chunk_is_never_decompressed_beyond_its_announced_size(tmp_path, compression):
    path = log(tmp_path / "log.mcap", compression, bomb(compression), announced=MIB)
    tracemalloc.start()
    with open_log(path) as opened, pytest.raises(DamagedLogError, match=r"announces 1,048,576 bytes"):
        list(opened.messages())
    with pytest.raises(NothingRecoveredError) as found:
        recover(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.value.recovery.unreadable_bytes > 0
    assert peak < 200 * MIB


def test_a_chunk_that_announces_too_much_is_refused_in_one_line_and_not_recovered(tmp_path):
    path = log(tmp_path / "log.mcap", "lz4", bomb("lz4"), announced=1 << 32)
    with pytest.raises(LogLimitError, match=r"4,294,967,296 bytes in a chunk.*--no-limits"):
        open_log(path)
    with pytest.raises(NothingRecoveredError, match=r"1 chunks announce too many bytes.*--no-limits"):
        recover(path)


def test_many_channels_are_refused_and_read_where_the_limits_are_lifted(tmp_path):
    path = log(tmp_path / "log.mcap", "", b"", announced=0, channels=10_001)
    with pytest.raises(LogLimitError, match=r"10,001 channels, at most 10,000"):
        open_log(path)
    with lifted(), open_log(path) as opened:
        assert len(opened.topics) == 10_001


def test_the_contents_of_a_file_have_a_limit_by_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "limits", lambda: LogLimits(content_bytes=MIB))
    path = log(tmp_path / "log.mcap", "zstd", bomb("zstd"), announced=64 * MIB)
    with pytest.raises(LogLimitError, match=r"67,108,864 bytes in chunks, of a file of 2,\d+ bytes"):
        open_log(path)


def test_messages_without_end_are_refused_and_read_where_the_limits_are_lifted(tmp_path, monkeypatch):
    path = SyntheticRun().write(tmp_path / "run.mcap")
    few = LogLimits(messages=5, bytes_per_message=1e9)
    monkeypatch.setattr(limits, "_LIMITS", ContextVar("few", default=few))
    with open_log(path) as opened, pytest.raises(LogLimitError, match=r"6 messages, at most 5.*--no-limits"):
        list(opened.messages())
    with lifted(), open_log(path) as opened:
        assert len(list(opened.messages())) > 5


class Counted(BytesIO):
    read_bytes = 0

    def read(self, size: int | None = -1) -> bytes:
        found = super().read(size)
        self.read_bytes += len(found)
        return found


def test_a_search_for_records_among_candidates_as_long_as_the_file_is_given_up(monkeypatch):
    monkeypatch.setattr(salvage, "limits", lambda: LogLimits(content_bytes=MIB, ratio=2.0))
    candidate = b"\x03" + (63_000).to_bytes(8, "little")  # a multiple of its own length
    stream = Counted(MAGIC + 20_000 * candidate)
    (found,) = salvage.scan(stream)
    assert isinstance(found, salvage.DamagedChunk)
    assert found.over_limit
    assert stream.read_bytes < 3 * MIB


@pytest.mark.parametrize("name", ["1a/msg/B", "a/msg/B'):\n  raise SystemExit", "a/msg/class", "a/msg/C d"])
def test_a_definition_whose_name_is_none_is_not_run(name):
    learn(name, b"uint8 x\n")
    assert is_known(name) == (name == "a/msg/class")


def test_a_definition_of_a_megabyte_is_not_learnt():
    learn("a/msg/Long", b"uint8 x\n" + b"#" * MIB)
    assert not is_known("a/msg/Long")
