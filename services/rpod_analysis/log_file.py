"""One file of a log, or all files of a folder: what can be opened, and what is wrong where it cannot."""

import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.records import Schema, Statistics
from mcap.summary import Summary

from rpod_analysis.errors import DamagedLogError, NoLogError, NotMcapError, TruncatedLogError
from rpod_schemas.cdr import learn
from rpod_schemas.logs import SCHEMA_ENCODING

SUFFIX, RECOVERED, REPLAY = ".mcap", ".recovered", ".replay"
"""Of logs; of what is made of ``run.mcap`` beside it: ``run.recovered.mcap`` and ``run.replay.mcap``."""

_MAGIC = b"\x89MCAP0\r\n"
_DAMAGE = (McapError, RuntimeError, ValueError, KeyError, struct.error, EOFError)
"""What the MCAP reader and the decompression raise on damaged bytes."""


def beside(log: Path, kind: str) -> Path:
    """Return the file beside a log that holds what was made of it: ``run.replay.mcap`` of ``run.mcap``."""
    return log.with_name(f"{log.stem}{kind}{log.suffix}")


def files_of(path: Path) -> list[Path]:
    """Return a file, or a folder's logs: the recovered one in place of a damaged one, replays left out.

    Raises:
        NoLogError: the folder holds no log.
    """
    if not path.is_dir():
        return [path]
    files = sorted(path.glob(f"*{SUFFIX}"))
    files = [
        file for file in files if not file.stem.endswith(REPLAY) and beside(file, RECOVERED) not in files
    ]
    if not files:
        raise NoLogError(path, f"no {SUFFIX} file in this folder")
    return files


@dataclass(frozen=True)
class LogFile:
    """A file that is open."""

    path: Path
    reader: McapReader
    summary: Summary
    statistics: Statistics
    """How many messages, and from when to when."""

    def metadata(self, record: str) -> dict[str, str]:
        """Return a metadata record, empty where there is none; what was written later counts."""
        values: dict[str, str] = {}
        with reading(self.path):
            for item in self.reader.iter_metadata():
                values |= item.metadata if item.name == record else {}
        return values

    def type_of(self, schema_id: int) -> str:
        """Return the ROS 2 type of a channel's schema; empty where it has none."""
        schema = self.summary.schemas.get(schema_id)
        return ros_type(schema) if schema else ""


def ros_type(schema: Schema) -> str:
    """Return a schema's type as ``std_msgs/msg/Header``, which some write as ``std_msgs/Header``."""
    if schema.encoding == SCHEMA_ENCODING and schema.name.count("/") == 1:
        return schema.name.replace("/", "/msg/")
    return schema.name


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what damaged bytes provoke into ``DamagedLogError``."""
    try:
        yield
    except _DAMAGE as error:
        raise DamagedLogError(path, " ".join(str(error).split()) or type(error).__name__) from error


def open_file(path: Path, stack: ExitStack) -> LogFile:
    """Open a file for as long as the stack lives, and learn its message types. Raises ``AnalysisError``."""
    try:
        stream = stack.enter_context(path.open("rb"))
        _check_ends(path, stream)
    except OSError as error:
        raise NoLogError(path, (error.strerror or str(error)).lower()) from error
    with reading(path):
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise TruncatedLogError(path)
    for schema in summary.schemas.values():
        if schema.encoding == SCHEMA_ENCODING:
            learn(ros_type(schema), schema.data)
    return LogFile(path, reader, summary, summary.statistics)


def _check_ends(path: Path, stream: IO[bytes]) -> None:
    """An MCAP file begins and, once it was closed, ends with the same eight bytes."""
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise NotMcapError(path)
    size = stream.seek(0, 2)
    stream.seek(max(size - len(_MAGIC), len(_MAGIC)))
    if stream.read() != _MAGIC:
        raise TruncatedLogError(path)
    stream.seek(0)
