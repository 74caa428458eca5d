"""The sensors of a log: their names and kinds, their mounts, and their assembled frames."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.log.log import Log, Logged
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.frames import SensorReader, open_reader
from rpod_schemas.cdr import peek_stamp
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_pmd_info
from rpod_schemas.sensors import SensorKind, sensor_kind, sensor_kinds
from rpod_schemas.topics import CHASER, PMD_INFO, Topic
from rpod_schemas.types import LidarScan, PmdFrame, PmdInfo, SensorFrame
from rpod_schemas.wire import GID_BYTES, Attachment

_MOST_PENDING = 8
"""Largest number of incomplete frames that wait for their parts."""


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor whose data are in the log."""

    name: str
    kind: str
    """Name of the kind in the registry: ``pmd``, ``lidar``, or a kind of another package."""
    T_chaser_sensor: RigidTransform | None
    """Mount, from tf_static, else from the configuration; None if neither contains it."""

    @property
    def leading(self) -> Topic:
        """Topic that has one message for each frame."""
        return sensor_kind(self.kind).leading.of(self.name)


def find_sensors(log: Log) -> dict[str, Sensor]:
    """Return the sensors of a log by name; they are recognised by the topics and types of their messages.

    If two kinds have the same topics, the configuration in the log decides.
    """
    sensors: dict[str, Sensor] = {}
    configured = _configured_kinds(log.configuration)
    for kind in sensor_kinds():
        _, suffix = kind.leading.name.split("/", 1)
        for topic, info in log.topics.items():
            sensor, _, rest = topic.partition("/")
            if rest != suffix or info.type != kind.leading.type or not info.count:
                continue
            if sensor not in sensors or configured.get(sensor) == kind.name:
                mount = _mount(log, sensor, _frame_id(log, topic))
                sensors[sensor] = Sensor(sensor, kind.name, mount)
    return sensors


def _configured_kinds(configuration: dict[str, dict[str, Any]]) -> dict[str, str]:
    return {
        str(entry["name"]): str(entry["kind"])
        for service in configuration.values()
        for entry in service.get("sensors") or ()
        if {"name", "kind"} <= entry.keys()
    }


def _frame_id(log: Log, topic: str) -> str:
    """Return the frame of reference of a topic's first readable message; empty if there is none."""
    for logged in log.messages(topic):
        with log.unreadable.left_out(logged):
            return str(logged.decode().header.frame_id)
    return ""


def _mount(log: Log, sensor: str, frame_id: str) -> RigidTransform | None:
    T_frame_sensor, frame = RigidTransform.identity(), frame_id
    for _ in range(len(log.extrinsics) + 1):  # more steps than transforms mean a loop
        if frame == CHASER:
            return T_frame_sensor
        if frame not in log.extrinsics:
            break
        frame, T_parent_frame = log.extrinsics[frame]
        T_frame_sensor = T_parent_frame * T_frame_sensor
    return _configured_mount(log.configuration, sensor)


def _configured_mount(configuration: dict[str, dict[str, Any]], sensor: str) -> RigidTransform | None:
    for service in configuration.values():
        for entry in configured_sensors(service):
            mount = entry.get("T_chaser_sensor")
            if entry.get("name") == sensor and mount is not None:
                return RigidTransform.from_components(
                    mount["translation_m"], Rotation.from_quat(mount["quaternion_xyzw"])
                )
    return None


def configured_sensors(service: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the sensors of a service's configuration; entries of another form are left out."""
    entries = service.get("sensors")
    return (
        [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list | tuple) else []
    )


def pmd_info(log: Log, sensor: str) -> PmdInfo | None:
    """Return the last info that a PMD camera published; None if there is none that can be read."""
    info: PmdInfo | None = None
    for logged in log.messages(PMD_INFO.of(sensor)):
        with log.unreadable.left_out(logged):
            info = read_pmd_info(logged.decode())
    return info


def as_received(logged: Logged) -> Received:
    """Return a logged message in the form in which a service receives it."""
    attachment = Attachment(logged.sequence, logged.publish_ns, bytes(GID_BYTES))
    topic = Topic(logged.topic, logged.type)
    return Received(topic, logged.topic, memoryview(logged.payload), attachment, logged.log_ns, 0.0)


def sensor_frames(
    log: Log, sensor: str, kind: str, *, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[SensorFrame]:
    """Iterate over the frames of a sensor of any kind, assembled by stamp, that arrived within the slice.

    Frames that lack a required part, or that an estimator would refuse, are left out.
    """
    described = sensor_kind(kind)
    reader = _informed_reader(log, sensor, described)
    parts = {part.topic.of(sensor).name: name for name, part in described.parts.items()}
    wanted = {name for topic, name in parts.items() if topic in log.topics}
    pending: dict[int, dict[str, Logged]] = {}
    topics = [part.topic.of(sensor) for part in described.parts.values()]
    for logged in log.messages(*topics, start_ns=start_ns, end_ns=end_ns):
        stamp_ns = -1
        with log.unreadable.left_out(logged):
            stamp_ns = peek_stamp(logged.payload)
        if stamp_ns < 0:
            continue
        found = pending.setdefault(stamp_ns, {})
        found[parts[logged.topic]] = logged
        if found.keys() == wanted:
            yield from _complete(log, pending, described, reader, up_to_ns=stamp_ns)
        elif len(pending) > _MOST_PENDING:
            yield from _complete(log, pending, described, reader, up_to_ns=min(pending))
    if pending:
        yield from _complete(log, pending, described, reader, up_to_ns=max(pending))


def _informed_reader(log: Log, sensor: str, kind: SensorKind) -> SensorReader:
    reader = open_reader(kind)
    for logged in () if kind.info is None else log.messages(kind.info.of(sensor)):
        with suppress(MessageRejectedError):
            reader.learn(logged.decode())
    return reader


def _complete(
    log: Log,
    pending: dict[int, dict[str, Logged]],
    kind: SensorKind,
    reader: SensorReader,
    *,
    up_to_ns: int,
) -> Iterator[SensorFrame]:
    for stamp_ns in sorted(stamp for stamp in pending if stamp <= up_to_ns):
        parts = pending.pop(stamp_ns)
        if kind.required <= parts.keys():
            received = {name: as_received(part) for name, part in parts.items()}
            try:
                yield reader.read(Assembled(stamp_ns, received))
            except MessageRejectedError:
                for part in parts.values():
                    with log.unreadable.left_out(part):
                        part.decode()


def pmd_frames(
    log: Log, sensor: str, *, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[PmdFrame]:
    """Iterate over the frames of a PMD camera, see ``sensor_frames``; the amplitude is optional."""
    frames = sensor_frames(log, sensor, "pmd", start_ns=start_ns, end_ns=end_ns)
    return cast("Iterator[PmdFrame]", frames)


def lidar_scans(
    log: Log, sensor: str, *, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[LidarScan]:
    """Iterate over the scans of a LIDAR, see ``sensor_frames``."""
    frames = sensor_frames(log, sensor, "lidar", start_ns=start_ns, end_ns=end_ns)
    return cast("Iterator[LidarScan]", frames)
