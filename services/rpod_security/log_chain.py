"""The digest chain of a log: written beside it, so that later changes of the log are found.

``<log>.mcap.chain`` has one JSON object a line. The first line names the log, the chain of the log before it,
and the certificate by whose key the lines are signed, if there is one. Each further line is written when the
log was synced to the disk: the log's size, and the digest (SHA-256) of the bytes since the line before. Every
line holds the digest of the line before, and its own signature. The last line says that the log is closed.

Without a key the lines are not signed: the chain then shows damage, but whoever changes the log can make its
chain anew. With a key that takes the key, or the host of the logger.
"""

import hashlib
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from rpod_security.whole_line import append_line

SUFFIX = ".chain"
"""Added to the name of a log."""
FIRST = "0" * 64
"""Digest before the first line of the first chain."""
SIGNATURE = "signature"


class Key(Protocol):
    """A key with its certificate (``rpod_security.log_signature``)."""

    certificate_pem: str

    def sign(self, text: bytes) -> str:
        """Return a signature, base64."""
        ...


class ChainWriter:
    """Writes the chain of one log. Its methods raise ``OSError``."""

    def __init__(self, log: Path, *, key: Key | None = None, continues: Path | None = None) -> None:
        file = chain_of(log)
        self._key = key
        self._digest = hashlib.sha256()
        self._size = self._sealed = 0
        self._last = FIRST
        self._stream = file.open("xb", buffering=0)
        try:
            self._append(
                {
                    "log": log.name,
                    "version": 1,
                    "continues": continues.name if continues else None,
                    "continued": last_digest(continues) if continues else FIRST,
                    "certificate": key.certificate_pem if key else None,
                }
            )
        except OSError:
            self.close()
            file.unlink(missing_ok=True)
            raise

    def add(self, data: bytes) -> None:
        """Take bytes that were appended to the log."""
        self._digest.update(data)
        self._size += len(data)

    def seal(self, *, closed: bool = False) -> None:
        """Append a line about the bytes since the last one, if there are any."""
        if self._size == self._sealed and not closed:
            return
        self._append({"size": self._size, "sha256": self._digest.hexdigest(), "closed": closed})
        self._digest, self._sealed = hashlib.sha256(), self._size

    def close(self) -> None:
        """Close the file; the log may go on without a chain."""
        self._stream.close()

    def _append(self, line: dict[str, Any]) -> None:
        line |= {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "before": self._last}
        text = canonical(line)
        if self._key is not None:
            text = canonical(line | {SIGNATURE: self._key.sign(text)})
        append_line(self._stream, text)
        self._last = hashlib.sha256(text).hexdigest()


def chain_of(log: Path) -> Path:
    """Return the file of a log's chain."""
    return log.with_name(log.name + SUFFIX)


def canonical(line: dict[str, Any]) -> bytes:
    """Return the bytes of a line, of which digest and signature are taken."""
    return json.dumps(line, sort_keys=True, separators=(",", ":")).encode()


def last_digest(log: Path) -> str:
    """Return the digest of the last line of a log's chain; that before the first one if it has no chain."""
    try:
        lines = chain_of(log).read_bytes().splitlines()
    except OSError:
        return FIRST
    return hashlib.sha256(lines[-1]).hexdigest() if lines else FIRST
