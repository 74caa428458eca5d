"""An emulated sensor without a bus: its frames, as an estimator receives them.

The messages are encoded and decoded as on the bus, so that a kind needs nothing beyond what it registers.
"""

from collections.abc import Sequence
from typing import Any

from scipy.spatial.transform import RigidTransform

from rpod_emulator.channels import Channel
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.frames import SensorReader, open_reader
from rpod_runtime.local_node import local_node
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig, SensorConfig
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.registry import resolve
from rpod_schemas.schedule import DueFrame
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.types import SensorFrame
from rpod_target import Target


class LocalSensor:
    """A sensor that looks at a target, by its kind's registered emulator and reader."""

    def __init__(self, config: EmulatorConfig, sensor: SensorConfig, target: Target) -> None:
        kind = sensor_kind(sensor.kind)
        self._topics = {name: part.topic.of(sensor.name).name for name, part in kind.parts.items()}
        self._info = None if kind.info is None else kind.info.of(sensor.name).name
        self._kept: dict[str, Received] = {}
        """Newest message of each topic."""
        node = local_node(lambda received: self._kept.update({received.topic.name: received}))
        self._channel: Channel = resolve(kind.emulator)(node, config, sensor, target)
        self._reader: SensorReader = open_reader(kind)
        self._learn_info()

    @property
    def info(self) -> Any:
        """What the sensor states of itself, as its kind's methods are set up with it."""
        return self._reader.newest_info

    def frame(
        self, poses: Sequence[RigidTransform], sun_W_m2: FloatArray, due: DueFrame
    ) -> SensorFrame | None:
        """Return a frame; None if the sensor measures nothing.

        Args:
            poses: T_sensor_target at the sensor's pose times.
            sun_W_m2: unit vector to the sun times its irradiance, chaser axes, shape (3,).
            due: number and stamp of the frame; seed and number determine its noise.
        """
        self._kept.clear()
        self._channel.emulate(poses, sun_W_m2, due)()
        self._learn_info()
        received = {name: self._kept[topic] for name, topic in self._topics.items() if topic in self._kept}
        try:
            return self._reader.read(Assembled(due.stamp_ns, received))
        except MessageRejectedError:
            return None

    def _learn_info(self) -> None:
        """Pass on the info that was published at the start or with the last frame, if there is one."""
        info = None if self._info is None else self._kept.get(self._info)
        if info is not None:
            self._reader.learn(info.decode())
