"""From messages to measurements, without a bus: the daemon and a replay of a log share this very path.

Parts are told apart by topic and stamp from their first bytes; only a frame that is chosen is decoded.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.measurement import Measurement
from rpod_pose.pmd.camera_check import CameraWatch
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled, Assembler
from rpod_runtime.errors import ExtrinsicsError
from rpod_runtime.extrinsics import Extrinsics
from rpod_runtime.frames import (
    CAMERA_PARTS,
    LIDAR_PARTS,
    PartRejectedError,
    assembler_of,
    read_frame,
    read_scan,
)
from rpod_schemas.config.estimator import LidarInput, SensorInput
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_lidar_info, read_pmd_info, read_transforms
from rpod_schemas.topics import (
    LIDAR_INFO,
    PMD_INFO,
    TF_STATIC,
    Topic,
)
from rpod_schemas.types import LidarInfo, LidarScan, PmdFrame, PmdInfo

LEADING = frozenset({"points", "depth"})
"""The part in whose place a frame is refused that never gets complete."""


@dataclass(frozen=True)
class Arrived:
    """A frame for the navigator, or why it is none."""

    sensor: str
    stamp_ns: int
    arrival_s: float
    """Of its last part, monotonic clock."""
    measurement: Measurement | None
    reason: str = ""


class Intake:
    """What is known of the sensors, their frames in the making, and how a frame becomes a measurement."""

    def __init__(self, sensors: Sequence[SensorInput]) -> None:
        self.latched: tuple[Topic, ...] = (TF_STATIC,)
        """Topics for ``learn``."""
        self.streams: tuple[Topic, ...] = ()
        """Topics of the parts of frames, for the ``assemblers``."""
        self.parts: dict[str, tuple[str, str]] = {}
        """Sensor and part, by such a topic's name."""
        self.assemblers: dict[str, Assembler[Received]] = {}
        """By sensor."""
        self.patterns: dict[str, ScanPattern] = {}
        """Scan patterns of the LIDARs, from their latched info."""
        self.infos: dict[str, PmdInfo] = {}
        """What the cameras say of themselves; every frame carries it."""
        self._extrinsics = Extrinsics({sensor.name: sensor.T_chaser_sensor for sensor in sensors})
        self._cameras = CameraWatch()
        for sensor in sensors:
            self._expect(sensor)

    def _expect(self, sensor: SensorInput) -> None:
        topics, info = (
            (LIDAR_PARTS, LIDAR_INFO) if isinstance(sensor, LidarInput) else (CAMERA_PARTS, PMD_INFO)
        )
        self.latched += (info.of(sensor.name),)
        self.assemblers[sensor.name] = assembler_of(topics)
        self.streams += tuple(topic.of(sensor.name) for topic in topics.values())
        self.parts |= {topic.of(sensor.name).name: (sensor.name, part) for part, topic in topics.items()}

    def learn(self, received: Received) -> None:
        """Take a latched message. Raises ``MessageRejectedError``."""
        topic = received.topic
        if topic.name == TF_STATIC.name:
            for _, parent, child, pose in read_transforms(received.decode()):
                self._extrinsics.set(parent, child, pose)
        elif topic.type == PMD_INFO.type:
            self.infos[_sensor_of(topic)] = read_pmd_info(received.decode())
        else:
            self._learn_pattern(_sensor_of(topic), read_lidar_info(received.decode()))

    def _learn_pattern(self, sensor: str, info: LidarInfo) -> None:
        if info.azimuth_rad.size and info.elevation_rad.size:  # else it is a LIDAR without a pattern
            self.patterns[sensor] = ScanPattern.of(info)

    def measurement(self, sensor: str, frame: Assembled[Received]) -> Measurement:
        """Return a frame decoded and checked, with its mount. Raises ``PartRejectedError``."""
        leading = next(part for name, part in frame.parts.items() if name in LEADING)
        data: PmdFrame | LidarScan
        if "depth" in frame.parts:
            data = read_frame(frame, self.infos.get(sensor))
            self._check_camera(sensor, data, frame.parts["camera_info"])
        else:
            pattern = self.patterns.get(sensor)
            data = read_scan(frame, rows_are_elevation=pattern is None or pattern.rows_are_elevation)
        try:
            return Measurement(sensor, data, self._extrinsics.mount(sensor, data.frame_id))
        except ExtrinsicsError as error:
            rejection = MessageRejectedError(Reason.UNKNOWN_FRAME, str(error))
            raise PartRejectedError(leading, rejection) from error

    def _check_camera(self, sensor: str, data: PmdFrame, camera_info: Received) -> None:
        try:
            self._cameras.check(sensor, data.camera)
        except MessageRejectedError as rejection:
            raise PartRejectedError(camera_info, rejection) from rejection


def _sensor_of(topic: Topic) -> str:
    return topic.name.split("/", 1)[0]
