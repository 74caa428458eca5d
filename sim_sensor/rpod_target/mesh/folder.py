"""Mesh files and the files beside them, read no further than is allowed.

The size is compared with the limit before a file is read, so that a file that is too large takes no memory.
"""

import contextlib
import errno
import math
import os
from pathlib import Path

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh.files import companions, read_mesh_file
from rpod_target.mesh.topology import areas_m2
from rpod_target.mesh.unusable import LARGEST_FILE_MB

_MB = 1_000_000
_BLOCK = _MB
"""Bytes that are read at a time of a file that is longer than it says."""


def read_files(
    file: Path, *, largest_mb: float = LARGEST_FILE_MB, raised_by: str = ""
) -> tuple[bytes, dict[str, bytes]]:
    """Return the bytes of a mesh file, and of those of its companions that can be read, by name.

    Args:
        file: the mesh file.
        largest_mb: largest size of all these files together, MB.
        raised_by: option or field, with its separator, by which the user can raise the limit; empty if
            there is none.

    Raises:
        OSError: the mesh file cannot be read, or is no regular file.
        ValueError: the files are too large; the text continues a sentence that begins with the file's name.
    """
    left = round(_MB * largest_mb)
    content = _read(file, left, largest_mb, raised_by)
    left -= len(content)
    beside: dict[str, bytes] = {}
    for name in companions(file.name, content):
        with contextlib.suppress(OSError):  # the reader names what it needs
            beside[name] = _read(file.parent / name, left, largest_mb, raised_by, of=file)
            left -= len(beside[name])
    return content, beside


def surface_m(path: Path, metres_per_unit: float) -> FloatArray:
    """Return the triangles of a file that have an area, shape (T, 3, 3), m.

    Raises:
        OSError: the file cannot be read.
        ValueError: its content is wrong, or too large.
    """
    triangles_m = metres_per_unit * read_mesh_file(path.name, *read_files(path)).triangles
    return triangles_m[areas_m2(triangles_m) > 0.0]


def _read(file: Path, left: int, largest_mb: float, raised_by: str, of: Path | None = None) -> bytes:
    """Return the bytes of a file if they are no more than is left.

    A file may grow while it is read, or have no size, as those of ``/proc``: so reading ends at the limit.
    """
    if file.exists() and not file.is_file():  # a device or a pipe, which may have no end
        raise OSError(errno.EINVAL, "is no regular file", str(file))
    with file.open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        content = stream.read(size) if size <= left else b""
        while size <= left and (more := stream.read(_BLOCK)):
            content += more
            size = len(content)
    if size <= left:
        return content
    before = round(_MB * largest_mb) - left
    total_mb = math.ceil((before + size) / _MB)
    has = f"has {total_mb} MB" if of is None else f"has {total_mb} MB with {file.name}"
    remedy = f", or raise the limit ({raised_by}{total_mb})" if raised_by else ""
    raise ValueError(f"{has}, at most {largest_mb:g} MB are read: simplify it{remedy}")
