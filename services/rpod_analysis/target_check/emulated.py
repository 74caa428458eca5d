"""Emulated frames of any sensor kind, as an estimator receives them, by its registered emulator and reader.

The emulator's messages are encoded and decoded as on the bus, so that a kind needs nothing for a check beyond
what it registers. There is no bus: messages go from the emulator to the reader.
"""

from collections.abc import Sequence
from typing import Any

from scipy.spatial.transform import RigidTransform

from rpod_emulator.channels import Channel
from rpod_pose.methods import kind_methods
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.frames import SensorReader, open_reader
from rpod_runtime.local_node import local_node
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.sensor import EmulatedSensor, SensorInput
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.registry import resolve
from rpod_schemas.schedule import frame_at
from rpod_schemas.sensors import SensorKind
from rpod_schemas.types import SensorFrame
from rpod_target import Target

_EPOCH_NS = 1_000_000_000


class EmulatedKind:
    """A sensor of a kind in its default configuration, which looks at a target."""

    def __init__(self, kind: SensorKind, target: Target, *, seed: int) -> None:
        emulated: Any = kind.emulated
        heard: Any = kind.heard
        self.kind, self.target = kind, target
        self.sensor: EmulatedSensor = emulated()
        self.heard: SensorInput = heard().informed_by(self.sensor)
        self._kept: dict[str, Received] = {}
        """Newest message of each topic."""
        config = EmulatorConfig(target=target.source, sensors=(self.sensor,), seed=seed)
        node = local_node(lambda received: self._kept.update({received.topic.name: received}))
        self._channel: Channel = resolve(kind.emulator)(node, config, self.sensor, target)
        self._reader: SensorReader = open_reader(kind)
        if kind.info is not None:
            self._reader.learn(self._kept[kind.info.of(self.sensor.name).name].decode())

        self._methods = kind_methods(self.heard)
        self.setup: Any = self._methods.setup(self.heard, self._reader.newest_info)

    def ideal(self, T_sensor_target: RigidTransform) -> SensorFrame:
        """Return the frame that the kind's methods are warmed up with: without noise, and of a known lens."""
        ideal: SensorFrame = self._methods.frames(self.target, T_sensor_target, self.setup)[0]
        return ideal

    def frame(
        self, T_sensor_target: RigidTransform, *, sun_W_m2: FloatArray, number: int
    ) -> SensorFrame | None:
        """Return the frame of a motionless target; None if the sensor measures nothing.

        Args:
            T_sensor_target: pose of the target.
            sun_W_m2: unit vector to the sun times its irradiance, sensor axes, shape (3,).
            number: number of the frame, which determines its noise.
        """
        poses: Sequence[RigidTransform] = [T_sensor_target] * len(self.sensor.pose_times_s())
        sun = self.sensor.T_chaser_sensor.rotation.apply(sun_W_m2)
        due = frame_at(self.sensor, number, epoch_ns=_EPOCH_NS)
        self._kept.clear()
        self._channel.emulate(poses, sun, due)()
        topics = {name: part.topic.of(self.sensor.name).name for name, part in self.kind.parts.items()}
        received = {name: self._kept[topic] for name, topic in topics.items() if topic in self._kept}
        try:
            return self._reader.read(Assembled(due.stamp_ns, received))
        except MessageRejectedError:
            return None
