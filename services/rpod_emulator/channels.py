"""Emulated sensors from pose to messages, with one interface for all kinds."""

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_emulator.faults import FaultyNode
from rpod_geometry.errors import GeometryError
from rpod_runtime import Node
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig, SensorConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.registry import resolve
from rpod_schemas.schedule import DueFrame
from rpod_schemas.sensors import sensor_kind
from rpod_sim_sensor.errors import SimSensorError
from rpod_target import Target


class Channel(Protocol):
    """An emulated sensor that publishes on the bus, created as ``(node, config, sensor, target)``."""

    @property
    def sensor(self) -> SensorConfig:
        """Configuration of the sensor."""
        ...

    def emulate(
        self, poses: Sequence[RigidTransform], sun_W_m2: FloatArray, frame: DueFrame
    ) -> Callable[[], None]:
        """Compute a frame; return a function that publishes it.

        Args:
            poses: T_sensor_target at the sensor's pose times.
            sun_W_m2: unit vector to the sun times its irradiance, chaser axes, shape (3,).
            frame: number and stamp of the frame.
        """
        ...


@runtime_checkable
class Showing(Protocol):
    """A channel that can show the target at another angle of its joints."""

    def show(self, target: Target) -> None:
        """Show another target from the next frame on."""
        ...


def open_channel(
    node: Node | FaultyNode, config: EmulatorConfig, sensor: SensorConfig, target: Target
) -> Channel:
    """Return the channel of a sensor. It is warmed up: its first frame is as fast as any other.

    Raises:
        ConfigurationError: the sensor cannot be emulated, for example because of its lens.
    """
    try:
        return _warm_channel(node, config, sensor, target)
    except (SimSensorError, GeometryError) as error:
        raise ConfigurationError(config.instance, f"sensors.{sensor.name}", str(error)) from error


def _warm_channel(
    node: Node | FaultyNode, config: EmulatorConfig, sensor: SensorConfig, target: Target
) -> Channel:
    channel: Channel = resolve(sensor_kind(sensor.kind).emulator)(node, config, sensor, target)
    away = RigidTransform.from_translation([0.0, 0.0, 2.0 * target.radius_m + 1.0])
    poses = [away] * len(sensor.pose_times_s())
    channel.emulate(poses, np.zeros(3), DueFrame(0, sensor.name, 0, 0))
    return channel
