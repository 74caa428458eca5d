"""The estimator's ears: subscriptions, freshness, frame assembly, extrinsics.

Only sensors, ``tf_static`` and the clock are subscribed; nothing here knows a topic of the truth.
Parts are told apart by topic and stamp from their first bytes; only the frame that is chosen is
decoded.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from rpod_estimator.assembler import Assembled, Assembler, NewestFrames
from rpod_estimator.camera_watch import CameraWatch
from rpod_estimator.errors import ExtrinsicsError
from rpod_estimator.extrinsics import Extrinsics
from rpod_estimator.frames import PartRejectedError, read_frame, read_scan
from rpod_estimator.measurement import Measurement
from rpod_estimator.methods import ScanPattern
from rpod_runtime import BusClock, Inbox, Node, Received
from rpod_schemas.cdr import peek_stamp
from rpod_schemas.config.estimator import EstimatorConfig, LidarInput, SensorInput
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import NANOSECONDS, read_lidar_info, read_pmd_info, read_transforms
from rpod_schemas.topics import (
    AMPLITUDE,
    CAMERA_INFO,
    DEPTH,
    LIDAR_INFO,
    PMD_INFO,
    POINTS,
    TF_STATIC,
    Topic,
)
from rpod_schemas.types import Camera, LidarInfo, LidarScan, PmdFrame, PmdInfo

_LIDAR_PARTS = {"points": POINTS}
_CAMERA_PARTS = {"depth": DEPTH, "camera_info": CAMERA_INFO, "amplitude": AMPLITUDE}
_OPTIONAL = frozenset({"amplitude"})
_LEADING = frozenset({"points", "depth"})
"""The part in whose place a frame is refused that never gets complete."""
_WAITING_PARTS = 512
"""Parts between the bus and the assembler: some 200 MB of images."""
_CLOCK_LAG_S = 0.2
"""How long a clock message may be behind a frame that was published after it."""


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
        self._in_lockstep = config.time_source == "clock"
        self._latched, self._waiting = Inbox(), Inbox(_WAITING_PARTS)
        self._extrinsics = Extrinsics({sensor.name: sensor.T_chaser_sensor for sensor in config.sensors})
        self._parts: dict[str, tuple[str, str]] = {}
        self._assemblers: dict[str, Assembler[Received]] = {}
        self._newest: NewestFrames[Received] = NewestFrames()
        self._refused: deque[Arrived] = deque()
        self.patterns: dict[str, ScanPattern] = {}
        """Scan patterns of the LIDARs, from their latched info."""
        self.infos: dict[str, PmdInfo] = {}
        """What the cameras say of themselves; every frame carries it."""
        self._cameras = CameraWatch()
        node.subscribe(TF_STATIC, self._latched.put)
        for sensor in config.sensors:
            self._subscribe(sensor)

    def _subscribe(self, sensor: SensorInput) -> None:
        topics, info = _CAMERA_PARTS, PMD_INFO
        if isinstance(sensor, LidarInput):
            topics, info = _LIDAR_PARTS, LIDAR_INFO
        self._node.subscribe(info.of(sensor.name), self._latched.put)
        names = frozenset(topics)
        self._assemblers[sensor.name] = Assembler(names - _OPTIONAL, names & _OPTIONAL)
        for part, topic in topics.items():
            self._parts[topic.of(sensor.name).name] = sensor.name, part
            # Live, what is missed is old by the time it could be had; in lockstep everybody waits for it.
            self._node.subscribe(topic.of(sensor.name), self._waiting.put, recover=self._in_lockstep)

    def newest(self, timeout_s: float) -> Arrived | None:
        """Return the newest complete frame of the sensor that waits longest; None after the timeout.

        Frames that are refused on arrival, for their stamps, come before it, each with its reason.
        """
        self._take_in(0.0 if self._newest or self._refused else timeout_s)
        return self._next()

    def rest(self) -> Iterator[Arrived]:
        """Yield what waits at this moment: what was refused, the newest complete frame of each sensor."""
        self._take_in(0.0)
        while (arrived := self._next()) is not None:
            yield arrived

    def _take_in(self, timeout_s: float) -> None:
        parts = self._waiting.wait(timeout_s)
        for received in self._latched.wait(0.0) + parts:
            try:
                self._take(received)
            except MessageRejectedError as error:
                self._node.reject(received.topic.name, error)
        if timeout_s and not parts and not self._in_lockstep:
            for sensor, assembler in self._assemblers.items():
                self._put(sensor, assembler.release())
        self._node.health.put("overflowed/inbox", self._waiting.overflowed)

    def _next(self) -> Arrived | None:
        if self._refused:
            return self._refused.popleft()
        chosen = self._newest.take()
        return self._arrived(*chosen) if chosen else None

    def _take(self, received: Received) -> None:
        topic = received.topic
        if topic == TF_STATIC:
            for _, parent, child, pose in read_transforms(received.decode()):
                self._extrinsics.set(parent, child, pose)
        elif topic.name in self._parts:
            self._take_part(received)
        elif topic.type == PMD_INFO.type:
            self.infos[_sensor_of(topic)] = read_pmd_info(received.decode())
        else:
            self._take_info(_sensor_of(topic), read_lidar_info(received.decode()))

    def _take_info(self, sensor: str, info: LidarInfo) -> None:
        if info.azimuth_rad.size and info.elevation_rad.size:  # else it is a LIDAR without a pattern
            self.patterns[sensor] = ScanPattern.of(info)

    def _take_part(self, received: Received) -> None:
        sensor, part = self._parts[received.topic.name]
        assembler = self._assemblers[sensor]
        stamp_ns = peek_stamp(received.payload)
        try:
            self._check_freshness(received, stamp_ns)
            if stamp_ns == assembler.done_ns and part in assembler.required:
                raise MessageRejectedError(Reason.DUPLICATE, "a frame of this stamp is complete already")
        except MessageRejectedError as error:
            if part in _LEADING:
                self._refused.append(Arrived(sensor, stamp_ns, received.arrival_s, None, str(error)))
            raise
        self._put(sensor, assembler.add(part, stamp_ns, received))
        self._node.health.put(f"incomplete/{sensor}", assembler.incomplete)

    def _put(self, sensor: str, frames: list[Assembled[Received]]) -> None:
        for frame in frames:
            if self._newest.put(sensor, frame):
                self._node.health.count(f"dropped/{sensor}")

    def _check_freshness(self, received: Received, stamp_ns: int) -> None:
        """Judge a stamp by its arrival: what then waits for the methods is not late by its sensor's fault."""
        now_ns, clock = received.arrival_ns, self._node.clock
        if isinstance(clock, BusClock):
            clock.await_ns(stamp_ns - round(self._config.max_future_s * NANOSECONDS), _CLOCK_LAG_S)
            now_ns = clock.now_ns()
        age_s = (now_ns - stamp_ns) / NANOSECONDS
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

    def _arrived(self, sensor: str, frame: Assembled[Received]) -> Arrived:
        arrival_s = max(part.arrival_s for part in frame.parts.values())
        try:
            measurement = self._measurement(sensor, frame)
        except PartRejectedError as error:
            self._node.reject(error.topic, error)
            return Arrived(sensor, frame.stamp_ns, arrival_s, None, str(error))
        return Arrived(sensor, frame.stamp_ns, arrival_s, measurement)

    def _measurement(self, sensor: str, frame: Assembled[Received]) -> Measurement:
        leading = next(part for name, part in frame.parts.items() if name in _LEADING)
        data: PmdFrame | LidarScan
        if "depth" in frame.parts:
            data = read_frame(frame, self.infos.get(sensor))
            self._check_camera(sensor, data.camera, frame.parts["camera_info"])
        else:
            pattern = self.patterns.get(sensor)
            data = read_scan(frame, rows_are_elevation=pattern is None or pattern.rows_are_elevation)
        try:
            return Measurement(sensor, data, self._extrinsics.mount(sensor, data.frame_id))
        except ExtrinsicsError as error:
            rejection = MessageRejectedError(Reason.UNKNOWN_FRAME, str(error))
            raise PartRejectedError(leading, rejection) from error

    def _check_camera(self, sensor: str, camera: Camera, camera_info: Received) -> None:
        try:
            self._cameras.check(sensor, camera)
        except MessageRejectedError as rejection:
            raise PartRejectedError(camera_info, rejection) from rejection


def _sensor_of(topic: Topic) -> str:
    return topic.name.split("/", 1)[0]
