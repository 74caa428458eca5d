"""The estimator's ears: subscriptions, frame assembly, freshness, extrinsics, decoding.

Only sensors, ``tf_static`` and the clock are subscribed; nothing here knows a topic of the truth.
Parts are told apart by topic and stamp from their first bytes; only the frame that is chosen is
decoded.
"""

import logging
from dataclasses import dataclass

import numpy as np

from rpod_estimator.assembler import Assembled, Assembler, NewestFrames
from rpod_estimator.errors import ExtrinsicsError
from rpod_estimator.extrinsics import Extrinsics
from rpod_estimator.measurement import Measurement
from rpod_estimator.methods import ScanPattern
from rpod_runtime import Inbox, Node, Received
from rpod_schemas.cdr import peek_stamp
from rpod_schemas.config.estimator import EstimatorConfig, LidarInput, SensorInput
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import (
    NANOSECONDS,
    build,
    read_amplitude,
    read_camera,
    read_depth,
    read_points,
    read_transforms,
)
from rpod_schemas.topics import AMPLITUDE, CAMERA_INFO, DEPTH, LIDAR_INFO, POINTS, TF_STATIC, Topic
from rpod_schemas.types import LidarScan, PmdFrame

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Arrived:
    """A frame for the navigator, or why it is none."""

    sensor: str
    stamp_ns: int
    arrival_s: float
    """Of its last part, monotonic clock."""
    measurement: Measurement | None
    reason: str = ""


class Inputs:
    """Everything that reaches the estimator."""

    def __init__(self, node: Node, config: EstimatorConfig) -> None:
        self._node, self._config = node, config
        self._inbox = Inbox()
        self._extrinsics = Extrinsics({sensor.name: sensor.T_chaser_sensor for sensor in config.sensors})
        self._newest: NewestFrames[Received] = NewestFrames()
        self._parts: dict[str, tuple[SensorInput, str]] = {}
        self._assemblers: dict[str, Assembler[Received]] = {}
        self.patterns: dict[str, ScanPattern] = {}
        """Scan patterns of the LIDARs, from their latched info."""
        node.subscribe(TF_STATIC, self._inbox.put)
        for sensor in config.sensors:
            self._subscribe(sensor)

    def _subscribe(self, sensor: SensorInput) -> None:
        if isinstance(sensor, LidarInput):
            topics = {"points": POINTS}
            self._assemblers[sensor.name] = Assembler(frozenset(topics))
            self._node.subscribe(LIDAR_INFO.of(sensor.name), self._inbox.put)
        else:
            topics = {"depth": DEPTH, "camera_info": CAMERA_INFO, "amplitude": AMPLITUDE}
            self._assemblers[sensor.name] = Assembler(
                frozenset({"depth", "camera_info"}), frozenset({"amplitude"})
            )
        for part, topic in topics.items():
            self._parts[topic.of(sensor.name).name] = sensor, part
            # Live, what is missed is old by the time it could be had; in lockstep everybody waits for it.
            in_lockstep = self._config.time_source == "clock"
            self._node.subscribe(topic.of(sensor.name), self._inbox.put, recover=in_lockstep)

    def newest(self, timeout_s: float) -> Arrived | None:
        """Return the newest complete frame of the sensor that waits longest; None after the timeout."""
        for received in self._inbox.wait(0.0 if self._newest else timeout_s):
            try:
                self._take(received)
            except MessageRejectedError as error:
                self._node.reject(received.topic.name, error)
        self._node.health.put("overflowed/inbox", self._inbox.overflowed)
        chosen = self._newest.take()
        return self._arrived(*chosen) if chosen else None

    def _take(self, received: Received) -> None:
        topic = received.topic
        if topic == TF_STATIC:
            for _, parent, child, pose in read_transforms(received.decode()):
                self._extrinsics.set(parent, child, pose)
        elif topic.name in self._parts:
            self._assemble(received)
        else:
            message = received.decode()
            pattern = ScanPattern(np.asarray(message.azimuth_rad), np.asarray(message.elevation_rad))
            self.patterns[_sensor_of(topic)] = pattern

    def _assemble(self, received: Received) -> None:
        sensor, part = self._parts[received.topic.name]
        assembler = self._assemblers[sensor.name]
        for frame in assembler.add(part, peek_stamp(received.payload), received):
            if self._newest.put(sensor.name, frame):
                self._node.health.count(f"dropped/{sensor.name}")
        self._node.health.put(f"incomplete/{sensor.name}", assembler.incomplete)

    def _arrived(self, sensor: str, frame: Assembled[Received]) -> Arrived:
        arrival_s = max(part.arrival_s for part in frame.parts.values())
        topic = next(iter(frame.parts.values())).topic.name
        try:
            self._check_freshness(frame.stamp_ns)
            measurement = self._measurement(sensor, frame)
        except (MessageRejectedError, ExtrinsicsError) as error:
            rejection = (
                error
                if isinstance(error, MessageRejectedError)
                else MessageRejectedError(Reason.UNKNOWN_FRAME, str(error))
            )
            self._node.reject(topic, rejection)
            return Arrived(sensor, frame.stamp_ns, arrival_s, None, str(rejection))
        return Arrived(sensor, frame.stamp_ns, arrival_s, measurement)

    def _check_freshness(self, stamp_ns: int) -> None:
        age_s = (self._node.clock.now_ns() - stamp_ns) / NANOSECONDS
        if age_s > self._config.max_age_s:
            raise MessageRejectedError(
                Reason.LATE,
                f"{age_s:.3f} s old, limit {self._config.max_age_s:g} s; check the sensor's clock",
            )
        if age_s < -self._config.max_future_s:
            raise MessageRejectedError(
                Reason.FUTURE,
                f"{-age_s:.3f} s ahead of {self._config.time_source} time; check the sensor's clock",
            )

    def _measurement(self, sensor: str, frame: Assembled[Received]) -> Measurement:
        data = read_frame(frame) if "depth" in frame.parts else read_scan(frame.parts["points"])
        return Measurement(sensor, data, self._extrinsics.mount(sensor, data.frame_id))


def read_frame(frame: Assembled[Received]) -> PmdFrame:
    """Decode and check the parts of a camera's frame. Raises ``MessageRejectedError``."""
    depth = frame.parts["depth"].decode()
    amplitude = frame.parts.get("amplitude")
    camera = read_camera(frame.parts["camera_info"].decode())
    depth_m = read_depth(depth)
    if depth_m.shape != (camera.height, camera.width):
        raise MessageRejectedError(
            Reason.WRONG_SIZE,
            f"depth image of {depth_m.shape[1]} x {depth_m.shape[0]}, "
            f"camera_info says {camera.width} x {camera.height}",
        )
    return build(
        PmdFrame,
        stamp_ns=frame.stamp_ns,
        frame_id=depth.header.frame_id,
        depth_m=depth_m,
        amplitude=read_amplitude(amplitude.decode()) if amplitude else None,
        camera=camera,
    )


def read_scan(received: Received) -> LidarScan:
    """Decode and check a point cloud. Raises ``MessageRejectedError``."""
    message = received.decode()
    fields = read_points(message)
    points_m = np.stack([fields["x"], fields["y"], fields["z"]], axis=-1)
    return build(
        LidarScan,
        stamp_ns=peek_stamp(received.payload),
        frame_id=message.header.frame_id,
        points_m=points_m.astype(np.float32, copy=False),
        intensity=fields.get("intensity"),
        time_s=fields.get("t"),
    )


def _sensor_of(topic: Topic) -> str:
    return topic.name.split("/", 1)[0]
