"""Reader of STL files, binary or text."""

import re

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_target.topology import areas_m2

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")
_HEADER_BYTES = 84


def read_stl(content: bytes) -> FloatArray:
    """Return the triangles of an STL file's content, shape (T, 3, 3), without those of zero area.

    Raises:
        ValueError: the content is wrong; the text continues a sentence that begins with the file's name.
    """
    corners = _read_binary(content) if _is_binary(content) else _read_text(content)
    if not np.isfinite(corners).all():
        raise ValueError("contains a coordinate that is not finite")
    corners = corners[areas_m2(corners) > 0.0]
    if not len(corners):
        raise ValueError("contains no triangle with an area greater than zero")
    return corners


def _is_binary(content: bytes) -> bool:
    """Return whether the header's count fits the size; the first word "solid" is not reliable."""
    if len(content) < _HEADER_BYTES:
        return False
    count = int.from_bytes(content[80:84], "little")
    return len(content) == _HEADER_BYTES + count * _RECORD.itemsize


def _read_binary(content: bytes) -> FloatArray:
    return np.frombuffer(content, _RECORD, offset=_HEADER_BYTES)["corners"].astype(np.float64)


def _read_text(content: bytes) -> FloatArray:
    vertices = _VERTEX.findall(content)
    if not content.lstrip().startswith(b"solid") or len(vertices) % 3:
        raise ValueError("is neither a binary nor a text STL file")
    try:
        return np.array(vertices).astype(np.float64).reshape(-1, 3, 3)
    except ValueError as error:
        raise ValueError("contains a coordinate that is not a number") from error
