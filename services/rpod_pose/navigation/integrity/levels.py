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

from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import ceil, degrees, exp, log
from operator import neg
from typing import NamedTuple, Self

import numpy as np
from scipy.special import chdtri, ndtr

from rpod_pose.navigation.filter import ATTITUDE, POSE, POSITION, FilterState, separation_of
from rpod_pose.navigation.filter.rotations import cross_matrix
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.integrity import IntegrityConfig

_RATIOS = 20
"""Number of steps to which a ratio of two standard deviations is rounded up, so that few tables have to be
computed and cached. Numerics: a level grows by a twentieth at most."""
_ROUNDING = 1e-9
"""Part of a step below which a ratio counts as the step itself. Numerics: the error of the division."""
_NODES = 24
"""Number of nodes of the quadrature along each of two angles. Numerics: a quantile is right to 1e-5."""
_STEP, _MOST = 0.05, 12.0
"""Step and end of a table of tails, in standard deviations. Numerics: at the end a tail is below 1e-30."""
_NO_LENGTH = 1e-12
"""Standard deviation of a vector that is known exactly. Numerics: nothing is divided by zero."""
_HALVINGS = 8
"""Number of bisections of a level. Numerics: its bounds are a fifth apart at most, so that it is right to a
thousandth, and never too small."""


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
    """Return the levels of an estimate; arguments as for ``LevelsOf`` and its ``by``."""
    return LevelsOf(unseen, risk).by(solutions)


class LevelsOf:
    """Returns the levels of an estimate; attitude and position get half of the risk each.

    Args:
        unseen: covariance of the declared errors, shape (6, 6), as ``declared_covariance`` returns it.
        risk: probability that an error exceeds its level.
    """

    def __init__(self, unseen: FloatArray, risk: float) -> None:
        self._unseen, self._risk = unseen, 0.5 * risk
        self._tails: dict[tuple[Solution, int], _Tail | None] = {}
        """Tails of the solutions so far, by the first index of the part; None if a covariance is unknown."""

    def by(self, solutions: Sequence[Solution]) -> Levels:
        """Return the levels by some solutions: that with all measurements first, then the hypotheses'."""
        position_m, position_by = self._level(solutions, POSITION)
        attitude_rad, attitude_by = self._level(solutions, ATTITUDE)
        return Levels(min(degrees(attitude_rad), 180.0), position_m, attitude_by, position_by)

    def _level(self, solutions: Sequence[Solution], part: slice) -> tuple[float, str]:
        """Return the level of a part and what determines it; NaN if a solution's covariance is unknown."""
        tails = []
        for each in solutions:
            tail = self._tail(each, part)
            if tail is None:
                return float("nan"), each.name
            tails.append(tail)
        return _level(tails, self._risk)

    def _tail(self, solution: Solution, part: slice) -> "_Tail | None":
        key = solution, part.start
        if key not in self._tails:
            covariance = (solution.covariance + self._unseen)[part, part]
            known = np.isfinite(covariance).all()
            self._tails[key] = _Tail.of(solution, part, covariance) if known else None
        return self._tails[key]


def declared_covariance(
    config: IntegrityConfig,
    place_m: FloatArray,
    velocity_m_s: FloatArray,
    rate_rad_s: FloatArray,
    *,
    followed: float = 1.0,
) -> FloatArray:
    """Return the covariance of (dp, dtheta) by the declared errors of mount, clock and ranges, shape (6, 6).

    Args:
        config: declared standard deviations.
        place_m: position of the target's origin relative to the sensor, in the solutions' axes, shape (3,).
        velocity_m_s: velocity of the origin, by which an error of the clock displaces it, shape (3,).
        rate_rad_s: rate of the target, by which an error of the clock turns it, shape (3,).
        followed: share of an error of the ranges that the estimate has; less than 1 where the apparent size
            tells the distance too.
    """
    columns = declared_errors(config, place_m, velocity_m_s, rate_rad_s, followed=followed)
    covariance: FloatArray = columns @ columns.T
    return covariance


def declared_errors(
    config: IntegrityConfig,
    place_m: FloatArray,
    velocity_m_s: FloatArray,
    rate_rad_s: FloatArray,
    *,
    followed: float = 1.0,
) -> FloatArray:
    """Return what declared errors of one standard deviation do to (dp, dtheta), shape (6, 8).

    The columns are those of the mount's attitude and of its place about and along each axis, of the clock,
    and of the ranges. Arguments as for ``declared_covariance``.
    """
    mount_rad = np.deg2rad(config.mount_sigma_deg)
    columns = np.zeros((6, 8))
    columns[:, :3] = mount_rad * np.vstack([-cross_matrix(place_m), np.eye(3)])
    columns[POSITION, 3:6] = config.mount_sigma_m * np.eye(3)
    columns[:, 6] = config.clock_sigma_s * np.concatenate([velocity_m_s, rate_rad_s])
    columns[POSITION, 7] = followed * config.tuning.range_share * place_m
    return columns


