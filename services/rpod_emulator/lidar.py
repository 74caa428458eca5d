"""The emulated LIDAR on the bus."""

from collections.abc import Callable, Sequence
from functools import partial

from scipy.spatial.transform import RigidTransform

from rpod_runtime import Node
from rpod_runtime.sensors import LidarPublisher
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.schedule import DueFrame
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.worlds import world_of
from rpod_target import Target


class LidarChannel:
    """An emulated scanning LIDAR."""

    def __init__(self, node: Node, config: EmulatorConfig, sensor: LidarConfig, target: Target) -> None:
        self.sensor = sensor
        self._emulator = LidarEmulator(
            sensor,
            target,
            seed=config.seed,
            world=world_of(config.world),
            surroundings=config.surroundings,
        )
        self._publisher = LidarPublisher(
            node, sensor.name, T_chaser_sensor=sensor.published_mount, info=sensor.info()
        )

    def show(self, target: Target) -> None:
        """Show another target from the next frame on."""
        self._emulator.show(target)

    def emulate(
        self,
        poses: Sequence[RigidTransform],
        sun_W_m2: FloatArray,  # noqa: ARG002 - the detector's background is in its own configuration
        frame: DueFrame,
    ) -> Callable[[], None]:
        """Compute a scan."""
        returns = self._emulator.scan(poses, frame=frame.number)
        scan = LidarScan(
            stamp_ns=frame.stamp_ns,
            frame_id=self.sensor.name,
            points_m=returns.points_m,
            intensity=returns.intensity,
            time_s=returns.time_s,
        )
        return partial(self._publisher.publish, scan)
