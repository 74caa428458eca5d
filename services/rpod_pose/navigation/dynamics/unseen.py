"""The acceleration that a target may have in directions which no frame measures.

A frame may leave directions of the pose open: of a face that fills the image, no pixel shows the turn about
its normal. While the target accelerates in the directions that are measured, the same robot or body may
accelerate it in the open ones, with as much as a mission allows. No innovation shows this, so that no factor
on the densities (``manoeuvre``) follows. A white acceleration would not do either: it turns a target by far
less within a second than one that lasts.

So this acceleration is a considered block of the filter: a first-order Gauss-Markov process (R. A. Singer,
Estimating optimal tracking filter performance for manned maneuvering targets, IEEE Trans. Aerosp. Electron.
Syst. 6(4), 1970), which moves pose and twist in the open directions alone. It begins when the gate refuses a
pose that its frame proves, and has then acted unnoticed for a while. It is not driven any more when the
measured directions are calm again. Where frames leave nothing open, there is no such block.
"""

from math import radians

import numpy as np

from rpod_pose.navigation.dynamics.manoeuvre import LAG_S, MOST_DEG_S2, UNNOTICED_S, greatest
from rpod_pose.navigation.filter import (
    ATTITUDE,
    CALM,
    MOST_M_S2,
    POSITION,
    UNSEEN,
    Block,
    FilterState,
    Innovation,
    grown,
    pushed,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import rotation_matrix


def with_unseen(
    before: FilterState, after: FilterState, found: Innovation, config: FilterConfig
) -> FilterState:
    """Return a state after an accepted pose with the acceleration that may act in open directions.

    Args:
        before: the state after the previous measurement.
        after: the state after the pose.
        found: innovation of the pose, with the covariance of its errors.
        config: the filter's configuration.
    """
    is_known = UNSEEN in after.places()
    if after.manoeuvre == CALM and not is_known:
        return after
    spread = _open(before, after, found, config)
    if not spread.any():
        return after.without(UNSEEN) if is_known else after
    driven = np.full(6, 0.0 if after.manoeuvre == CALM else 1.0)
    block = Block(UNSEEN, np.zeros(6), driven, time_constant_s=LAG_S, considered=True, spread=spread)
    state = grown(after, (block,))
    return state if is_known else pushed(state, UNNOTICED_S)


def _open(before: FilterState, after: FilterState, found: Innovation, config: FilterConfig) -> FloatArray:
    """Return the covariance of the acceleration in the directions that a pose leaves open, shape (6, 6).

    A direction is measured if the standard deviation of the pose is below the way that the greatest
    acceleration moves the target between two poses. Of the variance of the acceleration in any other
    direction, that share counts by which the variance of the pose is above this way squared.
    """
    step_s = max((after.stamp_ns - before.stamp_ns) / NANOSECONDS, UNNOTICED_S)
    errors = found.noise + found.lasting
    errors = after.alike.with_free_variance(errors, rotation_matrix(after.T_chaser_target), 0.0)
    spread = np.zeros((6, 6))
    twist = _twist_variances(step_s, before, config)
    for part, most, variance, raised in zip(
        (POSITION, ATTITUDE), (MOST_M_S2, radians(MOST_DEG_S2)), twist, after.may_be_raised, strict=True
    ):
        if raised:
            values, vectors = np.linalg.eigh(errors[part, part])
            way = 0.5 * most * step_s**2
            share = 1.0 - way**2 / np.maximum(values, way**2)
            spread[part, part] = (vectors * share) @ vectors.T * variance / step_s**2
    return spread


def _twist_variances(step_s: float, before: FilterState, config: FilterConfig) -> tuple[float, float]:
    """Return the variances of velocity and rate of each axis that a mission allows to arise in a step."""
    most = greatest(step_s, before, config)
    return (
        most.acceleration * config.acceleration_density_m2_s3 * step_s,
        most.angular * config.angular_acceleration_density_rad2_s3 * step_s,
    )
