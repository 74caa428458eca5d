"""Reads measurements from messages, without a bus; the daemon and the replay of a log both use it.

Parts are identified by topic and by the stamp in their first bytes. Only frames that are
processed are decoded.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rpod_pose.measurement import Measurement
from rpod_pose.pmd.camera_check import CameraCheck
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled, Assembler
from rpod_runtime.errors import ExtrinsicsError
from rpod_runtime.extrinsics import Extrinsics
from rpod_runtime.frames import PartRejectedError, SensorReader, assembler_of, open_reader
from rpod_schemas.config.sensor import SensorInput
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_transforms
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.topics import TF_STATIC, Topic
from rpod_schemas.types import Camera


@dataclass(frozen=True)
class Arrived:
    """A frame for the navigator, or the reason why it cannot be used."""

    sensor: str
    stamp_ns: int
    arrival_s: float
    """Arrival of the last part, monotonic clock."""
    measurement: Measurement | None
    reason: str = ""
    refused: str = ""
    """Kind of the reason, a ``Reason``; empty if there is a measurement."""


class FrameReader:
    """Assembles frames of the configured sensors, and reads measurements from them."""

    def __init__(self, sensors: Sequence[SensorInput]) -> None:
        self.latched: tuple[Topic, ...] = (TF_STATIC,)
        """Latched topics, whose messages go to ``learn``."""
        self.streams: tuple[Topic, ...] = ()
        """Topics of the parts of frames, whose messages go to the ``assemblers``."""
        self.parts: dict[str, tuple[str, str]] = {}
        """Sensor and part, by the name of the stream topic."""
        self.assemblers: dict[str, Assembler[Received]] = {}
        """Assembler of each sensor, by sensor name."""
        self.leading: dict[str, str] = {}
        """Leading part of the frames, by sensor name; a frame is reported as refused when this part is
        refused."""
        self._readers: dict[str, SensorReader] = {}
        self._extrinsics = Extrinsics({sensor.name: sensor.T_chaser_sensor for sensor in sensors})
        self._cameras = CameraCheck()
        for sensor in sensors:
            self._expect(sensor)

    def _expect(self, sensor: SensorInput) -> None:
        kind = sensor_kind(sensor.kind)
        if kind.info is not None:
            self.latched += (kind.info.of(sensor.name),)
        self._readers[sensor.name] = open_reader(kind)
        self.assemblers[sensor.name] = assembler_of(kind)
        self.leading[sensor.name] = next(iter(kind.parts))
        for name, part in kind.parts.items():
            topic = part.topic.of(sensor.name)
            self.streams += (topic,)
            self.parts[topic.name] = sensor.name, name

    @property
    def infos(self) -> Mapping[str, Any]:
        """Info that each sensor has published of itself, by sensor name; None where there is none."""
        return {sensor: reader.said for sensor, reader in self._readers.items()}

    def learn(self, received: Received) -> None:
        """Store the content of a latched message. Raises ``MessageRejectedError``."""
        topic = received.topic
        if topic.name == TF_STATIC.name:
            for _, parent, child, pose in read_transforms(received.decode()):
                self._extrinsics.set(parent, child, pose)
        else:
            self._readers[topic.name.split("/", 1)[0]].learn(received.decode())

    def measurement(self, sensor: str, frame: Assembled[Received]) -> Measurement:
        """Return a frame decoded and checked, with its mount. Raises ``PartRejectedError``."""
        leading = frame.parts[self.leading[sensor]]
        data = self._readers[sensor].read(frame)
        if data.lens is not None:
            self._check_camera(sensor, data.lens, frame.parts.get("camera_info", leading))
        try:
            return Measurement(sensor, data, self._extrinsics.mount(sensor, data.frame_id))
        except ExtrinsicsError as error:
            rejection = MessageRejectedError(Reason.UNKNOWN_FRAME, str(error))
            raise PartRejectedError(leading, rejection) from error

    def _check_camera(self, sensor: str, camera: Camera, received: Received) -> None:
        try:
            self._cameras.check(sensor, camera)
        except MessageRejectedError as rejection:
            raise PartRejectedError(received, rejection) from rejection
