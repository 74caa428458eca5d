"""Scoring: numerical comparison of estimates with the truth, by pure functions of arrays.

Source: ICD section 1, "Covariance" and "Errors".
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import matrices_between
from rpod_target import NO_SYMMETRY, Equivalence

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

MAX_TRUTH_GAP_NS = 8_000_000
"""Largest gap between two neighbours in the truth; estimates in a longer gap are not scored."""
MOST_GAP = 2.5
"""Longest gap in the truth in which a calibration interpolates it, in its usual intervals."""
NEES_95 = {6: 12.59, 5: 11.07, 3: 7.81}
"""95 % quantile of chi-squared, by its degrees of freedom: six, five with a free axis, three of a sphere."""
OFF_TARGET_RAD = math.radians(10.0)
"""Attitude error above which a tracked frame counts as off the target."""
OFF_TARGET_M = 0.3
"""Position error above which a tracked frame counts as off the target."""


@dataclass(frozen=True, eq=False)
class Track:
    """Poses over time."""

    stamp_ns: IntArray
    """Stamps in the order of publication, shape (N,)."""
    poses: RigidTransform
    """Poses at the stamps, N of them."""
    covariance: FloatArray | None = None
    """Covariance of (dp, dtheta) in the fixed axes of the parent frame, shape (N, 6, 6); None if no pose has
    one."""

    def __len__(self) -> int:
        return self.stamp_ns.size


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of N estimates; NaN for estimates without truth."""

    attitude_rad: FloatArray
    """Attitude errors (roll, pitch, yaw), Log(R_truth^T R_estimate), target axes, shape (N, 3)."""
    position_m: FloatArray
    """Position errors, estimate minus truth in the sensor's axes, shape (N, 3)."""
    nees: FloatArray
    """NEES, shape (N,); NaN if the covariance is not valid."""
    truth_covariance: FloatArray | None = None
    """Covariance of (dp, dtheta) of the truth, chaser axes, shape (N, 6, 6), which is part of the NEES; None
    for a truth that states none."""
    nees_dof: int = 6
    """Degrees of freedom of the NEES: the directions in which the target can be measured."""

    @property
    def scored(self) -> BoolArray:
        """Whether the truth is known at the estimate's stamp, shape (N,)."""
        return np.isfinite(self.angle_rad)

    @property
    def angle_rad(self) -> FloatArray:
        """Angle of the attitude error, shape (N,)."""
        return _lengths(self.attitude_rad)

    @property
    def distance_m(self) -> FloatArray:
        """Length of the position error, shape (N,)."""
        return _lengths(self.position_m)

    @property
    def off_target(self) -> BoolArray:
        """Whether the error exceeds 10 degrees or 0.3 m, shape (N,)."""
        return (self.angle_rad > OFF_TARGET_RAD) | (self.distance_m > OFF_TARGET_M)

    def at(self, where: BoolArray) -> "Errors":
        """Return the errors of the estimates for which a mask, shape (N,), is true."""
        known = None if self.truth_covariance is None else self.truth_covariance[where]
        return Errors(
            self.attitude_rad[where], self.position_m[where], self.nees[where], known, self.nees_dof
        )


def calibration_gap_ns(truth: Track) -> int:
    """Return the longest gap in the truth in which a calibration interpolates it, ns.

    A calibration takes what truth there is: 2.5 of its usual intervals, so that one pose may be missing, but
    no less than in scoring.
    """
    steps_ns = np.diff(np.unique(truth.stamp_ns))
    usual_ns = float(np.median(steps_ns)) if steps_ns.size else 0.0
    return max(round(MOST_GAP * usual_ns), MAX_TRUTH_GAP_NS)


def interpolate(
    truth: Track, stamp_ns: IntArray, most_gap_ns: int = MAX_TRUTH_GAP_NS
) -> tuple[RigidTransform, BoolArray]:
    """Return the truth at N stamps, and at which of them it is known, shape (N,); other poses are not valid.

    Between neighbours, rotations are interpolated by Slerp and translations linearly. The truth is known at
    its own stamps and between neighbours at most ``most_gap_ns`` apart (8 ms), but not beyond its ends.
    """
    known_ns, first = np.unique(truth.stamp_ns, return_index=True)
    if known_ns.size == 0:
        return RigidTransform.identity(stamp_ns.size), np.zeros(stamp_ns.size, bool)
    poses = truth.poses.as_matrix()[first]
    after = np.searchsorted(known_ns, stamp_ns).clip(0, known_ns.size - 1)
    exact = known_ns[after] == stamp_ns
    before = np.where(exact, after, (after - 1).clip(0))
    gap_ns = known_ns[after] - known_ns[before]
    inside = (known_ns[before] < stamp_ns) & (stamp_ns < known_ns[after])
    share = np.where(inside, (stamp_ns - known_ns[before]) / np.maximum(gap_ns, 1), 0.0)
    matrices = matrices_between(poses[before], poses[after], share)
    known = exact | (inside & (gap_ns <= most_gap_ns))
    return RigidTransform(matrices, normalize=False, copy=False), known


