"""Protection levels from solutions with and without a part of the measurements.

The error of an estimate is above its level, without an alert, with at most the probability ``risk``. Each
fault hypothesis is a solution x_k without the measurements that would be wrong under it; x_0 uses all. If x_k
is right, the error of x_0 is at most its separation from x_k and the error of x_k. Hence the level

    max over k of |x_0 - x_k| + K(p_k) sigma_k,

where p_k is the part of the risk over the probability of the hypothesis, and K the quantile of the length of
a normal vector with the standard deviation sigma_k along each of its three axes. Here sigma_k is that of the
worst direction, so the level is a sphere's radius, and larger than needed for a flat covariance.

Sources: R. G. Brown, A baseline GPS RAIM scheme and a note on the equivalence of three RAIM methods,
Navigation 39(3), 1992; B. W. Parkinson and P. Axelrad, Autonomous GPS integrity monitoring using the
pseudorange residual, Navigation 35(2), 1988 (the residual tests); J. Blanch et al., Baseline Advanced RAIM
user algorithm and possible improvements, IEEE Trans. Aerosp. Electron. Syst. 51(1), 2015 (separations and
the allocation of the risk). Words of the result as in RTCA DO-229: protection level, alert limit, misleading.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import degrees, hypot

import numpy as np
from scipy.special import chdtri, gammainccinv

from rpod_pose.belief import worst_sigma
from rpod_pose.navigation.filter import ATTITUDE, POSE, POSITION, FilterState, separation_of
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.integrity import IntegrityConfig


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution under a hypothesis of what is wrong, at the stamp of the estimate."""

    name: str
    """What it leaves out; empty for the one with all measurements."""
    separation: FloatArray
    """(dp, dtheta) from it to the estimate, m and rad, shape (6,)."""
    covariance: FloatArray
    """Covariance of its pose, shape (6, 6)."""
    probability: float = 1.0
    """Probability of the hypothesis."""


@dataclass(frozen=True)
class Levels:
    """Protection levels, and the solutions from which they follow."""

    attitude_deg: float
    position_m: float
    attitude_by: str
    position_by: str


def solution(name: str, estimate: FilterState, other: FilterState, probability: float) -> Solution:
    """Return another filter's state, at the same stamp, as a solution beside the estimate."""
    return Solution(name, separation_of(estimate, other), other.covariance[POSE, POSE], probability)


def protection_levels(
    solutions: Sequence[Solution],
    config: IntegrityConfig,
    *,
    range_m: float,
    speed_m_s: float,
    rate_rad_s: float,
) -> Levels:
    """Return the levels of an estimate; half of the risk is that of the attitude.

    Args:
        solutions: the solution with all measurements first, then those of the fault hypotheses.
        config: risk and declared standard deviations.
        range_m: distance of the target's origin from the sensor.
        speed_m_s: speed of the target's origin, by which an error of the clock moves it.
        rate_rad_s: rate of the target, by which an error of the clock turns it.
    """
    mount_rad = np.deg2rad(config.mount_sigma_deg)
    drift_m = config.tuning.range_share * range_m
    unseen_m = hypot(config.mount_sigma_m, mount_rad * range_m, config.clock_sigma_s * speed_m_s, drift_m)
    unseen_rad = hypot(mount_rad, config.clock_sigma_s * rate_rad_s)
    position_m, position_by = _greatest(solutions, POSITION, unseen_m, 0.5 * config.risk)
    attitude_rad, attitude_by = _greatest(solutions, ATTITUDE, unseen_rad, 0.5 * config.risk)
    return Levels(min(degrees(attitude_rad), 180.0), position_m, attitude_by, position_by)


def _greatest(solutions: Sequence[Solution], part: slice, unseen: float, risk: float) -> tuple[float, str]:
    """Return the greatest level of the solutions, and the name of its solution.

    Half of the risk is that of the solution with all measurements, the others share the rest.
    """
    shares = (0.5 * risk, *[0.5 * risk / max(len(solutions) - 1, 1)] * (len(solutions) - 1))
    return max(
        (
            float(np.linalg.norm(each.separation[part]))
            + _length_quantile(min(share / each.probability, 1.0))
            * hypot(worst_sigma(each.covariance[part, part]), unseen),
            each.name,
        )
        for each, share in zip(solutions, shares, strict=True)
    )


@cache
def _length_quantile(probability: float) -> float:
    """Return the length that a standard normal vector of three components exceeds with a probability."""
    return float(np.sqrt(2.0 * gammainccinv(1.5, probability)))


@cache
def chi2_limit(probability: float, dof: float) -> float:
    """Return the value that chi-squared exceeds with a probability."""
    return float(chdtri(dof, probability))
