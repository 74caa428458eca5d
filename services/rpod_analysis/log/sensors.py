"""The sensors of a log: which there are, where they are mounted, and their frames put together."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.log.log import Log, Logged
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import (
    build,
    read_amplitude,
    read_camera,
    read_depth,
    read_pmd_info,
    read_points,
    read_stamp,
)
from rpod_schemas.topics import AMPLITUDE, CAMERA_INFO, CHASER, DEPTH, PMD_INFO, POINTS
from rpod_schemas.types import LidarScan, PmdFrame, PmdInfo

_MOST_PENDING = 8
"""Incomplete frames kept while their parts are awaited."""


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor whose data are in the log."""

    name: str
    kind: Literal["pmd", "lidar"]
    T_chaser_sensor: RigidTransform | None
    """Mount, from tf_static, else from the configuration; None where neither tells."""


def find_sensors(log: Log) -> dict[str, Sensor]:
    """Return the sensors of a log by name: by their topics and types, whatever they are called."""
    sensors: dict[str, Sensor] = {}
    for kind, topic in (("pmd", DEPTH), ("lidar", POINTS)):
        suffix = topic.name.split("/", 1)[1]
        for name, info in log.topics.items():
            sensor = name.removesuffix(f"/{suffix}")
            if info.type == topic.type and sensor != name and info.count:
                mount = _mount(log, sensor, _frame_id(log, name))
                sensors[sensor] = Sensor(sensor, kind, mount)  # type: ignore[arg-type]
    return sensors


def _frame_id(log: Log, topic: str) -> str:
    """Return the frame of a topic's first message that can be read; empty where none can."""
    for logged in log.messages(topic):
        with log.unreadable.left_out(logged):
            return str(logged.decode().header.frame_id)
    return ""


def _mount(log: Log, sensor: str, frame_id: str) -> RigidTransform | None:
    T_frame_sensor, frame = RigidTransform.identity(), frame_id
    for _ in range(len(log.extrinsics) + 1):  # more steps than transforms would be a loop
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
    """Return the sensors of a service's configuration; what has another form is left out."""
    entries = service.get("sensors")
    return (
        [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list | tuple) else []
    )


def pmd_info(log: Log, sensor: str) -> PmdInfo | None:
    """Return what a PMD camera said of itself last; None where it did not, or nothing that can be read."""
    info: PmdInfo | None = None
    for logged in log.messages(PMD_INFO.of(sensor)):
        with log.unreadable.left_out(logged):
            info = read_pmd_info(logged.decode())
    return info


def pmd_frames(
    log: Log, sensor: str, *, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[PmdFrame]:
    """Iterate over the frames of a PMD camera, put together by stamp; arrival within the slice.

    Depth and camera_info are required, the amplitude is optional. Frames that are incomplete, or that an
    estimator would refuse (no finite depth), are left out.
    """
    info = pmd_info(log, sensor)
    topics = [topic.of(sensor) for topic in (DEPTH, CAMERA_INFO, AMPLITUDE)]
    wanted = {topic.name for topic in topics if topic.name in log.topics}
    pending: dict[int, dict[str, Any]] = {}
    for logged in log.messages(*topics, start_ns=start_ns, end_ns=end_ns):
        stamp_ns = -1
        with log.unreadable.left_out(logged):
            message = logged.decode()
            stamp_ns = read_stamp(message.header)
        if stamp_ns < 0:
            continue
        parts = pending.setdefault(stamp_ns, {})
        parts[logged.topic] = message
        if parts.keys() == wanted:
            yield from _complete(sensor, pending, info, up_to_ns=stamp_ns)
        elif len(pending) > _MOST_PENDING:
            yield from _complete(sensor, pending, info, up_to_ns=min(pending))
    if pending:
        yield from _complete(sensor, pending, info, up_to_ns=max(pending))


def _complete(
    sensor: str, pending: dict[int, dict[str, Any]], info: PmdInfo | None, *, up_to_ns: int
) -> Iterator[PmdFrame]:
    depth, camera, amplitude = (topic.of(sensor).name for topic in (DEPTH, CAMERA_INFO, AMPLITUDE))
    for stamp_ns in sorted(stamp for stamp in pending if stamp <= up_to_ns):
        parts = pending.pop(stamp_ns)
        if depth not in parts or camera not in parts:
            continue
        with suppress(MessageRejectedError):
            yield build(
                PmdFrame,
                stamp_ns=stamp_ns,
                frame_id=parts[depth].header.frame_id,
                depth_m=read_depth(parts[depth]),
                amplitude=read_amplitude(parts[amplitude]) if amplitude in parts else None,
                camera=read_camera(parts[camera]),
                info=info,
            )


def lidar_scans(
    log: Log, sensor: str, *, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[LidarScan]:
    """Iterate over the scans of a LIDAR; arrival within the slice."""
    for logged in log.messages(POINTS.of(sensor), start_ns=start_ns, end_ns=end_ns):
        with log.unreadable.left_out(logged):
            yield _read_scan(logged)


def _read_scan(logged: Logged) -> LidarScan:
    message = logged.decode()
    fields = read_points(message)
    return build(
        LidarScan,
        stamp_ns=read_stamp(message.header),
        frame_id=message.header.frame_id,
        points_m=np.stack([fields[axis] for axis in "xyz"], axis=-1),
        intensity=fields.get("intensity"),
        time_s=fields.get("t"),
    )
