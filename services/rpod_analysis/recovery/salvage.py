"""Finds the complete records of a damaged MCAP file, in the order of the file, and the gaps between them.

A record is accepted only as a whole: its length must fit the file, and its content must give the same bytes
when it is written again. A chunk is accepted by its checksum. If bytes are not a record, the search for the
next one goes on byte by byte (MCAP specification, "Records": one byte of opcode, eight of length, the
content).
"""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from io import BytesIO
from typing import IO, Any

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import breakup_chunk

from rpod_analysis.log.chunks import content, pieces
from rpod_analysis.log.limits import limits
from rpod_analysis.log.log_file import MAGIC

DAMAGE = (
    McapError,
    RuntimeError,
    ValueError,
    KeyError,
    struct.error,
    EOFError,
    MemoryError,
    zstandard.ZstdError,
)
"""Exceptions that the MCAP library and the decompression raise on damaged bytes."""

_FRAME = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
"""Chunk: first and last time, size and checksum of the content, length of the compression's name."""
_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{4}\x00{4})", re.DOTALL)
"""Pattern of an opcode and a length below 4 GiB; a lookahead, so that candidates may overlap."""
_WINDOW = 1 << 22
_MOST_BYTES = 1 << 30
"""Largest length of a valid record."""
_TYPES: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.MESSAGE: Message,
    Opcode.CHUNK: Chunk,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
    Opcode.DATA_END: DataEnd,
}


@dataclass(frozen=True)
class Gap:
    """Bytes that are not a record."""

    start: int
    end: int


@dataclass(frozen=True)
class DamagedChunk:
    """A chunk with a wrong checksum, or that is truncated by the end of the file, or over the limit."""

    size: int
    """Size in the file, bytes."""
    definitions: tuple[Schema | Channel, ...]
    """Schemas and channels in it, read in spite of the damage, because later messages need them."""
    whole: tuple[Message, ...] = ()
    """Complete messages of a truncated chunk."""
    end_ns: int | None = None
    """Time of arrival of the last message of a truncated chunk, from its header."""
    over_limit: bool = False
    """Whether it was not read because it announces more than the limit, or a search for records in it would
    read more than that."""


Found = McapRecord | Gap | DamagedChunk


def is_mcap(stream: IO[bytes]) -> bool:
    """Return whether a file begins with the bytes of an MCAP file."""
    stream.seek(0)
    return stream.read(len(MAGIC)) == MAGIC


def scan(stream: IO[bytes]) -> Iterator[Found]:
    """Yield the content of a file from its beginning to its end; for a chunk, yield the records in it.

    It reads one record at a time and never raises on damage.
    """
    size = stream.seek(0, 2)
    offset = len(MAGIC) if is_mcap(stream) else 0
    search = _Search(stream, size)
    while offset < size:
        whole = _record_at(stream, offset, size)
        if whole is None:
            resumed = search.next_record(offset + 1)
            cut = _cut_chunk(stream, offset, size) if resumed == size else None
            given_up = DamagedChunk(size - offset, (), over_limit=True) if search.given_up else None
            yield given_up or cut or Gap(offset, resumed)
            offset = resumed
            continue
        record, length = whole
        yield from _opened(record, length) if isinstance(record, Chunk) else (record,)
        offset += length
        if isinstance(record, Footer) and _tail(stream, offset) == MAGIC:
            return


def _tail(stream: IO[bytes], offset: int) -> bytes:
    stream.seek(offset)
    return stream.read(len(MAGIC) + 1)


def _record_at(stream: IO[bytes], offset: int, size: int) -> tuple[McapRecord, int] | None:
    """Return the record that begins at an offset, and its length; None if there is no complete one."""
    frame = _frame_at(stream, offset, size)
    if frame is None:
        return None
    opcode, length = frame
    if opcode == Opcode.CHUNK and not _is_chunk(stream, length):
        return None
    stream.seek(offset + _FRAME.size)
    record = _parse(opcode, stream.read(length))
    return None if record is None else (record, _FRAME.size + length)


def _frame_at(stream: IO[bytes], offset: int, size: int) -> tuple[int, int] | None:
    stream.seek(offset)
    head = stream.read(_FRAME.size)
    if len(head) < _FRAME.size:
        return None
    opcode, length = _FRAME.unpack(head)
    if opcode not in _TYPES or length > min(size - offset - _FRAME.size, _MOST_BYTES):
        return None
    return opcode, length


def _is_chunk(stream: IO[bytes], length: int) -> bool:
    """Return whether the lengths within a chunk add up to its own; the stream is after opcode and length."""
    head = stream.read(_CHUNK.size)
    if len(head) < _CHUNK.size:
        return False
    name_length = _CHUNK.unpack(head)[-1]
    if name_length > len("zstd"):
        return False
    rest = stream.read(name_length + 8)
    return (
        len(rest) == name_length + 8
        and _CHUNK.size + len(rest) + int.from_bytes(rest[name_length:], "little") == length
    )


