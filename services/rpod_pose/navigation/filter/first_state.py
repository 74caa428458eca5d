"""The first state of the filter, from a measured pose."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform

from rpod_pose.navigation.filter.blocks import Block, placed, variances
from rpod_pose.navigation.filter.correction import NOTHING, Sensitivities, measurement_noise, observable
from rpod_pose.navigation.filter.priors import velocity_sigma_m_s
from rpod_pose.navigation.filter.rotations import cross_matrix, exponential, orthonormal, symmetric
from rpod_pose.navigation.filter.state import (
    ATTITUDE,
    MOTION,
    POSE,
    POSITION,
    RATE,
    VELOCITY,
    FilterState,
    MotionModel,
    with_free_axes_unobserved,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import pose_of, rotation_matrix
from rpod_target import NO_SYMMETRY, Equivalence


def start(
    T_chaser_target: RigidTransform,
    covariance: FloatArray,
    stamp_ns: int,
    *,
    config: FilterConfig,
    centre_of_mass_m: FloatArray | None = None,
    alike: Equivalence = NO_SYMMETRY,
    blocks: Sequence[Block] = (),
    of_blocks: FloatArray | None = None,
    sensitivities: Sensitivities = NOTHING,
    white: bool = False,
    model: MotionModel | None = None,
) -> FilterState:
    """Return the state after a first measured pose, with an unknown twist.

    Args:
        T_chaser_target: measured pose.
        covariance: covariance of its (dp, dtheta), ICD section 1, shape (6, 6).
        stamp_ns: time of the measurement.
        config: noise of the filter.
        centre_of_mass_m: centre of mass of the target, target axes, shape (3,); by default its origin.
            For a target with one free axis only the component along this axis is used, for a sphere none.
        alike: which attitudes of the target no measurement distinguishes.
        blocks: further states.
        of_blocks: covariance of the errors of their values, shape (n, n); None for blocks as before any
            measurement.
        sensitivities: how the measured pose depends on them, as in ``update``.
        white: as in ``update``.
        model: model of the motion; None for constant velocity and rate.
    """
    centre_m = np.zeros(3) if centre_of_mass_m is None else centre_of_mass_m
    if len(alike.free_axes) == 1:
        centre_m = alike.free_axes[0] * (alike.free_axes[0] @ centre_m)
    elif len(alike.free_axes):
        centre_m = np.zeros(3)
    R = rotation_matrix(T_chaser_target)
    covariance = block_diag(
        covariance if white else measurement_noise(covariance, config, R @ centre_m),
        velocity_sigma_m_s(T_chaser_target, config) ** 2 * np.eye(3),
        np.deg2rad(config.initial_rate_sigma_deg_s) ** 2 * np.eye(3),
    )
    if blocks:
        observable_by = {name: observable(by, R, alike) for name, by in sensitivities.items()}
        covariance = _with_blocks(covariance, blocks, observable_by, of_blocks)
        T_chaser_target = _without_known_errors(T_chaser_target, blocks, observable_by)
    from_centre = np.eye(len(covariance))
    from_centre[VELOCITY, RATE] = cross_matrix(R @ centre_m)
    state = FilterState(
        stamp_ns=stamp_ns,
        T_chaser_target=T_chaser_target,
        velocity_m_s=np.zeros(3),
        rate_rad_s=np.zeros(3),
        covariance=symmetric(from_centre @ covariance @ from_centre.T),
        centre_of_mass_m=centre_m,
        alike=alike,
        blocks=tuple(blocks),
        model=model,
    )
    return with_free_axes_unobserved(state, config)


def _with_blocks(
    covariance: FloatArray,
    blocks: Sequence[Block],
    sensitivities: Sensitivities,
    of_blocks: FloatArray | None,
) -> FloatArray:
    """Return the covariance of pose, twist and blocks, shape (12 + n, 12 + n).

    The measured pose is the true one moved by H b and noise. The pose is the measured one less H times the
    known values of b, so that its errors are -H times those of b, and noise.
    """
    whole = block_diag(covariance, np.diag(variances(blocks)) if of_blocks is None else of_blocks)
    moved = np.eye(len(whole))
    for block, place in placed(blocks, MOTION.stop):
        if block.name in sensitivities:
            moved[POSE, place] = -sensitivities[block.name]
    found: FloatArray = moved @ whole @ moved.T
    return found


def _without_known_errors(
    T_measured: RigidTransform, blocks: Sequence[Block], sensitivities: Sensitivities
) -> RigidTransform:
    """Return a measured pose without the errors that the values of blocks explain."""
    known = [block for block in blocks if block.name in sensitivities and block.value.any()]
    if not known:
        return T_measured
    moved = np.sum([sensitivities[block.name] @ block.value for block in known], axis=0)
    R = exponential(-moved[ATTITUDE]) @ rotation_matrix(T_measured)
    return pose_of(orthonormal(R), T_measured.translation - moved[POSITION])
