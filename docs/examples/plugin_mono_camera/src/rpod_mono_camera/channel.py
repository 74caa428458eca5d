"""The emulated camera on the bus."""

from collections.abc import Callable, Sequence
from functools import partial

from scipy.spatial.transform import RigidTransform

from rpod_mono_camera.bus import MonoPublisher
from rpod_mono_camera.config import MonoConfig
from rpod_mono_camera.emulator import MonoEmulator
from rpod_mono_camera.frame import MonoFrame
from rpod_runtime import Node
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.poses import rotation_of
from rpod_schemas.schedule import DueFrame
from rpod_schemas.topics import optical_frame
from rpod_target import Target


class MonoChannel:
    """An emulated monocular camera: rpod_emulator.channels.Channel."""

    def __init__(self, node: Node, config: EmulatorConfig, sensor: MonoConfig, target: Target) -> None:
        self.sensor = sensor
        self._emulator = MonoEmulator(sensor, target, seed=config.seed)
        self._publisher = MonoPublisher(node, sensor.name, T_chaser_sensor=sensor.T_chaser_sensor)

    def emulate(
        self, poses: Sequence[RigidTransform], sun_W_m2: FloatArray, frame: DueFrame
    ) -> Callable[[], None]:
        """Expose."""
        sun = rotation_of(self.sensor.T_chaser_sensor).inv().apply(sun_W_m2)
        image = self._emulator.expose(poses[0], sun_W_m2=sun, frame=frame.number)
        made = MonoFrame(
            stamp_ns=frame.stamp_ns,
            frame_id=optical_frame(self.sensor.name),
            image=image,
            camera=self.sensor.camera,
        )
        return partial(self._publisher.publish, made)
