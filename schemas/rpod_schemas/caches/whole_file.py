"""A file that is either there as a whole or not at all, also for those who read it at the same time."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(file: Path, *, mode: int = 0o666, durable: bool = False) -> Iterator[BinaryIO]:
    """Open a stream whose content replaces a file in one step at the end; after an error nothing changes.

    Args:
        file: the file. Until the end its content is beside it, under a name that ends with ``.tmp``.
        mode: its permissions, less those of the umask.
        durable: whether it has to survive a loss of power that comes after the end.

    Raises:
        OSError: it cannot be written.
    """
    beside = file.with_name(f"{file.stem}.{secrets.token_hex(8)}.tmp")
    try:
        with open(beside, "xb", opener=partial(os.open, mode=mode)) as stream:
            yield stream
            if durable:
                stream.flush()
                os.fsync(stream.fileno())
        beside.replace(file)
    finally:
        beside.unlink(missing_ok=True)
