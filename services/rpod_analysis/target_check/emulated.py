"""Emulated frames of any sensor kind in its default configuration, as an estimator receives them."""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_emulator.local_sensor import LocalSensor
from rpod_pose.methods import kind_methods
from rpod_pose.ports import Task
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.config.sensor import EmulatedSensor, SensorInput
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
        config = EmulatorConfig(target=target.source, sensors=(self.sensor,), seed=seed)
        self._local = LocalSensor(config, self.sensor, target)
        self._methods = kind_methods(self.heard)
        self.setup: Any = self._methods.setup(self.heard, self._local.info)

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
        poses = [T_sensor_target] * len(self.sensor.pose_times_s())
        sun = self.sensor.T_chaser_sensor.rotation.apply(sun_W_m2)
        return self._local.frame(poses, sun, frame_at(self.sensor, number, epoch_ns=_EPOCH_NS))


def default_tracker(emulated: EmulatedKind) -> Any:
    """Return the tracker of a sensor whose configuration names no method."""
    task = Task(emulated.target, emulated.heard, emulated.setup)
    kind = kind_methods(task.sensor)
    return kind.make(task).tracker if kind.tracker is None else kind.tracker(task)


def measured_points(frame: SensorFrame) -> int:
    """Return the number of a frame's returns, or of an image's pixels with depth."""
    if frame.lens is None:
        return len(frame.returns_m)
    return sum(int(np.isfinite(image.values).sum()) for image in frame.images if image.scale == "depth")
