"""Errors of an estimate against the truth, as columns."""

from typing import Any

import polars as pl
from scipy.spatial.transform import RigidTransform

from rpod_campaign.engine.trial.poses import POSE, errors, numbers
from rpod_campaign.engine.trial.sizes import Limits, longest_side_m
from rpod_pose.ports import Acquisition
from rpod_target import Target, is_shipped

SUCCESS_DEG = 3.0
"""Attitude error below which a pose is a success, deg (2015 paper, section 4.2)."""
RIGHT_M, RIGHT_SHARE = 0.3, 0.03
"""Position error from which on an accepted pose is wrong, whatever its attitude: in m for a shipped target,
over the longest side for any other. For these others, success also depends on the position."""
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
    "right_hypothesis": pl.Boolean,
    "f_conv_m2": pl.Float64,
    "explained_share": pl.Float64,
    "inliers": pl.Int64,
    "returns": pl.Int64,
    "templates": pl.Int64,
    "excluded_share": pl.Float64,
}


def limits_of(target: Target) -> Limits:
    """Return the errors from which on an accepted pose is wrong; relative to the size of other targets."""
    if is_shipped(target):
        return Limits(SUCCESS_DEG, RIGHT_M)
    return Limits(SUCCESS_DEG, RIGHT_SHARE * longest_side_m(target))


def is_success(attitude_deg: float | None, position_m: float | None, target: Target) -> bool:
    """Return whether a pose is a success: by its attitude alone, as in the paper, for a shipped target."""
    if is_shipped(target):
        return attitude_deg is not None and attitude_deg < SUCCESS_DEG
    return limits_of(target).are_met(attitude_deg, position_m)


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
        "success": is_success(attitude_deg, position_m, target),
        "accepted": acquisition.begins_track,
        "verdict": str(acquisition.outcome),
        "reason": acquisition.belief.reason,
        "hypotheses": len(acquisition.hypotheses),
        "right_hypothesis": any(
            is_success(*errors(truth, each.pose, target), target) for each in acquisition.hypotheses
        ),
        "f_conv_m2": registration.cost_m2,
        "explained_share": registration.explained_share,
        "inliers": registration.inliers,
        "returns": returns,
        "templates": acquisition.templates,
        "excluded_share": acquisition.excluded_share,
    }


def ambiguous(rows: pl.DataFrame) -> dict[str, int]:
    """Return the number of answers that begin no track because rivals are left, and of those with the truth.

    An ambiguity by an exact symmetry begins a track and is not counted.
    """
    unsure = rows.filter((pl.col("verdict") == "ambiguous") & ~pl.col("accepted"))
    return {"ambiguous": unsure.height, "ambiguous_with_truth": int(unsure["right_hypothesis"].sum())}


def wrong(rows: pl.DataFrame, target: Target) -> pl.Series:
    """Return which rows must not be accepted: errors beyond the limits, or no pose."""
    limits = limits_of(target)
    off = (pl.col("attitude_error_deg") >= limits.attitude_deg) | (
        pl.col("position_error_m") >= limits.position_m
    )
    return rows.select(off.fill_null(value=True).alias("wrong")).to_series()
