"""Cache of built targets: one file per digest, written atomically, so that several daemons may build.

A file also holds the digest of its arrays. A file whose arrays differ from it was changed after it was built,
and is not used.
"""

import hashlib
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from rpod_schemas.arrays import Array
from rpod_schemas.caches.whole_file import whole_file

DIGEST = "content_digest"
"""Name in a file of the digest of its arrays."""


def with_digest(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Return arrays together with their digest, which is named ``DIGEST``."""
    return {**arrays, DIGEST: np.array(_digest(arrays))}


def _digest(arrays: Mapping[str, Array]) -> str:
    """Return the SHA-256 of arrays: of their names, types, shapes and bytes."""
    content = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        content.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        content.update(array.data.cast("B") if array.size else b"")
    return content.hexdigest()


def read(file: Path) -> dict[str, Array] | None:
    """Return the sealed arrays of a file; None if it is missing, damaged, or changed after it was built.

    A ``UserWarning`` names a file that was changed.
    """
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            arrays = dict(stored.items())
        built = arrays.pop(DIGEST)
    except (OSError, ValueError, KeyError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error):
        return None
    if str(built) != _digest(arrays):
        text = f"{file} was changed after it was built; the target is built again"
        warnings.warn(text, stacklevel=2)  # a package without a log
        return None
    return {**arrays, DIGEST: built}


def write(file: Path, arrays: Mapping[str, Array]) -> None:
    """Write sealed arrays as one file, which gets its name only when it is complete. Raises ``OSError``."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file) as stream:
        np.savez(stream, allow_pickle=False, **arrays)