def above(levels: Levels, limit_deg: float, limit_m: float) -> str:
    """Return which level is above its alert limit; empty if none is."""
    for what, level, limit, unit, by in (
        ("attitude", levels.attitude_deg, limit_deg, "deg", levels.attitude_by),
        ("position", levels.position_m, limit_m, "m", levels.position_by),
    ):
        if not level <= limit:
            left_out = f" ({by})" if by else ""
            return (
                f"protection level of the {what} {level:.3g} {unit}{left_out}, alert limit {limit:.3g} {unit}"
            )
    return ""


class _Tail(NamedTuple):
    """Probability that the error under a hypothesis is above a length, times that of the hypothesis."""

    apart: float
    """Length of the separation."""
    sigma: float
    """Standard deviation of the solution in its worst direction."""
    table: tuple[float, ...]
    """Log probabilities of the tail, as of ``_log_tail``."""
    probability: float
    """Probability of the hypothesis."""
    name: str
    """Name of the hypothesis."""

    @classmethod
    def of(cls, solution: Solution, part: slice, covariance: FloatArray) -> Self:
        """Return the tail of a part of a solution's error, which has a covariance."""
        apart = float(np.linalg.norm(solution.separation[part]))
        return cls(apart, *_shape_of(covariance), solution.probability, solution.name)

    def length(self, risk: float) -> float:
        """Return the length that the error exceeds with a probability, under this hypothesis alone."""
        if risk >= self.probability:
            return 0.0
        return self.apart + self.sigma * _quantile(self.table, risk / self.probability)


def _level(tails: Sequence[_Tail], risk: float) -> tuple[float, str]:
    """Return the length that the error exceeds with at most ``risk``, and the hypothesis with most of it.

    The probabilities of all hypotheses at this length add up to the risk. A hypothesis that is less probable
    than what the others leave of it has no part in the level.
    """
    low = max(tail.length(risk) for tail in tails)
    high = max(low, *(tail.length(risk / len(tails)) for tail in tails))
    for _ in range(_HALVINGS):
        between = 0.5 * (low + high)
        enough = sum(_above(tails, between)) <= risk
        low, high = (low, between) if enough else (between, high)
    parts = _above(tails, high)
    return high, tails[parts.index(max(parts))].name


def _above(tails: Sequence[_Tail], length: float) -> list[float]:
    """Return the probabilities that a hypothesis is true and the error above a length, for each one."""
    found = []
    for apart, sigma, table, probability, _ in tails:  # many times for each frame: no calls
        place = (length - apart) / sigma / _STEP
        if place <= 0.0:
            found.append(probability)
            continue
        lower = min(int(place), len(table) - 2)
        low, high = table[lower], table[lower + 1]
        found.append(probability * exp(low + (high - low) * (place - lower)))
    return found


def _shape_of(covariance: FloatArray) -> tuple[float, tuple[float, ...]]:
    """Return the standard deviation of a vector in its worst direction, and the table of its tail."""
    sigma = np.sqrt(np.linalg.eigvalsh(covariance).clip(0.0))
    if not sigma[2] > 0.0:
        return _NO_LENGTH, _log_tail(0.0, 0.0)
    least, middle = (ceil(_RATIOS * ratio - _ROUNDING) for ratio in sigma[:2] / sigma[2])
    return float(sigma[2]), _log_tail(middle / _RATIOS, least / _RATIOS)


def _quantile(table: tuple[float, ...], probability: float) -> float:
    """Return the place in a table at which the tail has a probability, in standard deviations."""
    wanted = log(probability)
    upper = min(max(bisect(table, -wanted, key=neg), 1), len(table) - 1)
    low, high = table[upper - 1], table[upper]
    return _STEP * max(upper - 1 + (wanted - low) / (high - low), 0.0)


@cache
def _log_tail(middle: float, least: float) -> tuple[float, ...]:
    """Return the log probabilities that (z1, middle z2, least z3) is longer than each place of a table.

    z is standard normal. With z = rho u, u on the unit sphere, the length is rho g(u). Length and direction
    of z are independent, so that P(|x| > r) is the mean of P(rho > r / g(u)) over the sphere, an octant of it
    for symmetry. Between two places the logarithm lies above the chord by at most an eighth of the step's
    square, which is added.
    """
    height, weight = _nodes()
    angle = 0.5 * np.pi * height
    around = (middle * np.cos(angle)) ** 2 + (least * np.sin(angle)) ** 2
    g = np.sqrt(height[:, None] ** 2 + (1.0 - height[:, None] ** 2) * around)
    x = np.arange(0.0, _MOST, _STEP)[:, None, None] / g  # P(rho > x) of chi with three degrees of freedom
    beyond = 2.0 * ndtr(-x) + np.sqrt(2.0 / np.pi) * x * np.exp(-0.5 * x**2)
    log_tail = np.log(np.einsum("i,kij,j->k", weight, beyond, weight)) + 0.125 * _STEP**2
    return tuple(np.minimum(log_tail, 0.0).tolist())


@cache
def _nodes() -> tuple[FloatArray, FloatArray]:
    """Return places and weights of the quadrature from 0 to 1, shape (N,) each."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    return 0.5 * (nodes + 1.0), 0.5 * weights


@cache
def chi2_limit(probability: float, dof: float) -> float:
    """Return the value that chi-squared exceeds with a probability."""
    return float(chdtri(dof, probability))
