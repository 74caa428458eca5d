"""STEP files, which the library cascadio (OpenCASCADE) turns into GLB; needs the extra ``step``."""

import re
from importlib.util import find_spec

_DEFLECTION = 0.001
"""Largest distance of a triangle from a curved surface, as a share of an edge's length."""
_ANGLE_RAD = 0.2
"""Largest angle between neighbouring segments of a curved edge."""
_METRES = re.compile(rb"SI_UNIT\s*\(\s*(?:\$|\.([A-Z]+)\.)\s*,\s*\.METRE\.\s*\)")
_CONVERTED = re.compile(rb"CONVERSION_BASED_UNIT\s*\(\s*'\s*([A-Za-z]+)")
_UNITS = {
    b"": "m",
    b"KILO": "km",
    b"DECI": "dm",
    b"CENTI": "cm",
    b"MILLI": "mm",
    b"INCH": "in",
    b"FOOT": "ft",
}


def require_reader() -> None:
    """Check that STEP files can be read. Raises ``ValueError`` with the remedy."""
    if find_spec("cascadio") is None:
        raise ValueError("is STEP, which needs the extra: pip install 'rpod[step]'")


def units(content: bytes) -> tuple[str, ...]:
    """Return the units of length that a STEP file names, as ``rpod target new`` names them."""
    found = [match[1] or b"" for match in _METRES.finditer(content)]
    found += [match[1].upper() for match in _CONVERTED.finditer(content)]
    return tuple(dict.fromkeys(_UNITS[one] for one in found if one in _UNITS))


def as_glb(content: bytes) -> bytes:
    """Return a STEP file as GLB, in metres: one mesh a part, with a primitive for each of its colours.

    Raises:
        Exception: the content is wrong, in any way.
    """
    import cascadio  # noqa: PLC0415 - only STEP files need it

    glb: bytes = cascadio.load(
        content, file_type="step", tol_linear=_DEFLECTION, tol_angular=_ANGLE_RAD, tol_relative=True
    )
    if not glb:
        raise ValueError("OpenCASCADE finds no shape in it")
    return glb
