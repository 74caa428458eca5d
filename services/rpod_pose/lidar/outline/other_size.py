"""Registration of a scan with a target that is larger or smaller than its model.

A target that is k times as large, at a range r, gives the same scan as the model at r / k, except that its
ranges are k times as long. So the model is registered with ranges, noise and position divided by k: no other
model is needed. The ranges on the faces alone hardly determine the size, since a shift along the line of
sight explains most of a difference. The outline determines it. Therefore the likelihood of all rays is used.

A beam that is wider than assumed also makes a target look larger, in all scans in the same way. So however
many scans prefer a larger target, their log odds are limited to those against an outline that is off by half
a beam.

Likelihoods of returns are densities of their ranges. The densities of ranges divided by k are k times as
large. So log k is subtracted for each return before two sizes are compared.
"""

from dataclasses import dataclass
from functools import partial
from math import inf, log
from typing import Any

import numpy as np

from rpod_pose.lidar.scan_alignment import FaceProblem
from rpod_pose.lidar.scan_likelihood import HALF_BEAM_RAD, Assumptions
from rpod_pose.lidar.scan_registration import Reach, ScanRegistration, outline_mean
from rpod_pose.pose_evidence import OtherSize
from rpod_pose.registration.lie_group import PoseArrays, step_between
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import pose_of

SHARE = 0.03
"""Least relative difference of the tested sizes. Hand: models of satellites are right within 1 to 3 % of
their size (as ``slack_share`` of the scan's model)."""
SIGMAS = 4.0
"""Least difference of the tested sizes in standard deviations of the size, which the target's file declares.
Physics: one in 16,000 normal errors is larger."""

NEAR = 1.0 / 3.0
"""Difference of the sizes that are near the model's own, over the least difference that a test asks for.
Numerics: the levels contain sizes up to two thirds of it, of which this is the middle."""


@dataclass(frozen=True, eq=False)
class OtherSizes:
    """Registers a scan with smaller and with larger targets when it is called.

    A pose does not move in proportion to the size: with a model 1 % too large it may be turned as far as with
    one 3 % too large. So sizes near the model's own are registered too.

    When it is sent to another process, the results are sent: the scan and the target have many megabytes.
    """

    problem: FaceProblem
    """All returns and the target."""
    found: ScanRegistration
    """The registration with the model's own size."""
    range_m: FloatArray
    """Measured range of each ray, 0 without a return, negative where something hides the target, shape
    (rows, columns)."""
    assumed: Assumptions
    """Statistics of returns."""
    reach: Reach
    """Limits of predictions, and the resolution of the outline."""
    scale_tolerance: float
    """Relative standard deviation of the size, which the target's file declares."""

    def __call__(self) -> tuple[OtherSize, ...]:
        """Return the poses for two smaller and two larger sizes, without those that have no solution."""
        most = max(SHARE, SIGMAS * self.scale_tolerance)
        tested = (self._of(share, self._most_log_odds(share)) for share in (-most, most))
        near = (self._of(share, inf, tests=False) for share in (-NEAR * most, NEAR * most))
        sizes = (*tested, *near)
        return tuple(size for size in sizes if np.isfinite(size.step).all())

    def __reduce__(self) -> tuple[type[partial[tuple[OtherSize, ...]]], tuple[Any, ...]]:
        return partial, (tuple, self())

    def _of(self, share: float, most_log_odds: float, *, tests: bool = True) -> OtherSize:
        """Return the pose for a target that is larger by ``share``; its step is not finite if none fits."""
        k, (R, t) = 1.0 + share, self.found.pose
        shorter_m = (self.range_m / k).astype(self.range_m.dtype)
        statistics = _shorter_statistics(self.assumed, k)
        scaled = outline_mean(
            _shorter(self.problem, k), PoseArrays(R, t / k), shorter_m, statistics, self.reach
        )
        step = step_between(pose_of(R, t), pose_of(scaled.pose.R, k * scaled.pose.t))
        returns = int(np.count_nonzero(self.range_m > 0.0))
        log_odds = _log_likelihood(scaled) - returns * log(k) - _log_likelihood(self.found)
        return OtherSize(share, log_odds, step, most_log_odds, tests)

    def _most_log_odds(self, share: float) -> float:
        """Return the limit of the log odds: a beam that is wider than assumed also widens the outline."""
        if share <= 0.0:
            return inf
        sigma_m = HALF_BEAM_RAD * float(np.linalg.norm(self.found.pose.t))
        return 0.5 * (share * self.reach.radius_m / sigma_m) ** 2


def _log_likelihood(found: ScanRegistration) -> float:
    return found.statistics.agreement.log_likelihood


def _shorter(problem: FaceProblem, k: float) -> FaceProblem:
    """Return a problem whose lengths along the rays are divided by k."""
    errors = problem.errors._replace(
        sigma_m=problem.errors.sigma_m / k,
        slack_m=problem.errors.slack_m / k,
        per_outline_m=problem.errors.per_outline_m * k,
    )
    return problem._replace(points_m=problem.points_m / k, errors=errors, scales_m=problem.scales_m / k)


def _shorter_statistics(assumed: Assumptions, k: float) -> Assumptions:
    """Return the statistics of returns whose ranges are divided by k."""
    return assumed._replace(
        sigma_m=assumed.sigma_m / k,
        slack_m=assumed.slack_m / k,
        clutter_density=assumed.clutter_density * k,
        least_range_m=assumed.least_range_m / k,
    )
