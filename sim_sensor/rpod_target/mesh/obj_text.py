"""The text of an OBJ file as its reader, trimesh, needs it.

The reader forgets the name of a material that no library defines, splits corners by their texture and normal
indices, splits polygons as fans, counts negative indices from the end of the file, and passes over lines
that are indented or have tabs. So each of these is replaced in the text before; the reader does the rest.
"""

import io
import math
import re
from collections.abc import Iterator, Mapping
from functools import cached_property

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh.polygons import concave, triangulated
from rpod_target.mesh.text import as_utf8, local_name, with_line_feeds
from rpod_target.mesh.topology import Indices

_USED = re.compile(rb"^[ \t]*usemtl(?:[ \t]+(\S.*?))?[ \t\r]*$", re.MULTILINE)
_USED_NONE = re.compile(rb"^[ \t]*usemtl[ \t\r]*$", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t]", re.MULTILINE)
_LIBRARY = re.compile(rb"^[ \t]*mtllib(?:[ \t]+(\S.*?))?[ \t\r]*$", re.MULTILINE)
_SEVERAL = re.compile(r"(?<=\.mtl)\s+", re.IGNORECASE)
_INDENT = re.compile(rb"^ ++", re.MULTILINE)
_DEFINED = re.compile(rb"^[ \t]*newmtl[ \t]+(\S.*?)[ \t\r]*$", re.MULTILINE)
_OBJECT = re.compile(rb"^\s*o\s+\S", re.MULTILINE)
_TEXTURE = re.compile(rb"^\s*(map_|bump|disp|decal|refl|norm).*$", re.MULTILINE | re.IGNORECASE)
_FACES = re.compile(rb"(?:^[ \t]*+f[ \t][^\n]*+(?:\n|\Z)){1,65536}+", re.MULTILINE)
_POLYGON = re.compile(rb"^[ \t]*+f(?:[ \t]++[^\s#]++){4}", re.MULTILINE)
_AFTER_SLASH = re.compile(rb"/[-0-9/]*")
_CORNER = re.compile(rb"^[ \t]*+v[ \t]++(\S++)[ \t]++(\S++)[ \t]++(\S++)", re.MULTILINE)
_CORNER_LINE = re.compile(rb"^[ \t]*+v[ \t]", re.MULTILINE)
_OWN_LIBRARY = "materials.mtl"
NO_MATERIAL = "no-material-of-the-file"
"""Name that stands for no material, since the reader splits and renames the objects of faces without one."""
NO_CORNER = "has a face with a corner that is not in the file: export it again"
"""Why a file is refused whose faces count beyond its corners."""

NO_NUMBER = "has a coordinate that is no number: export it again, with points before the decimals"
"""Why a file is refused whose coordinates have, for example, commas in them."""


def libraries(content: bytes) -> tuple[str, ...]:
    """Return the names of the material libraries of a text in UTF-8, relative to its folder."""
    content = with_line_feeds(content)
    found = _LIBRARY.findall(content) if b"mtllib" in content else []  # a search of 200 MB takes a second
    names = [name for line in found if line for name in _SEVERAL.split(line.decode("utf-8", "replace"))]
    return tuple(dict.fromkeys(local_name(name) for name in names))


def has_objects(content: bytes) -> bool:
    """Return whether a file has ``o`` lines."""
    return _OBJECT.search(content) is not None


def prepared(content: bytes, beside: Mapping[str, bytes]) -> tuple[bytes, dict[str, bytes]]:
    """Return the text of a file, and one library in which each used material is defined, without textures.

    Args:
        content: text in UTF-8, or in another encoding in which ASCII is the same.
        beside: its libraries by name, in any encoding.

    Raises:
        ValueError: a face names a corner that is not there, or a coordinate is no number.
    """
    content = _plain(content)
    beside = {name: _plain(as_utf8(library)) for name, library in beside.items()}
    if b"\\\n" in content or b"\\\r\n" in content:
        content = re.sub(rb"\\\r?\n", b" ", content)
    used = tuple(dict.fromkeys(_USED.findall(content))) if b"usemtl" in content else ()
    content = _with_no_material(content, used)
    library = b"\n".join(_TEXTURE.sub(b"", found) for found in beside.values())
    defined = set(_DEFINED.findall(library))
    missing = [name for name in (*used, NO_MATERIAL.encode()) if name and name not in defined]
    library += b"".join(b"\nnewmtl " + name + b"\n" for name in missing)
    faces = _Faces(content)
    body = _FACES.sub(faces.plain, content)
    if b"mtllib" in content:
        body = _LIBRARY.sub(b"", body)
    return b"mtllib " + _OWN_LIBRARY.encode() + b"\n" + body, {_OWN_LIBRARY: library}


