"""What a new filter takes over of the filter before it.

Errors of mounts and calibrations, and biases of the chaser's gyro and accelerometer, belong to the
facility. They stay, at whatever attitude the target is found. The target's inertia and centre of mass, and
errors of its model, are stated in target axes. They stay only where the new pose continues the attitude of
the filter before. Pose and twist are never taken over: the new filter starts because they are in doubt.
"""

from dataclasses import replace
from math import radians

import numpy as np

from rpod_pose.belief import worst_sigma
from rpod_pose.navigation.challenger import EXPLAINED_DEG
from rpod_pose.navigation.dynamics.free_motion import FORCE_ERRORS, GYRO_BIAS
from rpod_pose.navigation.filter import ATTITUDE, FilterState, predict, separation_of
from rpod_pose.navigation.filter.blocks import Known
from rpod_pose.navigation.pose_measurement import PoseMeasurement, is_beside, is_of_sensor
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.messages import NANOSECONDS

PREDICTED_S = 300.0
"""Longest time over which a filter is predicted, s. Numerics: readings of the IMU are kept for as long; a
prediction of a tumbling body over hours would take minutes."""
_SIGMAS = 3.0
"""Standard deviations of a prediction within which an attitude must be known to count as continued.
Physics: one in 370 normal errors is larger."""


def carried(past: FilterState, measured: PoseMeasurement, config: FilterConfig) -> Known:
    """Return what a filter that starts at a measured pose takes over of the filter before it.

    Args:
        past: state of the filter before.
        measured: the pose at which the new filter starts.
        config: configuration of both.
    """
    if (measured.stamp_ns - past.stamp_ns) / NANOSECONDS > PREDICTED_S:
        return past.known_of(
            {block.name for block in past.blocks if _is_of_facility(block.name)} - {GYRO_BIAS}
        )
    there = predict(past, max(measured.stamp_ns, past.stamp_ns), config)
    goes_on = _continues(there, measured)
    kept = (block.name for block in there.blocks if goes_on or _is_of_facility(block.name))
    return there.known_of({name for name in kept if not is_beside(name)})


def _continues(predicted: FilterState, measured: PoseMeasurement) -> bool:
    """Return whether a pose shows the predicted attitude, and no other one that looks alike."""
    found = replace(predicted, T_chaser_target=measured.T_chaser_target)
    turn_rad = float(np.linalg.norm(separation_of(found, predicted)[ATTITUDE]))
    sigma_rad = worst_sigma(predicted.covariance[ATTITUDE, ATTITUDE])
    return max(turn_rad, _SIGMAS * sigma_rad) <= radians(EXPLAINED_DEG)


def _is_of_facility(block: str) -> bool:
    return block in (GYRO_BIAS, *FORCE_ERRORS) or is_of_sensor(block)
