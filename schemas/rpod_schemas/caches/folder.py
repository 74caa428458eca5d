"""The folder of what is kept on a host from one start to the next: built targets, numbers of starts."""

import os
from pathlib import Path


def cache_folder() -> Path:
    """Return $RPOD_CACHE, $XDG_CACHE_HOME/rpod or ~/.cache/rpod."""
    if own := os.environ.get("RPOD_CACHE"):
        return Path(own)
    if shared := os.environ.get("XDG_CACHE_HOME"):
        return Path(shared) / "rpod"
    return Path.home() / ".cache" / "rpod"
