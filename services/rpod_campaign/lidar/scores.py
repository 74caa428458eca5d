"""Errors of an estimate against the truth, as columns."""

from typing import Any

import polars as pl
from scipy.spatial.transform import RigidTransform

from rpod_campaign.engine.trial.poses import POSE, errors, numbers
from rpod_pose.ports import Acquisition
from rpod_target import Target

SUCCESS_DEG = 3.0
"""Attitude error below which a pose is a success, deg (2015 paper, section 4.2)."""
RIGHT_M = 0.3
"""Position error from which on an accepted pose is wrong, whatever its attitude, m."""
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


def is_wrong(attitude_deg: float | None, position_m: float | None) -> bool:
    """Return whether a pose must not be accepted."""
    if attitude_deg is None or position_m is None:
        return True
    return attitude_deg >= SUCCESS_DEG or position_m >= RIGHT_M


def acquisition_row(
    truth: RigidTransform, acquisition: Acquisition, returns: int, target: Target
) -> dict[str, Any]:
    """Return the columns of ``ACQUISITION_SCHEMA``; ambiguity by an exact symmetry is accepted."""
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
