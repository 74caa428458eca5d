"""Hostile logs: bytes of the file, its records, the messages in it, and what it says of itself."""

import json
import struct
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import BytesIO, StringIO
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

from fuzz.mutation import mutate_bytes, mutate_document, mutate_message
from fuzz.seeds import logs
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from rpod.logs.report import report_command
from rpod_analysis import AnalysisError
from rpod_analysis.recovery import recover

_MAGIC = 8
_HEADER = struct.Struct("<BQ")
"""Opcode and length of an MCAP record."""
_MAKE = tuple[str, Callable[[Random], bytes], Callable[[bytes], bool]]


def log_subjects() -> Iterator[_MAKE]:
    """Yield name, maker and reader of what reads logs."""
    for name, make in (("bytes", _damaged), ("records", _records_changed), ("content", _rewritten)):
        yield f"report of a log with hostile {name}", make, _report
    yield "recovery of a log with hostile bytes", _damaged, _recover
    yield "recovery of a log with hostile records", _records_changed, _recover


def _damaged(rnd: Random) -> bytes:
    data = bytearray(rnd.choice(logs()))
    for _ in range(rnd.choice((1, 3, 30))):
        data[rnd.randrange(len(data))] = rnd.randrange(256)
    return mutate_bytes(rnd, bytes(data)) if rnd.randrange(3) == 0 else bytes(data)


def _records_changed(rnd: Random) -> bytes:
    """Return a log whose records, up to three, are hostile, missing, doubled, swapped or of another kind."""
    log = rnd.choice(logs())
    records, at = [], _MAGIC
    while at + _HEADER.size <= len(log) - _MAGIC:
        opcode, size = _HEADER.unpack_from(log, at)
        records.append([opcode, size, log[at + _HEADER.size : at + _HEADER.size + size]])
        at += _HEADER.size + size
    for _ in range(rnd.randint(1, 3)):
        index, kind = rnd.randrange(len(records)), rnd.randrange(6)
        opcode, size, body = records[index]
        if kind == 0:
            records[index] = [
                opcode,
                rnd.choice((0, min(size + 1, 2**64 - 1), 2**31, 2**63, 2**64 - 1)),
                body,
            ]
        elif kind == 1:
            del records[index]
        elif kind == 2:
            records.insert(index, records[rnd.randrange(len(records))])
        elif kind == 3:
            records[index] = [rnd.randrange(256), size, body]
        else:
            body = mutate_bytes(rnd, body)
            records[index] = [opcode, len(body), body]
        if not records:
            break
    return log[:_MAGIC] + b"".join(_HEADER.pack(o, s) + b for o, s, b in records) + log[-_MAGIC:]


def _rewritten(rnd: Random) -> bytes:
    """Return a closed log with right checksums whose messages, times, names and metadata are hostile."""
    out, reader = BytesIO(), make_reader(BytesIO(rnd.choice(logs())))
    writer = Writer(
        out, compression=rnd.choice((CompressionType.NONE, CompressionType.LZ4)), chunk_size=1 << 14
    )
    writer.start(profile="ros2", library="fuzz")
    share, channels = rnd.choice((0.0, 0.01, 0.2)), dict[str, int]()
    for record in reader.iter_metadata():
        writer.add_metadata(record.name, {key: _text(rnd, text) for key, text in record.metadata.items()})
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        hostile = rnd.random() < share
        if channel.topic not in channels:
            name = rnd.choice((channel.topic, "/", "", "/x/y")) if rnd.randrange(40) == 0 else channel.topic
            kind = rnd.choice((schema.name, "a/msg/B", "")) if rnd.randrange(40) == 0 else schema.name
            text = mutate_bytes(rnd, schema.data) if rnd.randrange(40) == 0 else schema.data
            number = writer.register_schema(kind, schema.encoding, text)
            channels[channel.topic] = writer.register_channel(name, channel.message_encoding, number)
        data = mutate_message(rnd, bytes(message.data), schema.name) if hostile else message.data
        times = [message.log_time, message.publish_time]
        if hostile and rnd.randrange(4) == 0:
            times[rnd.randrange(2)] = rnd.choice((0, 1, 2**63, 2**64 - 1))
        sequence = rnd.choice((0, 2**32 - 1)) if hostile and rnd.randrange(8) == 0 else message.sequence
        writer.add_message(channels[channel.topic], times[0], data, times[1], sequence)
    writer.finish()
    return out.getvalue()


def _text(rnd: Random, text: str) -> str:
    """Return the text of a metadata record, mostly as it is, else another one or with hostile JSON in it."""
    if rnd.randrange(6):
        return text
    if rnd.randrange(8) == 0:
        return rnd.choice(("[" * 100_000, '{"target": "\\ud800", "prefix": "estimate", "sensors": []}'))
    try:
        document: Any = json.loads(text)
    except ValueError:
        return rnd.choice(("", "x", "{", "null"))
    return json.dumps(mutate_document(rnd, [document])[:1] or [None])[1:-1]


def _report(data: bytes) -> bool:
    """Run ``rpod report`` on a log, tables, page and printed summary included; return whether it succeeds."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        path.write_bytes(data)
        out, errors = StringIO(), StringIO()
        with redirect_stdout(out), redirect_stderr(errors):
            code = report_command([path], out=None, as_json=False)
        told = errors.getvalue()
        assert (code == 0) == (not told), f"exit code {code} with {told!r}"
        assert told.count("\n") <= 1, "more than one line"
        return code == 0


def _recover(data: bytes) -> bool:
    return _read(data, lambda path: recover(path, path.with_suffix(".out.mcap")))


def _read(data: bytes, read: Callable[[Path], Any]) -> bool:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        path.write_bytes(data)
        try:
            read(path)
        except AnalysisError:
            return False
    return True
