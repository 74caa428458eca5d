"""Tests of a sensor's residuals: are they as large as the filter says, and is their mean zero?

A residual is the innovation y of a frame, whitened by its covariance S = L L^T: z = L^-1 y. It is normal with
unit covariance if sensor and filter are right. Errors of successive frames are correlated, so n frames count
as the number m of periods of ``correlated_s`` that they span. Then m times the mean of |z|^2 has at most the
tail of chi-squared with 6 m degrees of freedom, and m |mean of z|^2 at most that with 6, whatever the
correlation within a period is. The tests alert too seldom rather than too often.

A stamp that is late by tau moves the measured pose by -tau (v, w), so that the mean of z is -tau L^-1 (v, w).
The least-squares estimate of tau shows whether the clock is the cause (Parkinson and Axelrad 1988 treat a
bias likewise).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rpod_pose.navigation.filter import POSE, FilterState, Innovation, separation_of
from rpod_pose.navigation.integrity.levels import chi2_limit
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import rotation_matrix

EXPLAINED = 0.5
"""Least share of a bias that a clock must explain to be named as the cause. Hand: more than all other causes
together."""


@dataclass(frozen=True, eq=False)
class Residual:
    """A whitened innovation."""

    stamp_ns: int
    z: FloatArray
    """Whitened innovation of (dp, dtheta), in standard deviations, shape (6,)."""
    late: FloatArray
    """Derivative of z with respect to the delay of the stamp, 1/s, shape (6,)."""


@dataclass(frozen=True)
class Statistic:
    """A test statistic, which has the distribution of chi-squared if sensor and filter are right."""

    name: str
    """Tested quantity, in words."""
    value: float
    """Value of the statistic, to be compared with chi-squared."""
    dof: float
    """Degrees of freedom."""
    cause: str = ""
    """Likely cause, for the operator."""
    least_risk: float = 0.0
    """Least probability at which it may fail by chance, of a test with few independent looks an hour."""

    def exceeds_risk(self, risk: float) -> bool:
        """Return whether the statistic is above the limit that it exceeds by chance with ``risk``."""
        return not self.value <= self._limit(risk)

    def describe(self, risk: float) -> str:
        """Return the test in words, with its figures."""
        return f"{self.name}: chi squared {self.value:.1f}, limit {self._limit(risk):.1f}{self.cause}"

    def _limit(self, risk: float) -> float:
        return chi2_limit(max(risk, self.least_risk), self.dof)


def separation_test(name: str, one: FilterState, other: FilterState) -> Statistic:
    """Return the test whether two solutions differ by more than their covariances together allow.

    Solutions that share measurements differ by less than that, so the test alerts too seldom.
    """
    apart = separation_of(one, other)
    covariance = one.covariance[POSE, POSE] + other.covariance[POSE, POSE]
    covariance = one.alike.with_free_variance(covariance, rotation_matrix(one.T_chaser_target), 1.0)
    return Statistic(name, float(apart @ np.linalg.solve(covariance, apart)), one.alike.dof)


def residual_of(predicted: FilterState, found: Innovation, stamp_ns: int) -> Residual | None:
    """Return the residual of a measurement against the prediction to its stamp; None if it is not finite."""
    y, S = found.difference, found.covariance
    if not (np.isfinite(y).all() and np.isfinite(S).all()):
        return None
    try:
        L = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        return None
    twist = np.concatenate([predicted.velocity_m_s, predicted.rate_rad_s])
    white: FloatArray = np.linalg.solve(L, np.column_stack([y, -twist])).astype(np.float64)
    return Residual(stamp_ns, white[:, 0], white[:, 1])


def recent(residuals: Sequence[Residual], newest_ns: int, window_s: float) -> tuple[Residual, ...]:
    """Return the residuals of the last ``window_s`` seconds, in the order of their stamps."""
    kept = (each for each in residuals if newest_ns - each.stamp_ns <= window_s * 1e9)
    return tuple(sorted(kept, key=lambda each: each.stamp_ns))


def residual_tests(
    sensor: str, residuals: Sequence[Residual], *, dof: int, correlated_s: float
) -> tuple[tuple[Statistic, ...], dict[str, float]]:
    """Return the tests of a sensor's residuals, and the estimate of its clock's offset as evidence.

    Args:
        sensor: name of the sensor.
        residuals: its residuals in the window, at least one.
        dof: degrees of freedom of a pose: 6, less with a free axis.
        correlated_s: time within which residuals count as one.
    """
    z = np.array([each.z for each in residuals])
    late = np.array([each.late for each in residuals])
    span_s = (residuals[-1].stamp_ns - residuals[0].stamp_ns) * 1e-9
    periods = periods_of(len(z), span_s, correlated_s)
    mean = z.mean(axis=0)
    bias = periods * float(mean @ mean)
    information = periods * float((late**2).sum(axis=1).mean())
    evidence, cause = {}, ""
    if information > 0.0:
        offset_s = periods * float((late * z).sum(axis=1).mean()) / information
        sigma_s = information**-0.5
        evidence = {f"{sensor}_stamps_late_s": offset_s, f"{sensor}_stamps_late_sigma_s": sigma_s}
        share = offset_s**2 * information / bias if bias else 0.0
        if share > EXPLAINED:
            cause = f"; stamps that are {offset_s:.3f} s late (sigma {sigma_s:.3f} s) explain {share:.0%}"
    size = Statistic(
        f"{sensor}: size of its residuals", periods * float((z**2).sum(axis=1).mean()), dof * periods, cause
    )
    return (size, Statistic(f"{sensor}: mean of its residuals", bias, dof, cause)), evidence


def periods_of(count: int, span_s: float, correlated_s: float) -> float:
    """Return the number of independent frames as which ``count`` frames in a span of time count."""
    return min(float(count), 1.0 + (span_s / correlated_s if correlated_s else np.inf))
