"""Protection levels from solutions with and without a part of the measurements.

The error of an estimate is above its level, without an alert, with at most the probability ``risk``. Each
fault hypothesis has a solution x_k without the measurements that are wrong under it; x_0 uses all of them. If
x_k is right, the error of x_0 is at most its separation from x_k plus the error of x_k. Hence the level

    max over k of |x_0 - x_k| + K(p_k) sigma_k,

where p_k is the hypothesis's part of the risk divided by its probability, sigma_k the standard deviation of
x_k in its worst direction, and K sigma_k the quantile of the length of a normal vector with its covariance.
So the level is the radius of a sphere, and K depends on the shape of the covariance: for p = 1e-6 it is 4.89
if the error lies along one axis only, and 5.54 if it is equal along all three.

Errors that no test of one sensor can detect add their covariance, in the direction in which they act: an
error of the mount's attitude moves the target across the line of sight, a drift of the ranges along it, an
error of the clock along the velocity.

Sources: R. G. Brown, A baseline GPS RAIM scheme and a note on the equivalence of three RAIM methods,
Navigation 39(3), 1992; B. W. Parkinson and P. Axelrad, Autonomous GPS integrity monitoring using the
pseudorange residual, Navigation 35(2), 1988 (the residual tests); J. Blanch et al., Baseline Advanced RAIM
user algorithm and possible improvements, IEEE Trans. Aerosp. Electron. Syst. 51(1), 2015 (separations and
the allocation of the risk). Words of the result as in RTCA DO-229: protection level, alert limit, misleading.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import ceil, degrees, log10

import numpy as np
from scipy.special import chdtri, gammainccinv, ndtr, ndtri

from rpod_pose.navigation.filter import ATTITUDE, POSE, POSITION, FilterState, separation_of
from rpod_pose.navigation.filter.rotations import cross_matrix
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.integrity import IntegrityConfig

_RATIOS = 20
"""Number of steps to which a ratio of two standard deviations is rounded up, so that few quantiles have to be
computed and cached. Numerics: a level grows by a twentieth at most."""
_ROUNDING = 1e-9
"""Part of a step below which a ratio counts as the step itself. Numerics: the error of the division."""
_DECADE = 20
"""Number of steps in a decade to which a hypothesis' probability is rounded up, for the same reason.
Numerics: a probability changes by 12 % at most."""
_NODES = 24
"""Number of nodes of the quadrature along each of two angles. Numerics: a quantile is right to 1e-5, a
hundredth of ``_CLOSE``."""
_CLOSE = 1e-3
"""Largest error of a quantile, which is never too small, in standard deviations. Numerics: below a thousandth
of any level."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution under a hypothesis of what is wrong, at the stamp of the estimate."""

    name: str
    """Name of the hypothesis, for example "without lidar"; empty for the solution with all measurements."""
    separation: FloatArray
    """(dp, dtheta) from this solution to the estimate, m and rad, shape (6,)."""
    covariance: FloatArray
    """Covariance of the solution's pose, shape (6, 6)."""
    probability: float = 1.0
    """Probability of the hypothesis."""


@dataclass(frozen=True)
class Levels:
    """Protection levels, and the solutions from which they follow."""

    attitude_deg: float
    """Level of the attitude; NaN if it is not known."""
    position_m: float
    """Level of the position; NaN if it is not known."""
    attitude_by: str
    """Name of the solution that determines the level of the attitude."""
    position_by: str
    """Name of the solution that determines the level of the position."""


def solution(name: str, estimate: FilterState, other: FilterState, probability: float) -> Solution:
    """Return the state of another filter at the estimate's stamp as the solution of a hypothesis."""
    return Solution(name, separation_of(estimate, other), other.covariance[POSE, POSE], probability)


def protection_levels(solutions: Sequence[Solution], unseen: FloatArray, risk: float) -> Levels:
    """Return the levels of an estimate; attitude and position get half of the risk each.

    Args:
        solutions: the solution with all measurements first, then those of the fault hypotheses.
        unseen: covariance of the declared errors, shape (6, 6), as ``declared_covariance`` returns it.
        risk: probability that an error exceeds its level.
    """
    position_m, position_by = _greatest(solutions, POSITION, unseen, 0.5 * risk)
    attitude_rad, attitude_by = _greatest(solutions, ATTITUDE, unseen, 0.5 * risk)
    return Levels(min(degrees(attitude_rad), 180.0), position_m, attitude_by, position_by)


