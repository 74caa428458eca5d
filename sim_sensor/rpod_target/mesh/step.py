"""STEP files, which the library cascadio (OpenCASCADE) turns into GLB; needs the extra ``step``."""

import re
import resource
import signal
import subprocess
import sys
import warnings
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

_DEFLECTION = 0.001
"""Largest distance of a triangle from a curved surface, as a share of an edge's length."""
_ANGLE_RAD = 0.2
"""Largest angle between neighbouring segments of a curved edge."""
_LONGEST_S = 600.0
"""Time after which a file is given up, s."""
_MOST_BYTES = 4 << 30
"""Largest memory of the process that reads a file, bytes: a damaged file may ask for any."""
_REASON = re.compile(rb"ERR StepFile : (.*?)\s*\*{4}")
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

    A process of its own reads it, since OpenCASCADE prints what it finds, and a damaged file may end it.

    Raises:
        ValueError: the content is wrong; the text is OpenCASCADE's reason.
    """
    with TemporaryDirectory() as folder:
        made = Path(folder) / "made.glb"
        command = (sys.executable, "-P", __file__, str(made))
        try:
            done = subprocess.run(
                command, input=content, capture_output=True, check=False, timeout=_LONGEST_S
            )
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"OpenCASCADE needs more than {_LONGEST_S:.0f} s") from error
        glb = made.read_bytes() if done.returncode == 0 else b""
    found = [text.decode("utf-8", "replace") for text in dict.fromkeys(_REASON.findall(done.stdout))]
    if glb:
        for text in found:
            warnings.warn(f"OpenCASCADE reads a part of the STEP file alone: {text}", stacklevel=2)
        return glb
    if done.returncode < 0:
        end = signal.Signals(-done.returncode).name
        found.append(f"it ends OpenCASCADE by {end}, or needs more than {_MOST_BYTES >> 30} GiB of memory")
    raise ValueError(found[0] if found else "OpenCASCADE finds no shape in it")


def _main() -> None:
    """Write the STEP file on the standard input as GLB to the path that is the first argument."""
    import cascadio  # noqa: PLC0415 - only STEP files need it

    resource.setrlimit(resource.RLIMIT_AS, (_MOST_BYTES, _MOST_BYTES))
    glb = cascadio.load(
        sys.stdin.buffer.read(),
        file_type="step",
        tol_linear=_DEFLECTION,
        tol_angular=_ANGLE_RAD,
        tol_relative=True,
    )
    Path(sys.argv[1]).write_bytes(glb)


if __name__ == "__main__":
    _main()
