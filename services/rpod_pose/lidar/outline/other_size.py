"""Registration of a scan with a target that is larger or smaller than its model.

A target that is k times as large, seen at a range r, gives the same scan as the model at r / k, but for the
ranges, which are k times as long. So the model is registered with ranges, noise and place divided by k: no
other model is needed. Ranges of facets alone hardly tell a size, since a shift along the line of sight
explains most of it. The outline does, so that this uses the likelihood of all rays.
"""

import numpy as np

from rpod_pose.lidar.scan_alignment import FaceProblem
from rpod_pose.lidar.scan_likelihood import Assumptions
from rpod_pose.lidar.scan_registration import Reach, ScanRegistration, settled
from rpod_pose.ports import OtherSize
from rpod_pose.registration.lie_group import PoseArrays, step_between
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import pose_of

STEP = 0.03
"""Share by which another size differs: models of satellites are right within 1 to 3 % of their size (as
``slack_share`` of the scan's model)."""
DECLARED = 4.0
"""The same, in standard deviations of the size that the target's file declares, if that is more."""


def other_sizes(
    problem: FaceProblem,
    found: ScanRegistration,
    range_m: FloatArray,
    assumed: Assumptions,
    reach: Reach,
    *,
    scale_tolerance: float,
) -> tuple[OtherSize, ...]:
    """Return the registration with a smaller and with a larger target.

    Args:
        problem: all returns and the target.
        found: the registration with the model's own size.
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        assumed: statistics of returns.
        reach: what the outline can tell.
        scale_tolerance: standard deviation of the size, as a share, that the target's file declares.
    """
    step = max(STEP, DECLARED * scale_tolerance)
    likelihood = found.statistics.agreement.log_likelihood
    sizes = []
    for share in (-step, step):
        k = 1.0 + share
        start = PoseArrays(found.pose.R, found.pose.t / k)
        shorter_m = (range_m / k).astype(range_m.dtype)
        scaled = settled(_problem(problem, k), start, shorter_m, _assumed(assumed, k), reach)
        R, t = scaled.pose
        moved = step_between(pose_of(*found.pose), pose_of(R, k * t))
        if np.isfinite(moved).all():
            sizes.append(OtherSize(share, scaled.statistics.agreement.log_likelihood - likelihood, moved))
    return tuple(sizes)


def _problem(problem: FaceProblem, k: float) -> FaceProblem:
    """Return a problem whose lengths along the rays are divided by k."""
    errors = problem.errors._replace(
        sigma_m=problem.errors.sigma_m / k,
        slack_m=problem.errors.slack_m / k,
        per_outline_m=problem.errors.per_outline_m * k,
    )
    return problem._replace(points_m=problem.points_m / k, errors=errors, scales_m=problem.scales_m / k)


def _assumed(assumed: Assumptions, k: float) -> Assumptions:
    """Return the statistics of returns whose ranges are divided by k."""
    return assumed._replace(
        sigma_m=assumed.sigma_m / k,
        slack_m=assumed.slack_m / k,
        clutter_density=assumed.clutter_density * k,
        least_range_m=assumed.least_range_m / k,
    )
