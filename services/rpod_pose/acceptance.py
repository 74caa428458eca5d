"""The belief in a registration from its residuals, for methods without a statistical model of their sensor.

f_MAX is the 2015 paper's failure detection (section 4.5). Alone it accepts wrong poses on sparse scans.
Therefore the share of inliers is checked too, and the share of rays or pixels on which model and measurement
agree.
"""

import math
from dataclasses import replace

import numpy as np

from rpod_pose.belief import Belief, contradicted, doubtful
from rpod_pose.ports import Registration
from rpod_schemas.config.acceptance import AcceptanceConfig


def accepted_by_residuals(
    registration: Registration, limits: AcceptanceConfig, *, max_cost_m2: float = math.inf
) -> Registration:
    """Return a registration with the belief that follows from cost, inliers and self-check.

    A registration without a pose is returned unchanged. A share that is NaN, because the method does not
    know it, is not checked.

    Args:
        registration: the registration.
        limits: limits of cost, inliers and self-check.
        max_cost_m2: largest cost, m2, if the limits leave it out.
    """
    most_m2 = max_cost_m2 if limits.max_cost_m2 is None else limits.max_cost_m2
    if registration.T_sensor_target is None:
        return registration
    if registration.inliers < limits.min_inliers:
        reason = f"{registration.inliers} inliers, {limits.min_inliers} needed"
        return replace(registration, T_sensor_target=None, belief=doubtful(reason))
    return replace(registration, belief=_belief(registration, limits, most_m2))


def _belief(registration: Registration, limits: AcceptanceConfig, max_cost_m2: float) -> Belief:
    cost, inliers = registration.cost_m2, registration.inliers
    share, explained = registration.inlier_share, registration.explained_share
    evidence = {"cost_m2": cost, "inliers": inliers, "inlier_share": share, "explained_share": explained}
    if not np.isfinite(registration.covariance).all():
        return contradicted("no covariance", **evidence)
    if not cost <= max_cost_m2:
        return contradicted(f"cost {cost:.2g} m2 above {max_cost_m2:.2g} m2", **evidence)
    if share < limits.min_inlier_share:
        return contradicted(f"inlier share {share:.2f} below {limits.min_inlier_share:.2f}", **evidence)
    if explained < limits.least_tracked_share:
        return contradicted(_too_little(explained, limits.least_tracked_share), **evidence)
    insufficient = ""
    if not math.isnan(explained) and explained < limits.min_explained_share:
        insufficient = _too_little(explained, limits.min_explained_share)
    return Belief(evidence=evidence, insufficient=insufficient)


def _too_little(explained: float, least: float) -> str:
    return f"explained share {explained:.2f} below {least:.2f}"
