"""One emulated sensor from pose to messages: a channel for each kind, alike to the daemon."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_emulator.faults import Kind, lost_cells, takes_amplitude
from rpod_geometry.errors import GeometryError
from rpod_runtime import Node
from rpod_runtime.sensors import CameraPublisher, LidarPublisher
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig, SensorConfig
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import rotation_of
from rpod_schemas.schedule import DueFrame
from rpod_schemas.topics import optical_frame
from rpod_schemas.types import LidarScan, PmdFrame
from rpod_sim_sensor.errors import SimSensorError
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.pmd import PmdEmulator, PmdExposure
from rpod_target import Target


class Channel(Protocol):
    """An emulated sensor on the bus."""

    @property
    def sensor(self) -> SensorConfig:
        """Its configuration."""
        ...

    def emulate(
        self, poses: Sequence[RigidTransform], sun_W_m2: FloatArray, frame: DueFrame, fault: Kind | None
    ) -> Callable[[], None]:
        """Make a frame from T_sensor_target at the sensor's pose times; the sun in chaser axes.

        Returns what publishes it.
        """
        ...


class PmdChannel:
    """An emulated PMD camera."""

    def __init__(self, node: Node, config: EmulatorConfig, sensor: PmdConfig, target: Target) -> None:
        self.sensor = sensor
        self._seed = config.seed
        self._with_samples = config.publish_samples
        self._emulator = PmdEmulator(sensor, target, seed=config.seed)
        self._spare: list[PmdExposure] = []
        self._announced_s = sensor.integration_time_s
        self._publisher = CameraPublisher(
            node, sensor.name, T_chaser_sensor=sensor.T_chaser_sensor, info=sensor.info()
        )

    def emulate(
        self, poses: Sequence[RigidTransform], sun_W_m2: FloatArray, frame: DueFrame, fault: Kind | None
    ) -> Callable[[], None]:
        """Expose, and lose what the fault takes: the depth, or the amplitude as well."""
        sun = rotation_of(self.sensor.T_chaser_sensor).inv().apply(sun_W_m2)
        buffers = self._spare.pop() if self._spare else None
        exposure = self._emulator.expose(poses, sun_W_m2=sun, frame=frame.number, out=buffers)
        lost = lost_cells(fault, exposure.depth_m.shape, seed=self._seed, number=frame.number)
        if lost is not None:
            exposure.depth_m[lost] = np.nan
            if takes_amplitude(fault):
                exposure.amplitude[lost] = 0
        return partial(self._publish, exposure, frame.stamp_ns)

    def _publish(self, exposure: PmdExposure, stamp_ns: int) -> None:
        """Publish a frame, after the info where the exposure has changed it; its arrays serve again."""
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
        self._spare.append(exposure)


class LidarChannel:
    """An emulated scanning LIDAR."""

    def __init__(self, node: Node, config: EmulatorConfig, sensor: LidarConfig, target: Target) -> None:
        self.sensor = sensor
        self._seed = config.seed
        self._emulator = LidarEmulator(sensor, target, seed=config.seed)
        self._publisher = LidarPublisher(
            node, sensor.name, T_chaser_sensor=sensor.T_chaser_sensor, info=sensor.info()
        )

    def emulate(
        self,
        poses: Sequence[RigidTransform],
        sun_W_m2: FloatArray,  # noqa: ARG002 - the detector's background is in its own configuration
        frame: DueFrame,
        fault: Kind | None,
    ) -> Callable[[], None]:
        """Scan, and lose what the fault takes."""
        returns = self._emulator.scan(poses, frame=frame.number)
        points_m = returns.points_m
        lost = lost_cells(fault, points_m.shape[:2], seed=self._seed, number=frame.number)
        if lost is not None:
            points_m = np.where(lost[..., None], np.float32(np.nan), points_m)
        scan = LidarScan(
            stamp_ns=frame.stamp_ns,
            frame_id=self.sensor.name,
            points_m=points_m,
            intensity=returns.intensity,
            time_s=returns.time_s,
        )
        return partial(self._publisher.publish, scan)


def open_channel(node: Node, config: EmulatorConfig, sensor: SensorConfig, target: Target) -> Channel:
    """Return the channel of a sensor, warmed up: its first frame is as fast as any other.

    Raises:
        ConfigurationError: there is no such sensor, for its lens, say.
    """
    try:
        return _warm_channel(node, config, sensor, target)
    except (SimSensorError, GeometryError) as error:
        raise ConfigurationError(config.instance, f"sensors.{sensor.name}", str(error)) from error


def _warm_channel(node: Node, config: EmulatorConfig, sensor: SensorConfig, target: Target) -> Channel:
    if isinstance(sensor, PmdConfig):
        channel: Channel = PmdChannel(node, config, sensor, target)
    else:
        channel = LidarChannel(node, config, sensor, target)
    away = RigidTransform.from_translation([0.0, 0.0, 2.0 * target.radius_m + 1.0])
    poses = [away] * len(sensor.pose_times_s())
    channel.emulate(poses, np.zeros(3), DueFrame(0, sensor.name, 0, 0), None)
    return channel