def declared_covariance(
    config: IntegrityConfig, place_m: FloatArray, velocity_m_s: FloatArray, rate_rad_s: FloatArray
) -> FloatArray:
    """Return the covariance of (dp, dtheta) by the declared errors of mount, clock and ranges, shape (6, 6).

    Args:
        config: declared standard deviations.
        place_m: position of the target's origin relative to the sensor, in the solutions' axes, shape (3,).
        velocity_m_s: velocity of the origin, by which an error of the clock displaces it, shape (3,).
        rate_rad_s: rate of the target, by which an error of the clock turns it, shape (3,).
    """
    mount_rad = np.deg2rad(config.mount_sigma_deg)
    turned = np.vstack([-cross_matrix(place_m), np.eye(3)])
    late, along = np.concatenate([velocity_m_s, rate_rad_s]), np.concatenate([place_m, np.zeros(3)])
    covariance: FloatArray = (
        mount_rad**2 * turned @ turned.T
        + config.clock_sigma_s**2 * np.outer(late, late)
        + config.tuning.range_share**2 * np.outer(along, along)
    )
    covariance[POSITION, POSITION] += config.mount_sigma_m**2 * np.eye(3)
    return covariance


def _greatest(
    solutions: Sequence[Solution], part: slice, unseen: FloatArray, risk: float
) -> tuple[float, str]:
    """Return the greatest level of the solutions, and the name of its solution.

    The solution with all measurements gets half of the risk, and the others share the other half. The level
    is NaN if that of any solution is unknown.
    """
    shares = (0.5 * risk, *[0.5 * risk / max(len(solutions) - 1, 1)] * (len(solutions) - 1))
    levels = [_level(each, part, unseen, share) for each, share in zip(solutions, shares, strict=True)]
    first = int(np.argmax(levels))  # the index of the first NaN if there is one
    return levels[first], solutions[first].name


def _level(solution: Solution, part: slice, unseen: FloatArray, risk: float) -> float:
    """Return the level by one solution with its part of the risk; NaN if the covariance is unknown."""
    probability = min(risk / _rounded(solution.probability), 1.0)
    quantile = length_quantile((solution.covariance + unseen)[part, part], probability)
    return float(np.linalg.norm(solution.separation[part])) + quantile


def _rounded(probability: float) -> float:
    """Return the next step of a probability that is not below it."""
    return float(10.0 ** (ceil(_DECADE * log10(probability) - _ROUNDING) / _DECADE))


def length_quantile(covariance: FloatArray, probability: float) -> float:
    """Return the length that a normal vector exceeds with at most a probability; NaN if it is unknown.

    Args:
        covariance: covariance of the vector, shape (3, 3).
        probability: the probability, above 0.
    """
    if not np.isfinite(covariance).all():
        return float("nan")
    sigma = np.sqrt(np.linalg.eigvalsh(covariance).clip(0.0))
    if not sigma[2] > 0.0:
        return 0.0
    least, middle = (ceil(_RATIOS * ratio - _ROUNDING) for ratio in sigma[:2] / sigma[2])
    return float(sigma[2]) * _shaped_quantile(middle / _RATIOS, least / _RATIOS, probability)


@cache
def _shaped_quantile(middle: float, least: float, probability: float) -> float:
    """Return the length that (z1, middle z2, least z3) exceeds with a probability; z is standard normal.

    With z = rho u, u on the unit sphere, the length is rho g(u). Length and direction of z are independent,
    so that P(|x| > r) is the mean of P(rho > r / g(u)) over the sphere, an octant of it for symmetry.
    """
    height, weight = _nodes()
    angle = 0.5 * np.pi * height
    around = (middle * np.cos(angle)) ** 2 + (least * np.sin(angle)) ** 2
    g = np.sqrt(height[:, None] ** 2 + (1.0 - height[:, None] ** 2) * around)

    def excess(length: float) -> float:
        x = length / g  # P(rho > x) of chi with three degrees of freedom
        beyond = 2.0 * ndtr(-x) + np.sqrt(2.0 / np.pi) * x * np.exp(-0.5 * x**2)
        return float(weight @ beyond @ weight) - probability

    low, high = float(-ndtri(0.5 * probability)), float(np.sqrt(2.0 * gammainccinv(1.5, probability)))
    if not (excess(low) > 0.0 > excess(high)):  # errors along one axis only, or equal along all axes
        return low if excess(low) <= 0.0 else high
    while high - low > _CLOSE:
        between = 0.5 * (low + high)
        low, high = (between, high) if excess(between) > 0.0 else (low, between)
    return high


@cache
def _nodes() -> tuple[FloatArray, FloatArray]:
    """Return places and weights of the quadrature from 0 to 1, shape (N,) each."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    return 0.5 * (nodes + 1.0), 0.5 * weights


@cache
def chi2_limit(probability: float, dof: float) -> float:
    """Return the value that chi-squared exceeds with a probability."""
    return float(chdtri(dof, probability))
