"""Poses as columns of a row, and errors between two poses."""

import numpy as np
import polars as pl
from scipy.spatial.transform import RigidTransform

from rpod_analysis.scoring.score import find_nees
from rpod_schemas.arrays import FloatArray
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
    """Return the attitude error, deg, and the position error, m, modulo exact symmetries.

    Without a pose both are None.
    """
    return (None, None) if found is None else target.equivalence.error_of(found, truth)


def nees_of(
    truth: RigidTransform, found: RigidTransform | None, covariance: FloatArray, target: Target
) -> float:
    """Return the normalised squared error of (dp, dtheta), by its covariance, (6, 6), both in sensor axes.

    NaN without a pose, or where the covariance is not positive definite. For a target with an exact symmetry,
    the error is that against the nearest equivalent pose. The angle about a free axis does not count.
    """
    if found is None:
        return float("nan")
    same = target.equivalence.nearest_pose(truth, found)
    turn = (found.rotation * same.rotation.inv()).as_rotvec()
    error = np.concatenate((found.translation - same.translation, turn))
    observed = target.equivalence.with_free_variance(covariance, found.rotation.as_matrix(), 1.0)
    return float(find_nees(error[None], observed[None])[0])
