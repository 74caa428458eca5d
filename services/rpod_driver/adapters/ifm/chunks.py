"""Chunks of a PCIC buffer, as an ifm O3R sends its images.

A buffer is a ticket of 4 bytes, ``star``, chunks, and ``stop``. Each chunk has a header: type, size of the
chunk, size of the header, header's version, width, height, pixel format, stamp in microseconds, frame count;
from version 2 on status code, stamp in seconds and in nanoseconds; version 3 adds metadata in JSON. (ifm3d,
Apache-2.0: modules/framegrabber, default_organizer.cpp and organizer_utils.cpp at 06f434f; buffer_id.h.)
"""

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_driver.errors import RecordingError
from rpod_schemas.messages import NANOSECONDS

RADIAL_DISTANCE, AMPLITUDE, DISTANCE_NOISE, REFLECTIVITY = 100, 101, 105, 106
CONFIDENCE, TOF_INFO = 300, 420
"""Types of chunks (ifm3d's ``buffer_id``)."""
_START, _STOP, _TICKET_BYTES = b"star", b"stop", 4
_HEADER, _STAMP, _STAMPED_BYTES = struct.Struct("<9I"), struct.Struct("<3I"), 48
_PIXELS = {0: "u1", 1: "i1", 2: "<u2", 3: "<i2", 4: "<u4", 5: "<i4", 6: "<f4", 7: "<u8", 8: "<f8"}
"""NumPy's types by the pixel format (ifm3d's ``pixel_format``)."""
_REMEDY = "correct device.recording, or record it again"


@dataclass(frozen=True)
class Chunk:
    """One image or structure of a buffer."""

    type: int
    width: int
    height: int
    pixel_format: int
    stamp_ns: int
    """Stamp by the device's clock, ns."""
    frame_count: int
    metadata: dict[str, Any]
    """Metadata that the header holds; empty before version 3 of it."""
    data: bytes

    def image(self) -> NDArray[Any]:
        """Return the pixels, shape (height, width). Raises ``RecordingError`` if they are not as many."""
        code = _PIXELS.get(self.pixel_format)
        size = self.width * self.height * np.dtype(code or "u1").itemsize
        if code is None or len(self.data) < size:
            raise RecordingError(
                f"image {self.type}",
                f"{len(self.data)} bytes of pixel format {self.pixel_format} are not {self.width} x "
                f"{self.height} pixels; {_REMEDY}",
            )
        return np.frombuffer(self.data[:size], code).reshape(self.height, self.width)


def buffers(content: bytes, source: str) -> Iterator[dict[int, Chunk]]:
    """Yield the chunks of each buffer in a recording, by their type.

    Raises:
        RecordingError: the content is cut, or no recording of PCIC buffers; names the byte.
    """
    at = 0
    while at < len(content):
        if content[at + _TICKET_BYTES : at + 8] != _START:
            raise RecordingError(
                source,
                f"no 'star' at byte {at + _TICKET_BYTES}: it is no recording of PCIC buffers, or cut; "
                f"{_REMEDY}",
            )
        at += 8
        chunks: dict[int, Chunk] = {}
        while content[at : at + 4] != _STOP:
            chunk, at = _chunk(content, at, source)
            chunks[chunk.type] = chunk
        yield chunks
        at = _after_line(content, at + 4)


def _after_line(content: bytes, at: int) -> int:
    while at < len(content) and content[at : at + 1] in (b"\r", b"\n"):
        at += 1
    return at


def _chunk(content: bytes, at: int, source: str) -> tuple[Chunk, int]:
    """Return the chunk at a byte, and the byte after it."""
    left = len(content) - at
    if left < _HEADER.size:
        raise RecordingError(
            source, f"cut: {left} bytes are left at byte {at}, a chunk's header has more; {_REMEDY}"
        )
    kind, size, header, _, width, height, pixels, stamp_us, count = _HEADER.unpack_from(content, at)
    if not _HEADER.size <= header <= size <= left:
        raise RecordingError(
            source,
            f"chunk {kind} at byte {at} says {size} bytes, {header} of its header; {left} are left; "
            f"{_REMEDY}",
        )
    stamp_ns, metadata = stamp_us * 1000, {}
    if header >= _STAMPED_BYTES:
        _, seconds, nanoseconds = _STAMP.unpack_from(content, at + _HEADER.size)
        stamp_ns = seconds * NANOSECONDS + nanoseconds
        metadata = _json(content[at + _STAMPED_BYTES : at + header], kind, source)
    data = content[at + header : at + size]
    return Chunk(kind, width, height, pixels, stamp_ns, count, metadata, data), at + size


def _json(text: bytes, kind: int, source: str) -> dict[str, Any]:
    stripped = text.rstrip(b"\0 ")
    if not stripped:
        return {}
    try:
        found = json.loads(stripped)
    except (ValueError, RecursionError) as error:
        raise RecordingError(source, f"metadata of chunk {kind} is no JSON ({error}); {_REMEDY}") from error
    return found if isinstance(found, dict) else {}
