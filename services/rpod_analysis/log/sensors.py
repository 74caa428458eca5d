"""The sensors of a log: their names and kinds, their mounts, and their assembled frames."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, cast

from pydantic import ConfigDict, TypeAdapter
from scipy.spatial.transform import RigidTransform

from rpod_analysis.log.log import Log
from rpod_analysis.log.logged import Logged
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled, Assembler
from rpod_runtime.frames import ICD, SensorReader, assembler_of, open_reader
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_lidar_info, read_pmd_info
from rpod_schemas.poses import Pose
from rpod_schemas.rmw.cdr import NANOSECONDS, peek_stamp
from rpod_schemas.rmw.wire import GID_BYTES, Attachment
from rpod_schemas.sensors import SensorKind, sensor_kind, sensor_kinds
from rpod_schemas.topics import CHASER, LIDAR_INFO, PMD_INFO, Topic
from rpod_schemas.types import LidarInfo, LidarScan, PmdFrame, PmdInfo, SensorFrame


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor whose data are in the log."""

    name: str
    kind: str
    """Name of the kind in the registry: ``pmd``, ``lidar``, or a kind of another package."""
    T_chaser_sensor: RigidTransform | None
    """Mount of the axes with z along the boresight, from tf_static, else from the configuration; None if
    neither contains it."""
    source: SourceConfig = ICD

    @property
    def leading(self) -> Topic:
        """Topic that has one message for each frame."""
        return next(iter(sensor_kind(self.kind).part_topics(self.name, self.source).values()))


def find_sensors(log: Log) -> dict[str, Sensor]:
    """Return the sensors of a log by name; they are recognised by the topics and types of their messages.

    If two kinds have the same topics, the configuration in the log decides. It also names the topics of
    drivers that do not keep to the ICD.
    """
    configured = _configured_kinds(log.configuration)
    sensors = {
        name: _sensor(log, name, kind)
        for name, kind in configured.items()
        if _configured_source(log.configuration, name).topics
    }
    sensors = {name: sensor for name, sensor in sensors.items() if _count(log, sensor.leading)}
    for kind in sensor_kinds():
        _, suffix = kind.leading.name.split("/", 1)
        for topic, info in log.topics.items():
            name, _, rest = topic.partition("/")
            if rest != suffix or info.type != kind.leading.type or not info.count:
                continue
            if name not in sensors or configured.get(name) == kind.name:
                sensors[name] = _sensor(log, name, kind.name)
    return sensors


def _sensor(log: Log, name: str, kind: str) -> Sensor:
    sensor = Sensor(name, kind, None, _configured_source(log.configuration, name))
    mount = _mount(log, name, _frame_id(log, sensor.leading.name))
    return sensor if mount is None else replace(sensor, T_chaser_sensor=sensor.source.boresight_mount(mount))


def _configured_kinds(configuration: dict[str, dict[str, Any]]) -> dict[str, str]:
    known = [kind.name for kind in sensor_kinds()]
    return {
        entry["name"]: entry["kind"]
        for service in configuration.values()
        for entry in configured_sensors(service)
        if isinstance(entry.get("name"), str) and entry.get("kind") in known
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


def _configured_source(configuration: dict[str, dict[str, Any]], sensor: str) -> SourceConfig:
    """Return how a sensor's driver published, by the first configuration that says so."""
    for service in configuration.values():
        for entry in configured_sensors(service):
            if entry.get("name") == sensor and entry.get("source"):
                with suppress(ValueError):
                    return SourceConfig.model_validate(entry["source"])
    return ICD


_POSE: TypeAdapter[RigidTransform] = TypeAdapter(Pose, config=ConfigDict(arbitrary_types_allowed=True))


def _configured_mount(configuration: dict[str, dict[str, Any]], sensor: str) -> RigidTransform | None:
    for service in configuration.values():
        for entry in configured_sensors(service):
            mount = entry.get("T_chaser_sensor")
            if entry.get("name") == sensor and mount is not None:
                with suppress(ValueError):
                    return _POSE.validate_python(mount)
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


def lidar_info(log: Log, sensor: str) -> LidarInfo | None:
    """Return the last info with a scan pattern that a LIDAR published; None if there is none."""
    info: LidarInfo | None = None
    for logged in log.messages(LIDAR_INFO.of(sensor)):
        with log.unreadable.left_out(logged):
            said = read_lidar_info(logged.decode())
            info = said if said.azimuth_rad.size and said.elevation_rad.size else info
    return info


def as_received(logged: Logged) -> Received:
    """Return a logged message in the form in which a service receives it."""
    gid = bytes.fromhex(logged.gid) or bytes(GID_BYTES)
    attachment = Attachment(logged.sequence, logged.publish_ns, gid)
    topic = Topic(logged.topic, logged.type)
    payload, arrival_s = memoryview(logged.payload), logged.log_ns / NANOSECONDS
    return Received(
        topic, logged.topic, payload, attachment, logged.log_ns, arrival_s, session=logged.session
    )


def sensor_frames(
    log: Log, sensor: str, kind: str, *, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[SensorFrame]:
    """Iterate over the frames of a sensor of any kind, assembled by stamp, that arrived within the slice.

    Frames that lack a required part, or that an estimator would refuse, are left out.
    """
    described, source = sensor_kind(kind), _configured_source(log.configuration, sensor)
    reader = _informed_reader(log, sensor, described, source)
    assembler: Assembler[Logged] = assembler_of(described, source)
    parts = {topic: name for name, topic in described.part_topics(sensor, source).items()}
    names = {topic.name: name for topic, name in parts.items()}
    lasting = [topic for topic, name in parts.items() if name in described.lasting]
    rare = [topic for topic in lasting if 4 * _count(log, topic) < _count(log, next(iter(parts)))]
    before = log.messages(*rare, end_ns=start_ns) if rare and start_ns is not None else ()
    for logged in chain(before, log.messages(*parts, start_ns=start_ns, end_ns=end_ns)):
        stamp_ns = None
        with log.unreadable.left_out(logged):
            stamp_ns = peek_stamp(logged.payload) + source.correction_ns
        if stamp_ns is not None:
            for frame in assembler.add(names[logged.topic], stamp_ns, logged):
                yield from _read(log, reader, frame)
    for frame in assembler.release():
        yield from _read(log, reader, frame)


def _count(log: Log, topic: Topic) -> int:
    return log.topics[topic.name].count if topic.name in log.topics else 0


def _informed_reader(log: Log, sensor: str, kind: SensorKind, source: SourceConfig) -> SensorReader:
    reader = open_reader(kind, source)
    for logged in () if kind.info is None else log.messages(kind.info.of(sensor)):
        with suppress(MessageRejectedError):
            reader.learn(logged.decode())
    return reader


def _read(log: Log, reader: SensorReader, frame: Assembled[Logged]) -> Iterator[SensorFrame]:
    """Yield the frame, or note which of its messages cannot be read."""
    received = {name: as_received(part) for name, part in frame.parts.items()}
    try:
        yield reader.read(Assembled(frame.stamp_ns, received))
    except MessageRejectedError:
        for part in frame.parts.values():
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
