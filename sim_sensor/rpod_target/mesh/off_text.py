"""The text of an OFF file as that of an OBJ file, whose reader handles polygons of any shape."""

import re
from itertools import groupby

import numpy as np

_HEADER = re.compile(rb"\s*+(?:(ST)?(C)?(N)?(4)?(n)?OFF\b)?[ \t]*+(BINARY)?", re.IGNORECASE)
_COMMENT = re.compile(rb"#[^\n]*+")
MOST_COLOURS = 16
"""Largest number of colours of a mesh that count as materials: with more, they are a texture."""


def as_obj(content: bytes) -> tuple[bytes, bytes]:
    """Return the text of an OBJ file, and of its library, which has the colours of the faces.

    Raises:
        ValueError: the content is wrong; the text continues a sentence that begins with the file's name.
    """
    found = _HEADER.match(content)
    if found is None:
        raise ValueError("is no OFF file: export it again")
    if found[6]:
        raise ValueError("is binary OFF, which is not read: export it as text")
    if found[4] or found[5]:
        raise ValueError("has corners of other than three dimensions: export a mesh in space")
    lines = [line.split() for line in _COMMENT.sub(b"", content[found.end() :]).splitlines()]
    lines = [line for line in lines if line]
    try:
        corners, faces = (int(count) for count in lines[0][:2])
        places = np.array([line[:3] for line in lines[1 : 1 + corners]]).astype(np.float64)
        polygons = [_polygon(line) for line in lines[1 + corners : 1 + corners + faces]]
    except (ValueError, IndexError) as error:
        raise ValueError(f"is no OFF file ({error}): export it again") from error
    if places.shape != (corners, 3) or len(polygons) != faces:
        raise ValueError(f"ends before its {corners} corners and {faces} faces: copy or export it again")
    return _obj(lines[1 : 1 + corners], polygons)


def _polygon(words: list[bytes]) -> tuple[bytes, list[int]]:
    """Return the colour of a face as the name of a material, or an empty text, and its corners from 1."""
    count = int(words[0])
    corners = [int(word) + 1 for word in words[1 : 1 + count]]
    if len(corners) != count or min(corners, default=1) < 1:
        raise ValueError(f"a face of {count} corners has {len(corners)} indices, or a negative one")
    shares = words[1 + count : 4 + count]
    if len(shares) < 3:
        return b"", corners
    whole = all(word.isdigit() for word in shares)
    values = [float(word) / (255.0 if whole else 1.0) for word in shares]
    levels = [round(min(max(255.0 * value, 0.0), 255.0)) for value in values]
    return b"colour-%02x%02x%02x" % (levels[0], levels[1], levels[2]), corners


def _obj(places: list[list[bytes]], polygons: list[tuple[bytes, list[int]]]) -> tuple[bytes, bytes]:
    body = [b"v " + b" ".join(place[:3]) for place in places]
    colours = sorted({colour for colour, _ in polygons if colour})
    if len(colours) > MOST_COLOURS:
        colours = []
    if not colours:
        polygons = [(b"", corners) for _, corners in polygons]
    ordered = sorted(polygons, key=lambda polygon: polygon[0])  # those without a colour come first
    for colour, group in groupby(ordered, key=lambda polygon: polygon[0]):
        body += [b"usemtl " + colour] if colour else []
        body += [b"f " + b" ".join(b"%d" % corner for corner in corners) for _, corners in group]
    library = [b"newmtl " + colour + b"\nKd " + _shares(colour) for colour in colours]
    return b"\n".join([*body, b""]), b"\n".join(library)


def _shares(colour: bytes) -> bytes:
    levels = bytes.fromhex(colour[-6:].decode())
    return b" ".join(b"%.6f" % (level / 255.0) for level in levels)
