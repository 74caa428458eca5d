"""Built targets on disk: one file a digest, written whole or not at all, so daemons may build at once."""

import os
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from rpod_schemas.arrays import Array


def default_directory() -> Path:
    """Return $RPOD_CACHE, else $XDG_CACHE_HOME/rpod, else ~/.cache/rpod."""
    if own := os.environ.get("RPOD_CACHE"):
        return Path(own)
    if shared := os.environ.get("XDG_CACHE_HOME"):
        return Path(shared) / "rpod"
    return Path.home() / ".cache" / "rpod"


def read(file: Path) -> dict[str, Array] | None:
    """Return the arrays of a file; None where it is missing or damaged (its checksums tell)."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            return dict(stored.items())
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


def write(file: Path, arrays: Mapping[str, Array]) -> None:
    """Write arrays as one file, which appears under its name only when complete. Raises ``OSError``."""
    file.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.stem}-", suffix=".tmp")
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)
        temporary.replace(file)
    finally:
        temporary.unlink(missing_ok=True)
