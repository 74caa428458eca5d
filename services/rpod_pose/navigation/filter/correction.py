"""Update of a state with a measured pose, and comparison of states."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import inf
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import gammainc, gammaincinv

from rpod_pose.navigation.filter.blocks import Block, placed, variances
from rpod_pose.navigation.filter.rotations import cross_matrix, left_jacobian, symmetric
from rpod_pose.navigation.filter.state import (
    ATTITUDE,
    MOTION,
    POSE,
    POSITION,
    FilterState,
    with_free_axes_unobserved,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import rotation_matrix, rotation_of
from rpod_target import Equivalence

Sensitivities = Mapping[str, FloatArray]
"""Derivatives of a measured pose's (dp, dtheta) with respect to the states of blocks, shape (6, size), by the
block's name. The measurement does not depend on a block that is not named."""
NOTHING: Sensitivities = MappingProxyType({})
"""Sensitivities of a pose that depends on no block."""


class Update(NamedTuple):
    """Result of an update with a measurement."""

    state: FilterState
    """State after the update; unchanged if the measurement was rejected."""
    nis: float
    """Normalised innovation squared; NaN if the measurement is not finite."""
    accepted: bool
    innovation: "Innovation"
    """Innovation that the gate has tested."""


class Innovation(NamedTuple):
    """Difference between a measured and a predicted pose, and its covariance."""

    difference: FloatArray
    """(dp, dtheta) from the predicted measurement to the measured pose, shape (6,)."""
    covariance: FloatArray
    """Covariance of the difference, shape (6, 6)."""
    noise: FloatArray
    """Part of ``covariance`` that is the measurement's own noise, shape (6, 6)."""
    lasting: FloatArray
    """Covariance of the errors that the measurement shares with others through the states of blocks, shape
    (6, 6)."""
    H: FloatArray
    """Derivatives of the measurement with respect to the states, shape (6, 12 + n)."""
    cross: FloatArray
    """Covariance of the predicted measurement with the states, shape (6, 12 + n)."""
    left: FloatArray | None = None
    """Covariance of the difference with the errors that an update leaves, shape (6, 12 + n); None where it is
    0, and before an update."""


def innovation_of(
    state: FilterState,
    T_chaser_target: RigidTransform,
    covariance: FloatArray,
    *,
    config: FilterConfig,
    sensitivities: Sensitivities = NOTHING,
    white: bool = False,
    since_s: float = inf,
) -> Innovation:
    """Return the innovation of a measured pose at the state's stamp; arguments as for ``update``."""
    R = rotation_matrix(T_chaser_target)
    arm_m = R @ state.centre_of_mass_m
    noise = covariance if white else measurement_noise(covariance, config, arm_m, since_s)
    # no innovation is left about a free axis; any variance keeps the matrix regular and leaves the gain at 0
    noise = state.alike.with_free_variance(noise, R, 1.0)
    difference = pose_difference(T_chaser_target, state.T_chaser_target, state.alike)
    H, P = np.zeros((6, state.size)), state.covariance
    H[:, POSE], cross = np.eye(6), P[POSE]
    moving = [
        (block, place, observable(sensitivities[block.name], R, state.alike))
        for block, place in placed(state.blocks, MOTION.stop)
        if block.name in sensitivities
    ]
    for block, place, by in moving:
        H[:, place], cross = by, cross + by @ P[place]
        difference = difference - by @ block.value
    predicted, lasting = cross[:, POSE], np.zeros((6, 6))
    for _, place, by in moving:
        predicted = predicted + cross[:, place] @ by.T
        lasting += by @ P[place, place] @ by.T
    return Innovation(difference, predicted + noise, noise, lasting, H, cross)


def grown(state: FilterState, blocks: Sequence[Block]) -> FilterState:
    """Return a state with further blocks at their initial values.

    Blocks that the state already has keep their values, and take the other fields of the given ones.
    """
    given = {block.name: block for block in blocks}
    old = tuple(
        replace(given.pop(block.name), value=block.value) if block.name in given else block
        for block in state.blocks
    )
    if not given:
        return replace(state, blocks=old) if blocks else state
    new = tuple(given.values())
    covariance = block_diag(state.covariance, np.diag(variances(new)))
    return replace(state, covariance=covariance, blocks=(*old, *new))


def separation_of(state: FilterState, other: FilterState) -> FloatArray:
    """Return (dp, dtheta) from another filter's pose to a state's, at the same stamp, shape (6,)."""
    return pose_difference(state.T_chaser_target, other.T_chaser_target, state.alike)