def interpolate_covariance(truth: Track, stamp_ns: IntArray) -> FloatArray | None:
    """Return the truth's covariance at stamps, shape (N, 6, 6); None if it states none.

    Errors of neighbours count as the same, so that interpolation does not reduce them.
    """
    if truth.covariance is None or not len(truth):
        return None
    known_ns, first = np.unique(truth.stamp_ns, return_index=True)
    after = np.searchsorted(known_ns, stamp_ns).clip(0, known_ns.size - 1)
    before = (after - 1).clip(0)
    gap_ns = np.maximum(known_ns[after] - known_ns[before], 1)
    share = ((stamp_ns - known_ns[before]) / gap_ns).clip(0.0, 1.0)[:, None, None]
    covariance = truth.covariance[first]
    mixed: FloatArray = (1.0 - share) * covariance[before] + share * covariance[after]
    return mixed


def find_errors(
    estimates: Track,
    truth: Track,
    *,
    covariance: FloatArray,
    R_chaser_sensor: Rotation,
    alike: Equivalence = NO_SYMMETRY,
) -> tuple[Errors, RigidTransform]:
    """Return the errors of N estimates, and the truth at their stamps.

    Args:
        estimates: estimated T_chaser_target.
        truth: true T_chaser_target.
        covariance: covariances of (dp, dtheta) in chaser axes, shape (N, 6, 6); zeros if unknown.
        R_chaser_sensor: attitudes of the sensors whose frames gave the estimates, N rotations.
        alike: attitudes of the target that no measurement distinguishes: errors are those against the
            nearest of them.
    """
    T_truth, known = interpolate(truth, estimates.stamp_ns)
    R_estimate = estimates.poses.rotation
    R_truth = alike.nearest(T_truth.rotation, R_estimate)
    attitude_rad = (R_truth.inv() * R_estimate).as_rotvec()
    position_m = estimates.poses.translation - T_truth.translation
    turn_rad = (R_estimate * R_truth.inv()).as_rotvec()
    error = np.hstack([position_m, turn_rad])
    unknown = ~known
    attitude_rad[unknown] = np.nan
    in_sensor_m = R_chaser_sensor.inv().apply(position_m)
    in_sensor_m[unknown] = np.nan
    error[unknown] = np.nan
    of_truth = interpolate_covariance(truth, estimates.stamp_ns)
    expected = _with_truth(covariance, of_truth)
    nees = find_nees(error, alike.with_free_variance(expected, R_estimate.as_matrix(), 1.0))
    return Errors(attitude_rad, in_sensor_m, nees, of_truth, alike.dof), T_truth


def _with_truth(covariance: FloatArray, of_truth: FloatArray | None) -> FloatArray:
    """Return the covariance of estimate minus truth; zeros stay where that of the estimate is unknown."""
    if of_truth is None:
        return covariance
    known = np.all(np.diagonal(covariance, axis1=1, axis2=2) > 0.0, axis=1, keepdims=True)
    return covariance + np.where(known[:, :, None], of_truth, 0.0)


def find_nees(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return e^T P^-1 e, shape (N,), of errors (N, 6) and covariances (N, 6, 6).

    It is NaN if the error is unknown or the covariance is not positive definite.
    """
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2).clip(0.0))
    usable = np.isfinite(error).all(axis=1) & (sigma > 0.0).all(axis=1)
    nees = np.full(len(error), np.nan)
    scaled = error[usable] / sigma[usable]
    correlation = covariance[usable] / (sigma[usable, :, None] * sigma[usable, None, :])
    values, vectors = np.linalg.eigh(correlation)
    parts = np.einsum("nij,ni->nj", vectors, scaled) ** 2
    definite = values[:, 0] > 1e-12
    nees[np.flatnonzero(usable)[definite]] = (parts[definite] / values[definite]).sum(axis=1)
    return nees


def _lengths(vectors: FloatArray) -> FloatArray:
    squared: FloatArray = (vectors**2).sum(axis=1)
    return np.sqrt(squared)
