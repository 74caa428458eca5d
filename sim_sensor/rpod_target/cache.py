"""Cache of built targets: one file per digest, written atomically, so that several daemons may build."""

import os
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from rpod_schemas.arrays import Array


def default_directory() -> Path:
    """Return the cache's folder: $RPOD_CACHE, $XDG_CACHE_HOME/rpod or ~/.cache/rpod."""
    if own := os.environ.get("RPOD_CACHE"):
        return Path(own)
    if shared := os.environ.get("XDG_CACHE_HOME"):
        return Path(shared) / "rpod"
    return Path.home() / ".cache" / "rpod"


def read(file: Path) -> dict[str, Array] | None:
    """Return the arrays of a file; None if it is missing, or damaged by its checksums."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            return dict(stored.items())
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


def write(file: Path, arrays: Mapping[str, Array]) -> None:
    """Write arrays as one file, which gets its name only when it is complete. Raises ``OSError``."""
    file.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.stem}-", suffix=".tmp")
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)
        temporary.replace(file)
    finally:
        temporary.unlink(missing_ok=True)