def update(
    state: FilterState,
    T_chaser_target: RigidTransform,
    covariance: FloatArray,
    *,
    config: FilterConfig,
    sensitivities: Sensitivities = NOTHING,
    white: bool = False,
    since_s: float = inf,
) -> Update:
    """Return the state after a pose measured at the state's stamp, unless the gate rejects it.

    Attitudes that no measurement distinguishes from the measured one are equivalent to it: the nearest of
    them is used, and the angle about a free axis is ignored. Considered blocks have a gain of zero.
    Therefore the covariance is computed in Joseph's form, which holds for any gain.

    Args:
        state: state predicted to the measurement's stamp.
        T_chaser_target: the measured pose.
        covariance: covariance of its (dp, dtheta), ICD section 1, shape (6, 6), without the errors that are
            states of blocks; the pose is rejected if it is not finite.
        config: noise floor, inflation and gate.
        sensitivities: how the measured pose depends on the states of blocks.
        white: whether the covariance is that of noise alone; then it gets neither floors nor inflation.
        since_s: time since the sensor's previous frame, s, on which the inflation depends.
    """
    found = innovation_of(
        state,
        T_chaser_target,
        covariance,
        config=config,
        sensitivities=sensitivities,
        white=white,
        since_s=since_s,
    )
    innovation, S, noise, H, cross = found.difference, found.covariance, found.noise, found.H, found.cross
    if not (np.isfinite(innovation).all() and np.isfinite(noise).all()):
        return Update(state, float("nan"), accepted=False, innovation=found)

    nis = float(innovation @ np.linalg.solve(S, innovation))
    if not 0.0 <= nis <= gate_nis(state, config):  # negative: the covariance is not positive definite
        return Update(state, nis, accepted=False, innovation=found)

    gain = np.linalg.solve(S, cross).T
    for block, place in placed(state.blocks, MOTION.stop):
        if block.considered:
            gain[place] = 0.0
    correction = gain @ innovation
    reset = np.eye(state.size)
    reset[ATTITUDE, ATTITUDE] = left_jacobian(correction[ATTITUDE])
    keep = np.eye(state.size) - gain @ H
    joseph = keep @ state.covariance @ keep.T + gain @ noise @ gain.T
    sums = (state.sums[0].moved(reset @ keep), state.sums[1].moved(reset @ keep))
    corrected = replace(
        state.corrected(correction), covariance=symmetric(reset @ joseph @ reset.T), sums=sums
    )
    if any(block.considered for block in state.blocks):  # else it is uncorrelated with what is left
        found = found._replace(left=(noise @ gain.T - cross @ keep.T) @ reset.T)
    return Update(with_free_axes_unobserved(corrected, config), nis, accepted=True, innovation=found)


def is_consistent(state: FilterState, other: FilterState, config: FilterConfig) -> bool:
    """Return whether another filter's pose at the same stamp lies within the gate of a state.

    The other filter has used the same measurements and more, so that the covariance of the difference is at
    most the state's own.
    """
    difference = pose_difference(other.T_chaser_target, state.T_chaser_target, state.alike)
    R = rotation_matrix(state.T_chaser_target)
    covariance = state.alike.with_free_variance(state.covariance[POSE, POSE].copy(), R, 1.0)
    nis = float(difference @ np.linalg.solve(covariance, difference))
    return 0.0 <= nis <= gate_nis(state, config)


def gate_nis(state: FilterState, config: FilterConfig) -> float:
    """Return the largest accepted normalised innovation squared, for the state's degrees of freedom."""
    return gate_of(config, state.alike.dof)


def gate_of(config: FilterConfig, dof: int) -> float:
    """Return the largest accepted normalised square with ``dof`` degrees of freedom."""
    return _gate(config.tuning.gate_nis, dof)


def measurement_noise(
    covariance: FloatArray, config: FilterConfig, arm_m: FloatArray, since_s: float = inf
) -> FloatArray:
    """Return the covariance of a measured pose after floors and inflation, shape (6, 6).

    The floors hold at the centre of mass. A floor of the attitude turns the target about it, and moves the
    origin. So estimates do not depend on where a file has its origin, and an acceleration of the centre is
    not taken for a turn about the origin.

    Args:
        covariance: covariance of the measured (dp, dtheta), shape (6, 6).
        config: floors and inflation.
        arm_m: from the target's origin to its centre of mass, chaser axes, m, shape (3,).
        since_s: time since the sensor's previous frame, s.
    """
    floor = np.diag(np.repeat([config.position_floor_m**2, np.deg2rad(config.attitude_floor_deg) ** 2], 3))
    from_centre = np.eye(6)
    from_centre[POSITION, ATTITUDE] = cross_matrix(arm_m)
    added: FloatArray = from_centre @ floor @ from_centre.T
    return config.inflation(since_s) * (covariance + added)


def observable(sensitivity: FloatArray, R: FloatArray, alike: Equivalence) -> FloatArray:
    """Return a sensitivity, shape (6, size), without rotations about free axes.

    Args:
        sensitivity: derivatives of (dp, dtheta).
        R: rotation matrix of the target, shape (3, 3).
        alike: which attitudes no measurement distinguishes.
    """
    if not len(alike.free_axes):
        return sensitivity
    axes, kept = alike.free_axes @ R.T, sensitivity.copy()
    kept[ATTITUDE] -= axes.T @ (axes @ sensitivity[ATTITUDE])
    return kept


def pose_difference(
    T_measured: RigidTransform, T_estimated: RigidTransform, alike: Equivalence
) -> FloatArray:
    """Return (dp, dtheta) from the estimated to the nearest measured pose, shape (6,), m and rad."""
    if alike.is_trivial:
        between = rotation_matrix(T_measured) @ rotation_matrix(T_estimated).T
        turn_rad = Rotation.from_matrix(between, assume_valid=True).as_rotvec()
    else:
        estimated = rotation_of(T_estimated)
        measured = alike.nearest(rotation_of(T_measured), estimated)
        turn_rad = (measured * estimated.inv()).as_rotvec()
    return np.concatenate([T_measured.translation - T_estimated.translation, turn_rad])


@cache
def _gate(gate_nis: float, dof: int) -> float:
    """Return the quantile of chi-squared whose probability is that of the gate with 6 degrees of freedom."""
    return gate_nis if dof == 6 else 2.0 * float(gammaincinv(dof / 2.0, float(gammainc(3.0, gate_nis / 2.0))))
