"""Poses as columns of a row, and errors between two poses."""

import numpy as np
import polars as pl
from scipy.spatial.transform import RigidTransform

from rpod_schemas.poses import pose_error
from rpod_target import Target

POSE = pl.List(pl.Float64)
"""Column type of a pose T_sensor_target: x, y, z in m and the quaternion x, y, z, w."""


def numbers(pose: RigidTransform | None) -> list[float] | None:
    """Return a pose as the values of its column."""
    if pose is None:
        return None
    return [*pose.translation.tolist(), *pose.rotation.as_quat().tolist()]


def errors(
    truth: RigidTransform, found: RigidTransform | None, target: Target
) -> tuple[float | None, float | None]:
    """Return the attitude error, deg, and the position error, m; None without a pose.

    For a target with an exact symmetry, the errors are those against the nearest equivalent pose.
    """
    if found is None:
        return None, None
    same = (truth, *(truth * turn for turn in target.turns(exact=True)))
    alike = [pose_error(pose, found) for pose in same]
    attitude_rad, position_m = min(alike, key=lambda error: float(np.linalg.norm(error[0])))
    return float(np.rad2deg(np.linalg.norm(attitude_rad))), float(np.linalg.norm(position_m))
