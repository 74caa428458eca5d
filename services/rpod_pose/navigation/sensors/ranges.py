"""Distances at which sensors are used, where the configuration limits them."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.ports import Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.sensor import SensorInput


class Ranges:
    """Decides which sensors are out of their configured range.

    Args:
        sensors: configurations of the sensors, whose ``range_m`` are the limits in m.
    """

    def __init__(self, sensors: Sequence[SensorInput]) -> None:
        self._range_m = {each.name: each.range_m for each in sensors if each.range_m is not None}

    def beyond(self, sensor: str, T_sensor_chaser: RigidTransform, T_chaser_target: RigidTransform) -> str:
        """Return why a sensor is not used for a target at a predicted pose; empty if it is used."""
        if sensor not in self._range_m:
            return ""
        return self._reason(sensor, T_sensor_chaser.apply(T_chaser_target.translation), "predicted")

    def not_of(self, sensor: str, found: Registration) -> str:
        """Return why a pose that was found is not used; empty if it is used, or if none was found."""
        pose = found.T_sensor_target
        if sensor not in self._range_m or pose is None:
            return ""
        return self._reason(sensor, pose.translation, "found")

    def _reason(self, sensor: str, position_m: FloatArray, how: str) -> str:
        least_m, greatest_m = self._range_m[sensor]
        range_m = float(np.linalg.norm(position_m))
        if least_m <= range_m <= greatest_m:
            return ""
        used = f"range_m is {least_m:g} to {greatest_m:g}"
        return f"out of range: the target is {how} at {range_m:.1f} m, {used}"