def _with_no_material(content: bytes, used: tuple[bytes, ...]) -> bytes:
    """Return a text in which faces without a material name one, if other faces have one."""
    if not any(used):
        return content
    none = b"usemtl " + NO_MATERIAL.encode()
    if b"" in used:
        content = _USED_NONE.sub(none, content)
    first = _USED.search(content)
    before = None if first is None else _FACE.search(content, 0, first.start())
    return content if before is None else none + b"\n" + content


def wrong_line(content: bytes) -> str:
    """Return the first line whose corner is no number or not in the file, with its number; or an empty text.

    Args:
        content: text of a file that was refused.
    """
    text = with_line_feeds(content)
    corners, before = sum(1 for _ in _CORNER_LINE.finditer(text)), 0
    for number, line in enumerate(io.BytesIO(text), 1):
        words = line.partition(b"#")[0].split()
        before += words[:1] == [b"v"]
        if words[:1] in ([b"v"], [b"f"]) and _is_wrong(words, before, corners):
            return f"; line {number} is '{b' '.join(words)[:80].decode('utf-8', 'replace')}'"
    return ""


def _is_wrong(words: list[bytes], before: int, corners: int) -> bool:
    """Return whether a line of a corner or face is wrong, behind ``before`` of ``corners`` corners."""
    try:
        if words[0] == b"v":
            return not all(math.isfinite(float(word)) for word in words[1:4])
        return any(
            index == 0 or not -before <= index <= corners
            for index in (int(word.partition(b"/")[0]) for word in words[1:])
        )
    except ValueError:
        return True


def _plain(content: bytes) -> bytes:
    """Return a text whose words have spaces between them and lines begin with a word."""
    content = with_line_feeds(content)
    if b"\t" in content:
        content = content.replace(b"\t", b" ")
    return _INDENT.sub(b"", content) if content.startswith(b" ") or b"\n " in content else content


class _Faces:
    """Replaces what the reader cannot read in the face lines of a file."""

    def __init__(self, content: bytes) -> None:
        self._content = content

    @cached_property
    def _corners(self) -> tuple[Indices, FloatArray]:
        """Return where the lines of corners begin, shape (C,), and the corners, shape (C, 3)."""
        begins, values = [], []
        for found in _CORNER.finditer(self._content):
            begins.append(found.start())
            values.append(found.groups())
        try:
            return np.array(begins, np.int64), np.array(values).astype(np.float64).reshape(-1, 3)
        except ValueError as error:
            raise ValueError(NO_NUMBER) from error

    def plain(self, found: re.Match[bytes]) -> bytes:
        """Return lines of faces with positive indices of corners alone, and without concave polygons."""
        lines = found[0]
        if b"/" in lines:
            lines = _AFTER_SLASH.sub(b"", lines)
        if b" 0 " in lines or b" 0\n" in lines + b"\n":  # corners are counted from 1
            raise ValueError(NO_CORNER)
        if b"-" not in lines and _POLYGON.search(lines) is None:
            return lines
        return b"\n".join(self._split(lines, found.start())) + b"\n"

    def _split(self, lines: bytes, begin: int) -> Iterator[bytes]:
        faces = [line.partition(b"#")[0].split()[1:] for line in lines.splitlines()]
        begins, places = self._corners
        before = int(np.searchsorted(begins, begin))
        counts = np.array([len(face) for face in faces])
        for count in np.unique(counts[counts > 2]):
            index = np.array([face for face in faces if len(face) == count]).astype(np.int64)
            index = np.where(index < 0, index + before, index - 1)
            if index.min() < 0 or index.max() >= len(places):
                raise ValueError(NO_CORNER)
            yield from _lines(index, places)


def _lines(index: Indices, places: FloatArray) -> Iterator[bytes]:
    """Yield the lines of polygons, indices (P, N) from 0; concave ones as triangles."""
    split = concave(places[index]) if index.shape[1] > 3 else np.zeros(len(index), bool)
    yield from (b"f " + b" ".join(b"%d" % corner for corner in face) for face in (index[~split] + 1).tolist())
    for face in index[split]:
        for triangle in (face[triangulated(places[face])] + 1).tolist():
            yield b"f %d %d %d" % tuple(triangle)
