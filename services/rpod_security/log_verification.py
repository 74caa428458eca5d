"""Compares a log with its digest chain: every byte, every line, every signature."""

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC
from pathlib import Path
from typing import IO, Any, Self

from pydantic import AwareDatetime, ValidationError

from rpod_schemas.config.base import Config
from rpod_security.errors import ChainError
from rpod_security.log_chain import FIRST, SIGNATURE, canonical, chain_of, last_digest

_PIECE_BYTES = 1 << 20
_LONGEST_NAME = 240
"""Largest number of bytes of a log's name: file systems take 255, with the chain's suffix."""
_LONGEST_CHAIN = 256 << 20
"""Largest chain that is read, bytes: that of a log of a week."""


class _Head(Config):
    """First line of a chain."""

    log: str
    version: int
    continues: str | None
    continued: str
    certificate: str | None
    time: AwareDatetime
    before: str
    signature: str | None = None


class _Seal(Config):
    """One of the further lines."""

    size: int
    sha256: str
    closed: bool
    time: AwareDatetime
    before: str
    signature: str | None = None


@dataclass
class Verification:
    """Result of the comparison."""

    log: Path
    problems: list[str] = field(default_factory=list)
    """Differences from the log as it was written; none if it is intact."""
    notes: list[str] = field(default_factory=list)
    """Limits of the comparison: contents that it does not cover."""
    verified_bytes: int = 0
    """Bytes of the log, from its beginning, that are as they were written."""
    closed: bool = False
    """Whether the chain says that the log was closed."""
    signed_by: str = ""
    """Common name of the certificate; empty for a chain without signatures."""

    @property
    def intact(self) -> bool:
        """Whether everything that the chain covers is as it was written."""
        return not self.problems


def verify(log: Path, *, authority: Path | None = None) -> Verification:
    """Compare a log with its chain.

    Args:
        log: the log; its chain stands beside it.
        authority: the authority's certificate; without it nobody knows whose key signed.

    Raises:
        ChainError: the log has no chain, or it cannot be read.
        OSError: the log cannot be read.
    """
    check = _Check.begin(log, authority)
    try:
        return check.run()
    except (ValueError, OverflowError) as error:  # a name that is none, or a time that no calendar has
        raise ChainError(chain_of(log), f"is damaged ({error})") from error


