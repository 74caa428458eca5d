"""The emulated PMD camera on the bus."""

from collections.abc import Callable, Sequence
from functools import partial

from scipy.spatial.transform import RigidTransform

from rpod_runtime import Node
from rpod_runtime.sensor_data.reduced_rate import ReducedRateCamera
from rpod_runtime.sensors import CameraPublisher
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.poses import rotation_of
from rpod_schemas.schedule import DueFrame
from rpod_schemas.topics import optical_frame
from rpod_schemas.types import PmdFrame
from rpod_sim_sensor.pmd import PmdEmulator, PmdExposure
from rpod_sim_sensor.worlds import world_of
from rpod_target import Target


class PmdChannel:
    """An emulated PMD camera."""

    def __init__(self, node: Node, config: EmulatorConfig, sensor: PmdConfig, target: Target) -> None:
        self.sensor = sensor
        self._with_samples = config.publish_samples
        self._emulator = PmdEmulator(
            sensor,
            target,
            seed=config.seed,
            world=world_of(config.world),
            surroundings=config.surroundings,
        )
        self._spare: list[PmdExposure] = []
        self._announced_s = sensor.integration_time_s
        self._publisher = CameraPublisher(
            node, sensor.name, T_chaser_sensor=sensor.published_mount, info=sensor.info()
        )
        reduced = sensor.reduced_rate
        self._reduced = None if reduced is None else ReducedRateCamera(node, sensor.name, reduced)

    def show(self, target: Target) -> None:
        """Show another target from the next frame on."""
        self._emulator.show(target)

    def emulate(
        self, poses: Sequence[RigidTransform], sun_W_m2: FloatArray, frame: DueFrame
    ) -> Callable[[], None]:
        """Compute an image."""
        sun = rotation_of(self.sensor.T_chaser_sensor).inv().apply(sun_W_m2)
        buffers = self._spare.pop() if self._spare else None
        exposure = self._emulator.expose(poses, sun_W_m2=sun, frame=frame.number, out=buffers)
        return partial(self._publish, exposure, frame.stamp_ns)

    def _publish(self, exposure: PmdExposure, stamp_ns: int) -> None:
        """Publish the info if the exposure time has changed, then the frame; its arrays are used again."""
        if exposure.integration_time_s != self._announced_s:
            self._announced_s = exposure.integration_time_s
            self._publisher.announce(self.sensor.info(exposure.integration_time_s))
        frame = PmdFrame(
            stamp_ns=stamp_ns,
            frame_id=optical_frame(self.sensor.name),
            depth_m=exposure.depth_m,
            amplitude=exposure.amplitude,
            camera=self.sensor.camera,
        )
        self._publisher.publish(frame, samples=exposure.samples if self._with_samples else None)
        if self._reduced is not None:
            self._reduced.publish(frame)
        self._spare.append(exposure)
