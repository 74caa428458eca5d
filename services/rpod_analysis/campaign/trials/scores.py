"""Truth against estimate, in columns."""

from typing import Any

import numpy as np
import polars as pl
from scipy.spatial.transform import RigidTransform

from rpod_pose.ports import Acquisition
from rpod_schemas.poses import pose_error
from rpod_target import Target

SUCCESS_DEG = 3.0
"""An attitude nearer than this is a success (2015 paper, section 4.2)."""
RIGHT_M = 0.3
"""An accepted pose farther off than this is wrong, whatever its attitude."""

POSE = pl.List(pl.Float64)
"""x, y, z in m and the quaternion x, y, z, w of T_sensor_target."""

ACQUISITION_SCHEMA: dict[str, Any] = {
    "truth": POSE,
    "found": POSE,
    "attitude_error_deg": pl.Float64,
    "position_error_m": pl.Float64,
    "success": pl.Boolean,
    "accepted": pl.Boolean,
    "verdict": pl.String,
    "reason": pl.String,
    "hypotheses": pl.Int64,
    "f_conv_m2": pl.Float64,
    "explained_share": pl.Float64,
    "inliers": pl.Int64,
    "returns": pl.Int64,
    "templates": pl.Int64,
    "excluded_share": pl.Float64,
}


def numbers(pose: RigidTransform | None) -> list[float] | None:
    """Return a pose as its column holds it."""
    if pose is None:
        return None
    return [*pose.translation.tolist(), *pose.rotation.as_quat().tolist()]


def errors(
    truth: RigidTransform, found: RigidTransform | None, target: Target
) -> tuple[float | None, float | None]:
    """Return the attitude error, deg, and the position error, m; None without a pose.

    Of a target with an exact symmetry the nearest of the poses that cannot be told from the truth counts.
    """
    if found is None:
        return None, None
    same = (truth, *(truth * turn for turn in target.turns(exact=True)))
    alike = [pose_error(pose, found) for pose in same]
    attitude_rad, position_m = min(alike, key=lambda error: float(np.linalg.norm(error[0])))
    return float(np.rad2deg(np.linalg.norm(attitude_rad))), float(np.linalg.norm(position_m))


def is_wrong(attitude_deg: float | None, position_m: float | None) -> bool:
    """Return whether a pose must not be accepted."""
    if attitude_deg is None or position_m is None:
        return True
    return attitude_deg >= SUCCESS_DEG or position_m >= RIGHT_M


def acquisition_row(
    truth: RigidTransform, acquisition: Acquisition, returns: int, target: Target
) -> dict[str, Any]:
    """Return the columns of ``ACQUISITION_SCHEMA``; ambiguous by an exact symmetry alone is accepted."""
    registration = acquisition.registration
    attitude_deg, position_m = errors(truth, acquisition.pose, target)
    return {
        "truth": numbers(truth),
        "found": numbers(acquisition.pose),
        "attitude_error_deg": attitude_deg,
        "position_error_m": position_m,
        "success": attitude_deg is not None and attitude_deg < SUCCESS_DEG,
        "accepted": acquisition.begins_track,
        "verdict": str(acquisition.outcome),
        "reason": acquisition.belief.reason,
        "hypotheses": len(acquisition.hypotheses),
        "f_conv_m2": registration.cost_m2,
        "explained_share": registration.explained_share,
        "inliers": registration.inliers,
        "returns": returns,
        "templates": acquisition.templates,
        "excluded_share": acquisition.excluded_share,
    }
