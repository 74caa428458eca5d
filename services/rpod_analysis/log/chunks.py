"""Decompression of a chunk that never gives more bytes than the chunk announces."""

from collections.abc import Iterator
from typing import Any

import lz4.frame
import zstandard

from rpod_analysis.errors import AnalysisError

_PIECE = 1 << 14
"""Compressed bytes that are decompressed at once; lz4 makes at most 255 times as many of them."""


class ChunkSizeError(AnalysisError, ValueError):
    """A chunk's content has another size than the chunk announces."""

    def __init__(self, announced: int, found: str) -> None:
        super().__init__(f"a chunk announces {announced:,} bytes and contains {found}")


def content(compression: str, data: bytes, size: int) -> bytes:
    """Return a chunk's content.

    Args:
        compression: as in the chunk: ``lz4``, ``zstd``, or empty for none.
        data: the compressed bytes.
        size: size of the content as announced, bytes.

    Raises:
        ChunkSizeError: the content has another size.
        ValueError: the compression is unknown.
        RuntimeError, zstandard.ZstdError: the bytes are damaged.
    """
    found = bytearray()
    for piece in pieces(compression, data):
        found += piece
        if len(found) > size:
            raise ChunkSizeError(size, "more")
    if len(found) < size:
        raise ChunkSizeError(size, f"{len(found):,}")
    return bytes(found)


def pieces(compression: str, data: bytes) -> Iterator[bytes]:
    """Yield a chunk's content in pieces of a few megabytes at most; errors as ``content``, at their place."""
    if compression == "lz4":
        unpacker: Any = lz4.frame.LZ4FrameDecompressor()
        for start in range(0, len(data), _PIECE):
            yield unpacker.decompress(data[start : start + _PIECE])
    elif compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            while piece := stream.read(zstandard.DECOMPRESSION_RECOMMENDED_OUTPUT_SIZE):
                yield piece
    elif compression:
        raise ValueError(f"unknown compression {compression!r}; lz4, zstd and none are read")
    else:
        yield data