def _parse(opcode: int, content: bytes) -> McapRecord | None:
    """Return the record with a content; None if its parts do not add up to the whole."""
    kind, stream = _TYPES[opcode], ReadDataStream(BytesIO(content))
    try:
        if kind is Message:
            return Message.read(stream, len(content)) if len(content) >= 22 else None
        record: McapRecord = kind.read(stream)
    except DAMAGE:
        return None
    return record if kind is Chunk or _written(record) == content else None


def _written(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    try:
        record.write(builder)
    except DAMAGE:
        return b""
    content: bytes = builder.end()  # type: ignore[no-untyped-call]
    return content[_FRAME.size :]


class _Search:
    """Searches for the next record of a file byte by byte.

    A hostile file may have a candidate at each byte, each as long as the file. So it reads as many bytes of
    candidates as a file's content may have, and then gives up.
    """

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream, self._size = stream, size
        self._left = max(limits().content_bytes, limits().ratio * size)
        self.given_up = False

    def next_record(self, offset: int) -> int:
        """Return where the next record begins that is followed by another one or by the end of the file."""
        while offset < self._size and not self.given_up:
            self._stream.seek(offset)
            window = self._stream.read(_WINDOW)
            for match in _CANDIDATE.finditer(window):
                start = offset + match.start()
                if self._is_record(start):
                    return start
                if self.given_up:
                    break
            offset += max(len(window) - _FRAME.size, 1)
        return self._size

    def _is_record(self, start: int) -> bool:
        frame = _frame_at(self._stream, start, self._size)
        # Messages in an uncompressed chunk look like records, but no checksum protects their bytes.
        if frame is None or frame[0] == Opcode.MESSAGE:
            return False
        if not _goes_on(self._stream, start + _FRAME.size + frame[1], self._size):
            return False
        self._left -= frame[1]
        self.given_up = self._left < 0
        return not self.given_up and _record_at(self._stream, start, self._size) is not None


def _goes_on(stream: IO[bytes], offset: int, size: int) -> bool:
    return (
        offset == size
        or _tail(stream, offset)[: len(MAGIC)] == MAGIC
        or bool(_frame_at(stream, offset, size))
    )


def _opened(chunk: Chunk, length: int) -> Iterator[Found]:
    if chunk.uncompressed_size > limits().chunk_bytes:
        yield DamagedChunk(length, (), over_limit=True)
        return
    try:
        data = content(chunk.compression, chunk.data, chunk.uncompressed_size)
        yield from breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)
    except DAMAGE:
        yield DamagedChunk(length, tuple(_definitions(_records_in(_unpacked(chunk.compression, chunk.data)))))


def _cut_chunk(stream: IO[bytes], offset: int, size: int) -> DamagedChunk | None:
    """Return the content of a file's last chunk, whose end is missing; None if it is not a chunk."""
    stream.seek(offset)
    head = stream.read(_FRAME.size + _CHUNK.size)
    if len(head) < _FRAME.size + _CHUNK.size or head[0] != Opcode.CHUNK:
        return None
    _, end_ns, _, _, name_length = _CHUNK.unpack(head[_FRAME.size :])
    length = _FRAME.unpack_from(head)[1]
    if name_length > len("zstd") or length > _MOST_BYTES:
        return None
    compression, _ = stream.read(name_length), stream.read(8)
    records = list(_records_in(_unpacked(compression.decode("latin-1"), stream.read(length))))
    return DamagedChunk(
        size - offset,
        tuple(_definitions(records)),
        tuple(record for record in records if isinstance(record, Message)),
        end_ns,
    )


def _definitions(records: Any) -> Iterator[Schema | Channel]:
    return (record for record in records if isinstance(record, Schema | Channel))


def _unpacked(compression: str, data: bytes) -> bytes:
    """Return a chunk's content as far as it can be decompressed, and as the limits allow."""
    found, most = bytearray(), limits().chunk_bytes
    with suppress(*DAMAGE):
        for piece in pieces(compression, data):
            found += piece
            if len(found) > most:
                break
    return bytes(found)


def _records_in(content: bytes) -> Iterator[McapRecord]:
    """Yield the complete records at the beginning of a chunk's content."""
    offset = 0
    while offset + _FRAME.size <= len(content):
        opcode, length = _FRAME.unpack_from(content, offset)
        start = offset + _FRAME.size
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE) or start + length > len(content):
            return
        record = _parse(opcode, content[start : start + length])
        if record is None:
            return
        yield record
        offset = start + length
