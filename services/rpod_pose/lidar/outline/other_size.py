"""Registration of a scan with a target that is larger or smaller than its model.

A target that is k times as large, seen at a range r, gives the same scan as the model at r / k, but for the
ranges, which are k times as long. So the model is registered with ranges, noise and place divided by k: no
other model is needed. Ranges of facets alone hardly tell a size, since a shift along the line of sight
explains most of it. The outline does, so that this uses the likelihood of all rays.

Likelihoods of returns are densities of their ranges. Those of ranges divided by k are k times as large, so
that each return's logarithm is reduced by log k before two sizes are compared.
"""

from math import log

import numpy as np

from rpod_pose.lidar.scan_alignment import FaceProblem
from rpod_pose.lidar.scan_likelihood import Assumptions
from rpod_pose.lidar.scan_registration import Reach, ScanRegistration, outline_mean
from rpod_pose.ports import OtherSize
from rpod_pose.registration.lie_group import PoseArrays, step_between
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import pose_of

SHARE = 0.03
"""Share by which another size differs. Hand: models of satellites are right within 1 to 3 % of their size (as
``slack_share`` of the scan's model)."""
SIGMAS = 4.0
"""Standard deviations of the size, as the target's file declares it, by which another size differs if that is
more. Physics: one in 16,000 normal errors is larger."""


def other_sizes(
    problem: FaceProblem,
    found: ScanRegistration,
    range_m: FloatArray,
    assumed: Assumptions,
    reach: Reach,
    *,
    scale_tolerance: float,
) -> tuple[OtherSize, ...]:
    """Return the registrations with a smaller and with a larger target; without one that has no solution.

    Args:
        problem: all returns and the target.
        found: the registration with the model's own size.
        range_m: measured range of each ray, 0 without a return, negative where something hides the target,
            shape (rows, columns).
        assumed: statistics of returns.
        reach: what the outline can tell.
        scale_tolerance: standard deviation of the size, as a share, that the target's file declares.
    """
    most = max(SHARE, SIGMAS * scale_tolerance)
    returns = int(np.count_nonzero(range_m > 0.0))
    sizes = []
    for share in (-most, most):
        k = 1.0 + share
        start = PoseArrays(found.pose.R, found.pose.t / k)
        shorter_m = (range_m / k).astype(range_m.dtype)
        scaled = outline_mean(_shorter(problem, k), start, shorter_m, _shorter_statistics(assumed, k), reach)
        R, t = scaled.pose
        step = step_between(pose_of(*found.pose), pose_of(R, k * t))
        if np.isfinite(step).all():
            log_odds = _log_likelihood(scaled) - returns * log(k) - _log_likelihood(found)
            sizes.append(OtherSize(share, log_odds, step))
    return tuple(sizes)


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
