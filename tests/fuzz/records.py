"""Hostile records beside the logs: digest chains, and audit records of commands."""

import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from fuzz.mutation import json_of, mutate_bytes, mutate_document

from rpod_security.audit import AuditRecord, check
from rpod_security.errors import AuditError, ChainError
from rpod_security.log_chain import ChainWriter, chain_of
from rpod_security.log_verification import verify

_LOG, _AUDIT = "run.mcap", "audit.jsonl"
_PARTS = b"first", b"second", b"end"


def record_subjects() -> Iterator[tuple[str, Callable[[Random], bytes], Callable[[bytes], bool]]]:
    """Yield name, maker and reader of what reads records."""
    yield "digest chain", lambda rnd: _changed(rnd, _chain()), _read_chain
    yield "audit record", lambda rnd: _changed(rnd, _audit()), _read_audit


@cache
def _chain() -> bytes:
    with TemporaryDirectory() as folder:
        log = Path(folder) / _LOG
        chain = ChainWriter(log)
        for part in _PARTS:
            chain.add(part)
            chain.seal(closed=part == _PARTS[-1])
        chain.close()
        return chain_of(log).read_bytes()


@cache
def _audit() -> bytes:
    with TemporaryDirectory() as folder:
        record = AuditRecord(Path(folder) / _AUDIT, "logger")
        for number in range(4):
            record.add(role="operator", verb="stop", request=str(number), outcome="accepted")
        return (Path(folder) / _AUDIT).read_bytes()


def _changed(rnd: Random, text: bytes) -> bytes:
    """Return JSON lines as they are, with one hostile line, or with hostile bytes."""
    kind = rnd.randrange(4)
    if kind == 0:
        return text
    if kind == 1:
        return mutate_bytes(rnd, text)
    lines = text.splitlines()
    at = rnd.randrange(len(lines))
    line = json.loads(lines[at])
    if rnd.randrange(4) == 0:
        line["time"] = rnd.choice(("9999-12-31T23:59:59-23:59", "0001-01-01T00:00:00+23:59", "now"))
    lines[at] = json_of(rnd, mutate_document(rnd, line))
    return b"\n".join(lines) + b"\n"


def _read_chain(data: bytes) -> bool:
    with TemporaryDirectory() as folder:
        log = Path(folder) / _LOG
        log.write_bytes(b"".join(_PARTS))
        chain_of(log).write_bytes(data)
        try:
            return verify(log).intact
        except ChainError:
            return False


def _read_audit(data: bytes) -> bool:
    with TemporaryDirectory() as folder:
        file = Path(folder) / _AUDIT
        file.write_bytes(data)
        AuditRecord(file, "logger").add(role="operator", verb="stop", request="", outcome="")
        try:
            check(file)
        except AuditError:
            return False
        return True
