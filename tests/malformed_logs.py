"""Logs with malformed messages of one topic: cut short, empty, and with stamps that cannot be."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from synthetic_log import EPOCH_NS, SyntheticRun

from rpod_schemas.logs import MESSAGE_ENCODING, SCHEMA_ENCODING
from rpod_schemas.messages import write_odometry, write_transforms, write_vector_stamped
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import definition, encode
from rpod_schemas.topics import CHASER, REFERENCE, SUN, TARGET, TF, Topic
from rpod_schemas.types import Odometry, PmdInfo

INFO = PmdInfo(
    modulation_frequency_hz=[20e6], integration_time_s=1e-3, electrons_per_count=10.0, saturation_count=4e4
)
TOPICS = (
    "tf_static", "tf", "clock", "environment/sun", "truth/odometry", "motion/reference", "pmd/info",
    "pmd/camera_info", "pmd/depth/image_raw", "pmd/amplitude/image_raw", "estimate/odometry", "estimate/pose",
    "estimate/status", "diagnostics",
)  # fmt: skip
STAMP_IN_EACH = ("tf_static", "tf")
"""Their messages begin with a count; the stamp stands behind it."""


@dataclass(frozen=True)
class Fault:
    """What is done to a copy of a topic's first message."""

    name: str
    change: Callable[[bytes, int], bytes]
    """Function of the payload and the place of its stamp."""


def _stamped(seconds: int) -> Callable[[bytes, int], bytes]:
    return lambda data, at: data[:at] + struct.pack("<iI", seconds, 0) + data[at + 8 :]


FAULTS = (
    Fault("cut", lambda data, _: data[: max(6, len(data) // 3)]),
    Fault("empty", lambda _, __: b""),
    Fault("before-all-time", _stamped(-1)),
    Fault("far-ahead", _stamped(2**31 - 1)),
)


def write_good(path: Path, run: SyntheticRun) -> Path:
    """Write a run, with the topics that a synthetic one has not."""
    return _rewritten(run.write(path.with_suffix(".plain.mcap")), path, _others())


def write_malformed(good: Path, path: Path, topic: str) -> Path:
    """Write a log in which malformed copies of a topic's first message, one of each fault, follow it."""
    return _rewritten(good, path, {}, topic)


def _others() -> dict[Topic, bytes]:
    odometry = Odometry(
        stamp_ns=EPOCH_NS,
        frame_id=CHASER,
        child_frame_id=TARGET,
        pose=make_pose(translation_m=[0.0, 0.0, 4.0]),
        linear_m_s=[0.0] * 3,
        angular_rad_s=[0.0] * 3,
    )
    messages = {
        TF: write_transforms(EPOCH_NS, [(CHASER, TARGET, odometry.pose)]),
        SUN: write_vector_stamped(EPOCH_NS, CHASER, odometry.pose.translation * 300.0),
        REFERENCE: write_odometry(odometry),
    }
    return {topic: bytes(encode(message)) for topic, message in messages.items()}


def _rewritten(source: Path, path: Path, more: dict[Topic, bytes], topic: str = "") -> Path:
    with source.open("rb") as stream, path.open("wb") as out:
        reader, writer = make_reader(stream), Writer(out, compression=CompressionType.LZ4)
        writer.start(profile="ros2", library="synthetic")
        for record in reader.iter_metadata():
            if record.name not in ("counts", "completeness", "publishers"):
                writer.add_metadata(record.name, record.metadata)
        channels: dict[str, int] = {}

        def put(name: str, kind: str, data: bytes, *, log_ns: int, publish_ns: int, sequence: int) -> None:
            if name not in channels:
                schema = writer.register_schema(kind, SCHEMA_ENCODING, definition(kind).encode())
                channels[name] = writer.register_channel(name, MESSAGE_ENCODING, schema)
            writer.add_message(channels[name], log_ns, data, publish_ns, sequence)

        pending = FAULTS if topic else ()
        for schema, channel, message in reader.iter_messages():
            times = {"publish_ns": message.publish_time, "sequence": message.sequence}
            put(channel.topic, schema.name, message.data, log_ns=message.log_time, **times)
            for other, data in more.items():
                put(
                    f"/{other.name}",
                    other.type,
                    data,
                    log_ns=message.log_time,
                    publish_ns=EPOCH_NS,
                    sequence=1,
                )
            more = {}
            if pending and channel.topic == f"/{topic}":
                at = 8 if topic in STAMP_IN_EACH else 4
                for number, fault in enumerate(pending, start=1):
                    damaged = fault.change(bytes(message.data), at)
                    times["sequence"] += 10**6
                    put(channel.topic, schema.name, damaged, log_ns=message.log_time + number, **times)
                pending = ()
        assert not pending, f"no message of {topic}"
        writer.finish()
    return path