class _Check:
    """One comparison."""

    def __init__(self, log: Path, authority: Path | None, lines: list[bytes]) -> None:
        self._log, self._authority = log, authority
        self._lines = lines
        self._result = Verification(log)
        self._before = FIRST
        self._signatory: Any = None

    @classmethod
    def begin(cls, log: Path, authority: Path | None) -> Self:
        chain = chain_of(log)
        try:
            if chain.stat().st_size > _LONGEST_CHAIN:
                raise ChainError(chain, f"is longer than {_LONGEST_CHAIN >> 20} MiB")
            text = chain.read_bytes()
        except OSError as error:
            raise ChainError(
                chain, f"{error.strerror}; the logger writes it with digest_chain, and on a secure bus"
            ) from error
        return cls(log, authority, text.splitlines())

    def run(self) -> Verification:
        if not self._lines:
            raise ChainError(chain_of(self._log), "is empty")
        self._meet(self._head())
        self._read(0)
        with self._log.open("rb") as stream:
            last = self._compare(stream)
            rest = stream.seek(0, 2) - (last.size if last else 0)
        self._conclude(last, rest)
        return self._result

    def _head(self) -> _Head:
        try:
            return _Head.model_validate_json(self._lines[0])
        except ValidationError as error:
            raise ChainError(chain_of(self._log), "line 1 is damaged") from error

    def _read(self, number: int) -> dict[str, Any]:
        """Return a line, and check that it follows the one before and is signed."""
        text, say = self._lines[number], self._result.problems.append
        try:
            line = json.loads(text)
            (_Seal if number else _Head).model_validate(line)
        except (ValueError, ValidationError, RecursionError) as error:
            raise ChainError(chain_of(self._log), f"line {number + 1} is damaged") from error
        if line["before"] != self._before:
            say(f"line {number + 1} of the chain does not follow the line before")
        if self._signatory is not None:
            bare = {name: value for name, value in line.items() if name != SIGNATURE}
            if not self._signatory.signed(canonical(bare), line.get(SIGNATURE) or ""):
                say(f"line {number + 1} of the chain is not signed by {self._signatory.identity.name}")
        self._before = hashlib.sha256(text).hexdigest()
        found: dict[str, Any] = line
        return found

    def _meet(self, head: _Head) -> None:
        """Check the first line: its version, the signer, and the log before this one."""
        result = self._result
        if head.version != 1:
            raise ChainError(chain_of(self._log), f"is of version {head.version}; this software reads 1")
        if head.log != self._log.name:
            result.notes.append(f"it was recorded as {head.log}")
        if head.continues is not None:
            self._follow(head.continues, head.continued)
        if head.certificate is None:
            result.notes.append("the chain has no signatures: it shows damage, but not forgery")
            if self._authority is not None:
                result.problems.append("an authority was given, but nobody signed the chain")
            return
        from rpod_security.log_signature import Signatory  # noqa: PLC0415 - of an extra

        self._signatory = Signatory(chain_of(self._log), head.certificate)
        result.signed_by = self._signatory.identity.common_name
        if self._authority is None:
            result.notes.append("whose certificate that is was not checked: give the authority's")
        elif reason := self._signatory.rejection(self._authority, when=head.time.astimezone(UTC)):
            result.problems.append(reason)

    def _follow(self, continues: str, continued: str) -> None:
        """Check the log that this one continues, by its name and the last digest of its chain."""
        if len(os.fsencode(continues)) > _LONGEST_NAME:
            raise ValueError(f"continues has more than {_LONGEST_NAME} bytes")
        before = self._log.with_name(continues)
        if not chain_of(before).exists():
            self._result.notes.append(f"{continues}, which it continues, is not beside it")
        elif last_digest(before) != continued:
            self._result.problems.append(f"the chain of {continues}, which it continues, was changed")

    def _compare(self, stream: IO[bytes]) -> _Seal | None:
        """Compare the log's bytes with the chain; return the last line about them."""
        last: _Seal | None = None
        for number in range(1, len(self._lines)):
            seal = _Seal.model_validate(self._read(number))
            begin = last.size if last else 0
            if last is not None and last.closed:
                self._result.problems.append(f"line {number + 1} of the chain comes after its end")
            digest, found = _digest(stream, seal.size - begin)
            if found < seal.size - begin:
                self._result.problems.append(
                    f"the log ends at byte {begin + found}, {seal.size} were written"
                )
                return seal
            if digest != seal.sha256:
                when = seal.time.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
                self._result.problems.append(
                    f"bytes {begin} to {seal.size} are not those that were written before {when}"
                )
            elif self._result.verified_bytes == begin:
                self._result.verified_bytes = seal.size
            last = seal
        return last

    def _conclude(self, last: _Seal | None, rest: int) -> None:
        result = self._result
        result.closed = last is not None and last.closed
        if rest > 0 and result.closed:
            result.problems.append(f"{rest} bytes were added after the log was closed")
        elif rest > 0:
            result.notes.append(f"the last {rest} bytes came after the last sync, and are not covered")
        if not result.closed:
            result.notes.append("the chain has no end: the logger was killed, or the end was cut off")


def _digest(stream: IO[bytes], size: int) -> tuple[str, int]:
    """Return the digest of the next bytes, and how many there were."""
    digest = hashlib.sha256()
    found = sum(_taken(stream, size, digest))
    return digest.hexdigest(), found


def _taken(stream: IO[bytes], size: int, digest: Any) -> Iterator[int]:
    while size > 0 and (piece := stream.read(min(size, _PIECE_BYTES))):
        digest.update(piece)
        size -= len(piece)
        yield len(piece)
