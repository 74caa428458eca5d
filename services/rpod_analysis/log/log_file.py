"""Opening of a file of a log, or of all files of a folder, with an error that names the defect."""

import struct
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, cast

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import McapReader, make_reader
from mcap.records import ChunkIndex, Schema, Statistics
from mcap.summary import Summary
from zstandard import ZstdError

from rpod_analysis.errors import DamagedLogError, NoLogError, NotMcapError, TruncatedLogError
from rpod_analysis.log import limits
from rpod_analysis.log.chunks import content
from rpod_schemas.logs import SCHEMA_ENCODING
from rpod_schemas.rmw.cdr import learn
from rpod_schemas.texts import reason_of

SUFFIX, RECOVERED, REPLAY = ".mcap", ".recovered", ".replay"
"""Suffix of logs, and of the files that recovery and replay write beside ``run.mcap``:
``run.recovered.mcap`` and ``run.replay.mcap``."""

MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<QQI")
"""Footer: beginning of the summary, beginning of its offsets, checksum from the summary up to here."""
_CHUNK = struct.Struct("<BQQQQ")
"""Chunk: opcode, length, first and last time, size of the content; checksum and compression follow."""
_LENGTHS = struct.Struct("<II")
"""Chunk, after the above: checksum of the content, length of the compression's name."""
_FRAME_BYTES = 9
_DAMAGE = (McapError, RuntimeError, ValueError, KeyError, OverflowError, struct.error, EOFError, ZstdError)
"""Exceptions that the MCAP reader and the decompression raise on damaged bytes."""


def beside(log: Path, kind: str) -> Path:
    """Return the path of a file derived from a log, beside it: ``run.replay.mcap`` for ``run.mcap``."""
    return log.with_name(f"{log.stem}{kind}{log.suffix}")


def files_of(path: Path) -> list[Path]:
    """Return the file itself, or a folder's logs: recovered ones replace damaged ones, replays are left out.

    Raises:
        NoLogError: the folder holds no log.
    """
    try:
        if not path.is_dir():
            return [path]
        files = sorted(path.glob(f"*{SUFFIX}"))
    except OSError as error:
        raise NoLogError(path, reason_of(error)) from error
    files = [
        file for file in files if not file.stem.endswith(REPLAY) and beside(file, RECOVERED) not in files
    ]
    if not files:
        raise NoLogError(path, f"no {SUFFIX} file in this folder; give the folder of one run, or its log")
    return files


class _CheckedFile:
    """A file whose chunks are compared with their index, and are decompressed within their announced size.

    The reader does neither. It is given each chunk as one without compression.
    """

    def __init__(self, path: Path, stream: IO[bytes]) -> None:
        self.tell, self.read, self.seekable = stream.tell, stream.read, stream.seekable
        self._path, self._stream = path, stream
        self._chunks: dict[int, ChunkIndex] = {}

    def expect(self, chunks: list[ChunkIndex]) -> None:
        """Store the chunks by the offset to which the reader seeks: after opcode and length."""
        self._chunks = {index.chunk_start_offset + _FRAME_BYTES: index for index in chunks}

    def seek(self, offset: int, whence: int = 0) -> int:
        """Seek to an offset. Raises ``DamagedLogError`` if the chunk that should be there is not."""
        index = self._chunks.get(offset) if whence == 0 else None
        if index is None:
            self.read = self._stream.read
            return self._go_to(offset, whence)
        self.read = self._plain_chunk(index).read
        return offset

    def _go_to(self, offset: int, whence: int = 0) -> int:
        try:
            return self._stream.seek(offset, whence)
        except (OSError, ValueError, OverflowError) as error:  # before the beginning, or beyond any file
            raise DamagedLogError(self._path, f"it refers to byte {offset}") from error

    def _plain_chunk(self, index: ChunkIndex) -> BytesIO:
        """Return the content of a chunk's record, as if it had been written without compression."""
        self._go_to(index.chunk_start_offset)
        compression = index.compression.encode()
        head = _CHUNK.pack(
            Opcode.CHUNK,
            index.chunk_length - _FRAME_BYTES,
            index.message_start_time,
            index.message_end_time,
            index.uncompressed_size,
        )
        found = self._stream.read(_CHUNK.size + _LENGTHS.size + len(compression))
        if found[: _CHUNK.size] != head or found[_CHUNK.size + _LENGTHS.size :] != compression:
            raise DamagedLogError(self._path, f"no chunk at byte {index.chunk_start_offset}")
        checksum, _ = _LENGTHS.unpack_from(found, _CHUNK.size)
        packed = self._stream.read(8 + min(index.compressed_size, index.chunk_length))[8:]
        data = content(index.compression, packed, index.uncompressed_size)
        plain = head[_FRAME_BYTES:] + _LENGTHS.pack(checksum, 0) + len(data).to_bytes(8, "little")
        return BytesIO(plain + data)


