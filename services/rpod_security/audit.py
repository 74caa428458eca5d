"""The audit record of a service: who gave which command, when, and with what outcome.

Lines are appended and never changed. Each is a JSON object with the digest of the line before, so that
``check`` finds a line that was changed, removed or put in before another one. Nobody notices if the last line
is changed, or if the last lines are cut off: send the record elsewhere if that matters.
"""

import hashlib
import json
import os
from datetime import UTC, datetime
from functools import partial
from io import FileIO
from pathlib import Path
from threading import Lock

from rpod_security.errors import AuditError
from rpod_security.whole_line import append_line

_FIRST = "0" * 64
_LONGEST_TEXT = 2_000
"""Largest number of characters of a request or an outcome in the record."""
_TAIL_BYTES = 1 << 16
"""Length of the end of a file in which its last line is looked for; a line is shorter, although a character
may become 12 bytes."""


class AuditRecord:
    """An audit record in a file. Safe to use from several threads."""

    def __init__(self, file: Path, instance: str) -> None:
        self._file, self._instance = file, instance
        self._lock = Lock()
        last = _last_line(file)
        self._last = _digest(last.removesuffix(b"\n"))
        self._cut = bool(last) and not last.endswith(b"\n")
        """Whether the file ends within a line, as after a power failure. The next line is one of its own."""

    def add(self, *, role: str, verb: str, request: str, outcome: str) -> None:
        """Append one line and sync it to the disk. Raises ``AuditError``."""
        with self._lock:
            line = json.dumps(
                {
                    "time": datetime.now(UTC).isoformat(timespec="microseconds"),
                    "service": self._instance,
                    "role": role,
                    "verb": verb,
                    "request": request[:_LONGEST_TEXT],
                    "outcome": outcome[:_LONGEST_TEXT],
                    "before": self._last,
                }
            ).encode()
            try:
                with FileIO(self._file, "a", opener=partial(os.open, mode=0o600)) as stream:
                    append_line(stream, b"\n" * self._cut + line)
            except OSError as error:
                raise AuditError(f"{self._file} cannot be written ({error.strerror})") from error
            self._last, self._cut = _digest(line), False


def check(file: Path) -> int:
    """Return the number of lines of an audit record.

    Raises:
        AuditError: a line before the last one is not as it was written; the error names its number.
    """
    before = _FIRST
    number = 0
    with file.open("rb") as stream:
        for number, line in enumerate(stream, 1):
            try:
                stated = json.loads(line)["before"]
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                raise AuditError(f"{file}: line {number} is damaged") from error
            if stated != before:
                raise AuditError(f"{file}: line {number} does not follow the line before; one was changed")
            before = _digest(line.rstrip(b"\n"))
    return number


def _digest(line: bytes) -> str:
    return hashlib.sha256(line).hexdigest() if line else _FIRST


def _last_line(file: Path) -> bytes:
    try:
        with file.open("rb") as stream:
            stream.seek(max(0, file.stat().st_size - _TAIL_BYTES))
            lines = stream.read().splitlines(keepends=True)
    except FileNotFoundError:
        return b""
    except OSError as error:
        raise AuditError(f"{file} cannot be read ({error.strerror})") from error
    return lines[-1] if lines else b""
