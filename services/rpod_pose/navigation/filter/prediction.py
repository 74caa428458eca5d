"""Prediction of a state to a later time, by a model of motion.

A model of motion (``MotionModel``) gives the state after a step, and the propagation of its errors e. The
errors after the step are A (F e + q), where q is noise of covariance Q. A, F and Q have the shape
(12 + n, 12 + n). A model with states of its own fills their rows and columns; ``of_blocks`` fills those of
the other blocks.
"""

from dataclasses import replace
from math import hypot

import numpy as np

from rpod_pose.errors import PoseError
from rpod_pose.navigation.filter.blocks import UNSEEN, placed, propagated_blocks, root_of, step_of
from rpod_pose.navigation.filter.rotations import cross_matrix, exponential, left_jacobian, symmetric
from rpod_pose.navigation.filter.state import (
    ATTITUDE,
    CALM,
    MOTION,
    POSE,
    POSITION,
    RATE,
    TWIST,
    VELOCITY,
    FilterState,
    Manoeuvre,
    Motion,
    with_free_axes_unobserved,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import pose_of, rotation_matrix


class StampOrderError(PoseError):
    """A prediction to a stamp before the state's own."""

    def __init__(self, state_ns: int, asked_ns: int) -> None:
        super().__init__(
            f"stamp_ns: a state of {state_ns} ns cannot be predicted back to {asked_ns} ns; "
            "start from an earlier state (History.before)"
        )


def predict(state: FilterState, stamp_ns: int, config: FilterConfig) -> FilterState:
    """Return the state at a later stamp.

    Raises:
        StampOrderError: the stamp is earlier than the state's.
    """
    if stamp_ns < state.stamp_ns:
        raise StampOrderError(state.stamp_ns, stamp_ns)
    if stamp_ns == state.stamp_ns:
        return state
    step_s = (stamp_ns - state.stamp_ns) * 1e-9
    moved, F, noise, after = (state.model or constant_twist)(state, step_s, _raised(config, state.factors))
    F += _push(moved, step_s)
    covariance = F @ state.covariance @ F.T + noise
    if after is not None:
        F, covariance = after @ F, after @ covariance @ after.T
    sums = (state.sums[0].moved(F), state.sums[1].moved(F))
    return with_free_axes_unobserved(
        replace(moved, stamp_ns=stamp_ns, covariance=symmetric(covariance), sums=sums), config
    )


def pushed(state: FilterState, time_s: float) -> FilterState:
    """Return a state whose unseen acceleration has acted for a time already, unknown to its covariance."""
    by = np.eye(state.size) + _push(state, time_s)
    sums = (state.sums[0].moved(by), state.sums[1].moved(by))
    return replace(state, covariance=symmetric(by @ state.covariance @ by.T), sums=sums)


def _push(state: FilterState, time_s: float) -> FloatArray | float:
    """Return what errors of the unseen acceleration add to those of pose and twist in a time.

    It acts on the centre of mass: an angular acceleration moves the target's origin about it.
    """
    for block, place in placed(state.blocks, MOTION.stop):
        if block.name == UNSEEN and block.spread is not None:
            by, root = np.zeros((state.size, state.size)), root_of(block.spread)
            arm_m = rotation_matrix(state.T_chaser_target) @ state.centre_of_mass_m
            root[POSITION] += cross_matrix(arm_m) @ root[ATTITUDE]
            by[POSE, place], by[TWIST, place] = 0.5 * time_s**2 * root, time_s * root
            return by
    return 0.0


def _raised(config: FilterConfig, manoeuvre: Manoeuvre) -> FilterConfig:
    """Return a configuration whose densities of accelerations are raised by factors."""
    if manoeuvre == CALM:
        return config
    densities = {
        "acceleration_density_m2_s3": manoeuvre.acceleration * config.acceleration_density_m2_s3,
        "angular_acceleration_density_rad2_s3": manoeuvre.angular
        * config.angular_acceleration_density_rad2_s3,
    }
    return config.model_copy(update=densities)


def constant_twist(state: FilterState, step_s: float, config: FilterConfig) -> Motion:
    """Return the motion with a constant velocity of the centre of mass and a constant rate.

    Both are random walks. With phi = w dt the error propagates, to first order in itself and exactly in phi,
    as dtheta+ = Exp(phi) dtheta + J_l(phi) dt dw (J_l is the left Jacobian of SO(3)). The centre of mass is
    at R r from the origin, and the origin's rotation about it is deterministic. So the state is transformed
    to the centre by p + R r and v + w x R r, propagated, and transformed back. With a = [R r]x before and
    b = [R r]x after the step, errors at the centre are 1 + N(a) times those at the origin. N(a) has -a for
    (dp by dtheta) and (dv by dw), and -[w]x a for (dv by dtheta). F is (1 - N(b)) A (1 + N(a)), block by
    block; A propagates errors at the centre.
    """
    spin, R = cross_matrix(state.rate_rad_s), rotation_matrix(state.T_chaser_target)
    phi = state.rate_rad_s * step_s
    turn, slope = exponential(phi), step_s * left_jacobian(phi)
    arm_m = R @ state.centre_of_mass_m
    arm_after_m = turn @ arm_m
    centre_m_s = state.velocity_m_s + spin @ arm_m

    turned_rad = turn_of_view_rad(state, step_s)
    F, Q = of_blocks(state, step_s, turned_rad)
    arm, arm_after = cross_matrix(arm_m), cross_matrix(arm_after_m)
    swing, swing_after = spin @ arm, spin @ arm_after
    F[POSITION, ATTITUDE] = arm_after @ turn - arm - step_s * swing
    F[POSITION, VELOCITY] = step_s * np.eye(3)
    F[POSITION, RATE] = arm_after @ slope - step_s * arm
    F[ATTITUDE, ATTITUDE], F[ATTITUDE, RATE] = turn, slope
    F[VELOCITY, ATTITUDE] = swing_after @ turn - swing
    F[VELOCITY, RATE] = swing_after @ slope + arm_after - arm
    from_centre = np.eye(12)
    from_centre[POSITION, ATTITUDE] = from_centre[VELOCITY, RATE] = arm_after
    from_centre[VELOCITY, ATTITUDE] = swing_after
    noise = process_noise(
        step_s, config.acceleration_density_m2_s3, config.angular_acceleration_density_rad2_s3
    )
    Q[MOTION, MOTION] = from_centre @ noise @ from_centre.T
    moved = replace(
        state,
        T_chaser_target=pose_of(
            turn @ R, state.T_chaser_target.translation + arm_m + centre_m_s * step_s - arm_after_m
        ),
        velocity_m_s=centre_m_s - spin @ arm_after_m,
        blocks=propagated_blocks(state.blocks, step_s, turned_rad),
    )
    return Motion(moved, F, Q, None)


def of_blocks(state: FilterState, step_s: float, turned_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return F and Q of a step, shape (12 + n, 12 + n), with the entries of the blocks alone.

    For the twelve states of pose and twist, this F is the identity and this Q is zero. ``turned_rad`` is
    ``turn_of_view_rad`` of the step.
    """
    F, Q = np.eye(state.size), np.zeros((state.size, state.size))
    if state.blocks:
        kept, noise = step_of(state.blocks, step_s, turned_rad)
        own = np.arange(MOTION.stop, state.size)
        F[own, own], Q[own, own] = kept, noise
    return F, Q


def turn_of_view_rad(state: FilterState, step_s: float) -> float:
    """Return the angle by which the view of the target changes in a step, rad.

    The line of sight begins at the chaser's origin. Relative to it, the target turns at w minus the line's
    own rate p x v / p^2. The image also changes its size, at the relative rate p . v / p^2. At the rim of the
    target this moves the image as far as a rotation at that rate.
    """
    (x, y, z), (u, v, w) = state.T_chaser_target.translation.tolist(), state.velocity_m_s.tolist()
    p, q, r = state.rate_rad_s.tolist()
    squared = max(x * x + y * y + z * z, 1e-12)
    across = p - (y * w - z * v) / squared, q - (z * u - x * w) / squared, r - (x * v - y * u) / squared
    return hypot(*across, (x * u + y * v + z * w) / squared) * step_s


def process_noise(step_s: float, acceleration_m2_s3: float, angular_rad2_s3: float) -> FloatArray:
    """Return the process noise of a step by white accelerations of two spectral densities, shape (12, 12)."""
    density = np.array([acceleration_m2_s3] * 3 + [angular_rad2_s3] * 3)
    Q, pose, twist = np.zeros((12, 12)), np.arange(6), np.arange(6, 12)
    Q[pose, pose] = step_s**3 / 3.0 * density
    Q[pose, twist] = Q[twist, pose] = step_s**2 / 2.0 * density
    Q[twist, twist] = step_s * density
    return Q
