"""Limits on the memory and time that a log may demand of the machine that reads it.

A file of a few megabytes may announce gigabytes. The limits were chosen, not derived from logs.
``--no-limits`` of the commands lifts them for a file that is trusted.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from mcap.summary import Summary

from rpod_analysis.errors import LogLimitError


@dataclass(frozen=True)
class LogLimits:
    """Greatest values that are accepted in a file of a log."""

    chunk_bytes: float = 1 << 28
    """Size of a chunk's decompressed content."""
    content_bytes: float = 1 << 32
    """Size of a file's decompressed content that is always accepted."""
    ratio: float = 100.0
    """Size of a file's decompressed content over the file's size, above ``content_bytes``."""
    channels: float = 10_000
    """Number of channels, and number of schemas."""
    messages: float = 20_000_000
    """Number of messages of a file that is always accepted: those of eight hours of a facility."""
    bytes_per_message: float = 8.0
    """Least size of a file for each of its messages, above ``messages``. Messages of a clock, the smallest
    of the facility, take 10 bytes when they are compressed."""

    def most_messages(self, file_bytes: int) -> float:
        """Return the greatest number of messages that are read of a file of a size."""
        return max(self.messages, file_bytes / self.bytes_per_message)


UNLIMITED = LogLimits(math.inf, math.inf, math.inf, math.inf, math.inf)
_DEFAULT = LogLimits()
_LIMITS = ContextVar("log_limits", default=_DEFAULT)


def limits() -> LogLimits:
    """Return the limits in force."""
    return _LIMITS.get()


@contextmanager
def lifted() -> Iterator[None]:
    """Lift the limits for logs that are opened within the ``with`` statement."""
    token = _LIMITS.set(UNLIMITED)
    try:
        yield
    finally:
        _LIMITS.reset(token)


def check(path: Path, file_bytes: int, summary: Summary) -> None:
    """Compare what a file's summary announces with the limits. Raises ``LogLimitError``."""
    limit = limits()
    sizes = [index.uncompressed_size for index in summary.chunk_indexes]
    most_bytes = max(limit.content_bytes, limit.ratio * file_bytes)
    for what, found, most in (
        ("bytes in a chunk", max(sizes, default=0), limit.chunk_bytes),
        (f"bytes in chunks, of a file of {file_bytes:,} bytes", sum(sizes), most_bytes),
        ("channels", len(summary.channels), limit.channels),
        ("schemas", len(summary.schemas), limit.channels),
    ):
        if found > most:
            raise LogLimitError(path, what, found, int(most))
