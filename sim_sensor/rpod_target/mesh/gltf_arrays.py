"""The arrays of a glTF file as its reader, trimesh, needs them.

The reader leaves out fans of triangles. It ignores that integers encode shares of one (``normalized``),
and that some values of an array are replaced by others (``sparse``). So each of these is replaced in the
document before; the reader does the rest.
"""

import json
import struct
from base64 import b64decode
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import Array

_FAN = 6
"""Mode of a primitive whose triangles share their first corner."""
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_CHUNK = 8
"""Bytes before the content of a chunk of a GLB file."""
_HEADER = 12
"""Bytes before the first chunk."""


def prepared(content: bytes, beside: Callable[[str], bytes]) -> tuple[bytes, dict[str, bytes] | None]:
    """Return a document without what its reader leaves out or misreads, and its buffers as files, by name.

    A file that has nothing of this is returned as it is, with None.

    Args:
        content: bytes of a glTF or GLB file.
        beside: function that returns the bytes of a file that it refers to.

    Raises:
        Exception: the content is wrong, in any way.
    """
    document, binary = _document(content)
    if not str(document["asset"]["version"]).startswith("2"):
        return content, None  # its reader refuses it
    primitives = [one for mesh in document.get("meshes", ()) for one in mesh.get("primitives", ())]
    positions = {one["attributes"]["POSITION"] for one in primitives if "POSITION" in one["attributes"]}
    corners = {one["indices"] for one in primitives if "indices" in one}
    accessors = document.get("accessors", [])
    strange = [number for number in sorted(positions | corners) if _misread(accessors[number])]
    fans = [one for one in primitives if one.get("mode") == _FAN and "POSITION" in one["attributes"]]
    if not (strange or fans):
        return content, None
    arrays = _Arrays(document, binary, beside)
    for number in strange:
        accessors[number] = accessors[arrays.added(arrays.values(number))]
    for one in fans:
        count = accessors[one["attributes"]["POSITION"]]["count"]
        corner = arrays.values(one["indices"]).reshape(-1) if "indices" in one else np.arange(count)
        first = np.full(max(len(corner) - 2, 0), corner[0] if len(corner) else 0)
        triangles = np.stack([first, corner[1:-1], corner[2:]], axis=1)
        one |= {"mode": 4, "indices": arrays.added(triangles.astype(np.uint32).reshape(-1, 1))}
    files = arrays.files()
    return json.dumps(document).encode(), files


def bytes_of(accessor: Mapping[str, Any]) -> int:
    """Return the bytes of one value of an accessor, of all its columns; of an unknown type the most."""
    number = accessor.get("componentType")
    known = _TYPES.get(number) if isinstance(number, int) else None
    return np.dtype(known or "<f4").itemsize * _COLUMNS.get(str(accessor.get("type")), max(_COLUMNS.values()))


def _misread(accessor: Mapping[str, Any]) -> bool:
    """Return whether the reader ignores what an accessor says of its values."""
    return "sparse" in accessor or (bool(accessor.get("normalized")) and accessor["componentType"] != 5126)


def _document(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the document of a file, and the bytes that a GLB file has behind it."""
    if not content.startswith(b"glTF"):
        return json.loads(content), b""
    begin = _HEADER
    chunks: list[bytes] = []
    while begin + _CHUNK <= len(content) and len(chunks) < 2:
        (length,) = struct.unpack_from("<I", content, begin)
        chunks.append(content[begin + _CHUNK : begin + _CHUNK + length])
        begin += _CHUNK + length
    return json.loads(chunks[0]), chunks[1] if len(chunks) > 1 else b""


class _Arrays:
    """Arrays of a document, and new ones that it gets."""

    def __init__(self, document: dict[str, Any], binary: bytes, beside: Callable[[str], bytes]) -> None:
        self._document = document
        self._beside = beside
        self._buffers = [self._bytes(one.get("uri"), binary) for one in document.get("buffers", [])]

    def _bytes(self, uri: str | None, binary: bytes) -> bytes:
        if uri is None:
            return binary
        return b64decode(uri.partition("base64,")[2]) if uri.startswith("data:") else self._beside(uri)

    def values(self, number: int) -> Array:
        """Return the values of an accessor, shape (N, 1) or (N, 3)."""
        accessor = self._document["accessors"][number]
        count, columns = int(accessor["count"]), _COLUMNS[accessor["type"]]
        type_ = np.dtype(_TYPES[accessor["componentType"]])
        if "bufferView" in accessor:
            values = self._strided(accessor, type_, count, columns).copy()
        else:
            values = np.zeros((count, columns), type_)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            index_type = np.dtype(_TYPES[sparse["indices"]["componentType"]])
            index = self._strided(sparse["indices"], index_type, int(sparse["count"]), 1)[:, 0]
            values[index] = self._strided(sparse["values"], type_, int(sparse["count"]), columns)
        if not accessor.get("normalized") or type_.kind == "f":
            return values
        return np.maximum(values.astype(np.float64) / np.iinfo(type_).max, -1.0).astype(np.float32)

    def _strided(self, place: Mapping[str, Any], type_: np.dtype[Any], count: int, columns: int) -> Array:
        view = self._document["bufferViews"][place["bufferView"]]
        buffer = self._buffers[view["buffer"]]
        begin = int(view.get("byteOffset", 0)) + int(place.get("byteOffset", 0))
        stride = int(view.get("byteStride", columns * type_.itemsize))
        if stride < columns * type_.itemsize or begin < 0:
            raise ValueError(f"values of {columns * type_.itemsize} bytes that are {stride} bytes apart")
        found: NDArray[Any] = np.ndarray((count, columns), type_, buffer, begin, (stride, type_.itemsize))
        return found

    def added(self, values: Array) -> int:
        """Add an array of 32 bits a value, shape (N, 1) or (N, 3); return the number of its accessor."""
        document = self._document
        kind, columns = (5126 if values.dtype.kind == "f" else 5125), values.shape[1]
        raw = np.ascontiguousarray(values, _TYPES[kind]).tobytes()
        self._buffers.append(raw)
        document["buffers"].append({"byteLength": len(raw)})
        document["bufferViews"].append({"buffer": len(self._buffers) - 1, "byteLength": len(raw)})
        accessor = {"componentType": kind, "count": len(values), "type": "SCALAR" if columns == 1 else "VEC3"}
        document["accessors"].append({"bufferView": len(document["bufferViews"]) - 1, **accessor})
        return len(document["accessors"]) - 1

    def files(self) -> dict[str, bytes]:
        """Name each buffer of the document as a file; return the files, by name."""
        for number, buffer in enumerate(self._document["buffers"]):
            buffer["uri"] = str(number)
        return {str(number): content for number, content in enumerate(self._buffers)}