@dataclass(frozen=True)
class LogFile:
    """An open file of a log."""

    path: Path
    reader: McapReader
    summary: Summary
    statistics: Statistics
    """Number of messages, and the times of the first and the last one."""
    most_messages: float
    """Largest number of messages that are read; the file itself may announce less than it has."""

    def metadata(self, record: str) -> dict[str, str]:
        """Return a metadata record, empty if there is none; later values replace earlier ones."""
        values: dict[str, str] = {}
        with reading(self.path):
            for item in self.reader.iter_metadata():
                values |= item.metadata if item.name == record else {}
        return values

    def type_of(self, schema_id: int) -> str:
        """Return the ROS 2 type of a channel's schema; empty if it has none."""
        schema = self.summary.schemas.get(schema_id)
        return ros_type(schema) if schema else ""


def ros_type(schema: Schema) -> str:
    """Return a schema's type in the form ``std_msgs/msg/Header``; some programs write ``std_msgs/Header``."""
    if schema.encoding == SCHEMA_ENCODING and schema.name.count("/") == 1:
        return schema.name.replace("/", "/msg/")
    return schema.name


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Convert exceptions that damaged bytes cause to ``DamagedLogError``."""
    try:
        yield
    except _DAMAGE as error:
        raise DamagedLogError(path, " ".join(str(error).split()) or type(error).__name__) from error


def open_file(path: Path, stack: ExitStack) -> LogFile:
    """Open a file for as long as the stack lives, and learn its message types. Raises ``AnalysisError``."""
    try:
        stream = stack.enter_context(path.open("rb"))
        _check_ends(path, stream)
    except OSError as error:
        raise NoLogError(path, reason_of(error)) from error
    checked = _CheckedFile(path, stream)
    with reading(path):
        reader = make_reader(cast("IO[bytes]", checked), validate_crcs=True)
        summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise TruncatedLogError(path)
    if not summary_is_whole(stream):
        raise DamagedLogError(path, "the checksum of its summary is wrong")
    size = stream.seek(0, 2)
    limits.check(path, size, summary)
    checked.expect(summary.chunk_indexes)
    for schema in summary.schemas.values():
        if schema.encoding == SCHEMA_ENCODING:
            learn(ros_type(schema), schema.data)
    return LogFile(path, reader, summary, summary.statistics, limits.limits().most_messages(size))


def summary_is_whole(stream: IO[bytes]) -> bool:
    """Return whether the summary's checksum is right or absent (MCAP specification, "Footer")."""
    stream.seek(-len(MAGIC) - _FOOTER.size, 2)
    end = stream.tell() + _FOOTER.size - 4
    summary_start, _, checksum = _FOOTER.unpack(stream.read(_FOOTER.size))
    stream.seek(summary_start)
    return checksum in (0, zlib.crc32(stream.read(end - summary_start)))


def _check_ends(path: Path, stream: IO[bytes]) -> None:
    """Check that a file begins and ends with the eight bytes of MCAP; the end shows that it was closed."""
    if stream.read(len(MAGIC)) != MAGIC:
        raise NotMcapError(path)
    size = stream.seek(0, 2)
    stream.seek(max(size - len(MAGIC), len(MAGIC)))
    if stream.read() != MAGIC:
        raise TruncatedLogError(path)
    stream.seek(0)
