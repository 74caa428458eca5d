"""Readers that know nothing of this project, and its own: each yields topic, arrival and message."""

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from plain_message import Plain, plain
from rosbags.highlevel import AnyReader

from rpod_analysis import open_log

HERE = Path(__file__).parent
TIMEOUT_S = 120.0


class Read(NamedTuple):
    """One message as a reader gives it."""

    topic: str
    """With its leading slash."""
    log_ns: int
    message: Plain


def read_ours(path: Path) -> Iterator[Read]:
    """Read with this project's ``open_log``."""
    with open_log(path) as log:
        for logged in log.messages():
            yield Read(f"/{logged.topic}", logged.log_ns, plain(logged.decode()))


def read_rosbags(path: Path) -> Iterator[Read]:
    """Read with rosbags' ``AnyReader``, by the definitions that stand in the log."""
    with AnyReader([path]) as bag:
        for connection, log_ns, data in bag.messages():
            yield Read(connection.topic, log_ns, plain(bag.deserialize(data, connection.msgtype)))


def read_mcap_ros2(path: Path) -> Iterator[Read]:
    """Read with mcap's reader and mcap_ros2's decoder."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            yield Read(channel.topic, message.log_time, plain(decoded))


def read_node(path: Path) -> Iterator[Read]:
    """Read with ``@mcap/core`` and ``@foxglove/rosmsg2-serialization``."""
    done = subprocess.run(
        ["node", HERE / "read_log.mjs", path], capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    for line in done.stdout.splitlines():
        item = json.loads(line)
        yield Read(item["topic"], int(item["log_ns"]), item["message"])


def read_rerun(path: Path) -> Iterator[Read]:
    """Read with Rerun's importer, each message as its definition has it."""
    from rerun.chunk import McapReader  # noqa: PLC0415 - it may not be there

    for chunk in McapReader(path, decoders=["ros2_reflection"]).stream():
        rows = chunk.to_record_batch()
        (name,) = [name for name in rows.schema.names if name.endswith(":message")] or [None]
        if name:
            times = rows["message_log_time"].cast("int64").to_pylist()
            for log_ns, messages in zip(times, rows[name], strict=True):
                yield Read(chunk.entity_path, log_ns, plain(_of_arrow(messages[0])))


def _of_arrow(value: Any) -> Any:
    """Return an Arrow scalar as Python has it, bytes as an array."""
    if hasattr(value, "items"):
        return {name: _of_arrow(item) for name, item in value.items()}
    if str(value.type).startswith("list<item: uint8"):
        return value.values.to_numpy()
    return value.as_py()


READERS: dict[str, Callable[[Path], Iterator[Read]]] = {
    "rosbags": read_rosbags,
    "mcap_ros2": read_mcap_ros2,
    "node": read_node,
    "rerun": read_rerun,
}
