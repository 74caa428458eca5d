"""Reasons why a CAD file cannot be used, from its bytes, where its reader gives none.

The reader accepts a file that was cut off, has another format than its name says or is compressed as an empty
mesh, or as one whose corners are all at the origin. So the bytes are examined first.
"""

import json
import re
import struct
from typing import Any

from rpod_target.mesh.announced import too_many

NO_AREA = "contains no triangle with an area greater than zero: export its surfaces again"
MOST_TRIANGLES = 10_000_000
"""Largest number of triangles of a file, each copy of an object counted: their corners take 0.7 GB."""
LARGEST_FILE_MB = 500.0
"""Default of the largest size of a file with the files that it refers to, MB: that of a binary STL file with
the most triangles."""
_STL_HEADER = 84
_STL_TRIANGLE = 50
_SIGNATURES = {b"ply\n": "PLY", b"ply\r": "PLY", b"glTF": "GLB", b"ISO-10303-21": "STEP"}
_SIGNATURES |= dict.fromkeys((b"OFF\n", b"OFF\r", b"COFF\n", b"COFF\r"), "OFF")
_COMMAS = "has commas as decimal marks: export it again with points (a setting of language or region)"
_FIRST = 1 << 16
"""Length of the beginning in which a text's numbers are examined, bytes."""
_PAGE = "is a web page, not the file that it offers: download the file itself"
_NOT_FETCHED = {
    b"version https://git-lfs": "is a pointer of Git LFS, not the file itself: get it with git lfs pull",
    b"<!doctype html": _PAGE,
    b"<html": _PAGE,
}
"""What stands in place of a file that was not fetched, by its first bytes in small letters."""
_COMMA = re.compile(rb"^[ \t]*(?:vertex[ \t])?[-+\d.e \t]*\d,\d", re.MULTILINE | re.IGNORECASE)
_TEXTS = (".stl", ".ply", ".off")
"""Formats whose numbers may be text; the reader of OBJ names the line."""
_NAMES = {
    ".stl": "STL",
    ".obj": "OBJ",
    ".ply": "PLY",
    ".gltf": "GLTF",
    ".glb": "GLB",
    ".off": "OFF",
} | dict.fromkeys((".step", ".stp"), "STEP")
_COMPRESSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_INSTANCES = "EXT_mesh_gpu_instancing"
"""Extension that places a mesh several times; a reader without it shows the mesh once."""
_PLY_FACES = re.compile(rb"(?s)ply\s.{0,65536}?^element[ \t]+face[ \t]+(\d{1,18})\s", re.MULTILINE)
_MOST_ABSENT = 1 << 25
"""Largest number of values that a glTF file may announce without having them: they count as zeros."""


def unusable(suffix: str, content: bytes, *, largest_mb: float = LARGEST_FILE_MB) -> str:
    """Return why the bytes of a CAD file cannot be used and what to do, or an empty text.

    Args:
        suffix: that of the file's name, with the dot, in small letters.
        content: bytes of the file.
        largest_mb: largest size of the arrays that a glTF document announces, MB.
    """
    if not content:
        return "is empty (0 bytes): copy or export it again"
    start = content[:_STL_HEADER].lstrip().lower()
    reasons = [reason for found, reason in _NOT_FETCHED.items() if start.startswith(found)]
    if suffix in _TEXTS and b"\0" not in content[:_FIRST] and _COMMA.search(content, 0, _FIRST):
        reasons.append(_COMMAS)
    if reasons:
        return reasons[0]
    own, is_ = _NAMES[suffix], _format(content)
    if is_ not in {"", own}:
        return f"is named {suffix}, but its content is {is_}: give it the suffix .{is_.lower()}"
    if own == "STL":
        return _cut_stl(content)
    if own in {"GLTF", "GLB"}:
        return _wrong_gltf(content, largest_mb)
    return ""


def without_faces(geometries: list[Any]) -> str:
    """Return why the geometries of a file without a triangle cannot be used, and what to do."""
    points = sum(len(getattr(each, "vertices", ())) for each in geometries)
    if points:
        return (
            f"has {points} points and no face, so it is a point cloud or a drawing of lines: export its "
            "surfaces as a mesh, or make a mesh of it (as MeshLab and CloudCompare do)"
        )
    return "contains no triangle: export its surfaces as a mesh"


def lost_faces(content: bytes, triangles: int) -> str:
    """Return why a PLY file is refused whose reader leaves out faces, or an empty text.

    Args:
        content: bytes of the file.
        triangles: number of triangles that were read: at least one for each face.
    """
    found = _PLY_FACES.match(content)
    announced = int(found[1]) if found else 0
    if triangles >= announced:
        return ""
    return f"announces {announced} faces, of which {triangles} triangles could be read: export it again"


def _format(content: bytes) -> str:
    """Return the format that the first bytes or the length prove, or an empty text."""
    for signature, name in _SIGNATURES.items():
        if content.startswith(signature):
            return name
    announced = _announced(content)
    return "STL" if announced and len(content) == _STL_HEADER + _STL_TRIANGLE * announced else ""


def _announced(content: bytes) -> int:
    """Return how many triangles a binary STL announces."""
    return int(struct.unpack_from("<I", content, 80)[0]) if len(content) >= _STL_HEADER else 0


def _cut_stl(content: bytes) -> str:
    starts = content[:_STL_HEADER].lstrip().lower().startswith(b"solid")
    facets = b"facet" in content or b"FACET" in content
    if starts and facets:
        return ""  # text; a binary file's header may begin with "solid" too
    if b"\0" not in content:
        whole = starts or facets
        return "" if whole else "is no STL, neither binary nor text: export it again"
    announced = _announced(content)
    has = max(len(content) - _STL_HEADER, 0) // _STL_TRIANGLE
    if has < announced:
        return f"ends after {has} of {announced} triangles: copy or export it again"
    if not announced and has:
        return f"announces 0 triangles, but {has} follow: export it again"
    return ""


def _wrong_gltf(content: bytes, largest_mb: float) -> str:
    text, binary = content, content.startswith(b"glTF")
    if binary and len(content) >= 20:
        length = struct.unpack_from("<I", content, 12)[0]
        text = content[20 : 20 + length]
    try:
        document = json.loads(text)
        needed, used = (document.get(f"extensions{which}", []) for which in ("Required", "Used"))
    except (ValueError, AttributeError, RecursionError):
        return "" if binary else "is no glTF, whose text is one JSON object: export it again"
    if (absent := _absent_values(document)) > _MOST_ABSENT:
        return f"announces {absent} values that are not in it: export it again"
    if reason := too_many(document, most_bytes=round(1e6 * largest_mb), most_triangles=MOST_TRIANGLES):
        return reason
    if isinstance(used, list) and _INSTANCES in used:
        return f"has instances of meshes ({_INSTANCES}), which are not read: export it without this extension"
    found = [name for name in _COMPRESSIONS if isinstance(needed, list) and name in needed]
    return f"is compressed ({found[0]}), which is not read: export it without compression" if found else ""


def _absent_values(document: dict[str, Any]) -> int:
    """Return the number of values that a glTF document announces and its buffers do not have."""
    accessors = document.get("accessors", [])
    entries = [one for one in accessors if isinstance(one, dict)] if isinstance(accessors, list) else []
    counts = [one.get("count") for one in entries if "bufferView" not in one]
    return sum(count for count in counts if isinstance(count, int))
