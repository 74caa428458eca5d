"""Lines that are appended to a file as a whole or not at all."""

import os
from contextlib import suppress
from io import FileIO


def append_line(stream: FileIO, line: bytes) -> None:
    """Append a line and sync it to the disk; where that fails, no part of it stays. Raises ``OSError``."""
    size = os.fstat(stream.fileno()).st_size
    rest = memoryview(line + b"\n")
    try:
        while rest:
            rest = rest[stream.write(rest) :]
        os.fsync(stream.fileno())
    except OSError:
        with suppress(OSError):
            stream.truncate(size)
        raise
