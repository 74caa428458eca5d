"""Prediction of a target that moves freely, seen from a chaser that may turn and accelerate.

First the state is transformed to the target's centre of mass, and to axes that are at rest in inertial space
and agree with the chaser's at the start of the step: q = p + R r, u = v + w x R r + o x q, W = w + o. Here r
is the centre of mass in target axes and o the chaser's rate. In these axes the centre moves on a line or on a
relative orbit, minus the displacement of the chaser by its own thrust. The body turns at a constant rate or
without torque. At the end, the chaser's rotation C transforms to its axes, and the inverse relations lead
back to p, v and w. The derivatives follow the same steps. The errors of q, u and W are estimate minus truth,
like those of p, v and w.

Optional further states: offset of the centre of mass from the declared one, ratios of the inertia, biases of
gyro and accelerometer, errors of thrust. A state that no measurement observes keeps its prior.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rpod_pose.navigation.dynamics.chaser import Chaser, ChaserStep
from rpod_pose.navigation.dynamics.relative_orbit import inertial_transition, straight
from rpod_pose.navigation.dynamics.torque_free import (
    FLAT,
    Curvature,
    Inertia,
    Turned,
    constant_rate,
    curvature,
    torque_free,
)
from rpod_pose.navigation.filter.blocks import Block, propagated_blocks
from rpod_pose.navigation.filter.prediction import of_blocks, process_noise, turn_of_view_rad
from rpod_pose.navigation.filter.rotations import cross_matrix, exponential, left_jacobian, orthonormal
from rpod_pose.navigation.filter.state import ATTITUDE, MOTION, POSITION, RATE, VELOCITY, FilterState, Motion
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import pose_of, rotation_matrix

CENTRE_OF_MASS, INERTIA = "centre_of_mass_offset_m", "inertia_ratios"
GYRO_BIAS, ACCELERATION_BIAS = "gyro_bias_rad_s", "acceleration_bias_m_s2"
THRUST_ERRORS = "thrust_errors"
FORCE_ERRORS = (ACCELERATION_BIAS, THRUST_ERRORS)
"""Names of the blocks with the errors of a known acceleration; a model has at most one of them."""
STATES = frozenset({CENTRE_OF_MASS, INERTIA, GYRO_BIAS, *FORCE_ERRORS})
"""Names of the blocks of further states."""

_NONE = np.zeros(3)
"""Value of a bias that is not estimated."""


@dataclass(frozen=True, eq=False)
class _Extras:
    """Values of the further states, and their slices in the covariance if the filter has them."""

    centre_m: FloatArray
    """Centre of mass, target axes, shape (3,)."""
    shape: FloatArray
    """Coefficients of the inertia's ratios, shape (2,), or (0,) if they are not estimated."""
    gyro_rad_s: FloatArray
    """Bias of the gyro, chaser axes, shape (3,)."""
    force: FloatArray
    """Bias of the accelerometer, chaser axes, m/s2, shape (3,), or errors of thrust, shape (4,)."""
    places: dict[str, slice]

    @classmethod
    def of(cls, state: FilterState) -> "_Extras":
        values = {block.name: block.value for block in state.blocks}
        return cls(
            state.centre_of_mass_m + values.get(CENTRE_OF_MASS, _NONE),
            values.get(INERTIA, np.zeros(0)),
            values.get(GYRO_BIAS, _NONE),
            values.get(ACCELERATION_BIAS, values.get(THRUST_ERRORS, _NONE)),
            state.places(),
        )


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """A model of motion (``MotionModel``) of a free target and a chaser whose motion is known."""

    chaser: Chaser
    inertia: Inertia | None = None
    """Inertia of a target that turns without torque; None for a constant rate relative to inertial space."""
    orbit_rate_rad_s: float | None = None
    """Rate of the orbit; None for straight motion."""
    uses_force: bool = True
    """Whether the chaser's specific force is used, as measured or commanded."""
    acceleration_density_m2_s3: float | None = None
    """Spectral density of the accelerations that are not modelled; None for that of the filter."""
    angular_acceleration_density_rad2_s3: float | None = None
    """Spectral density of the angular accelerations that are not modelled; None for that of the filter."""

    @property
    def states_noise(self) -> tuple[bool, bool]:
        """Whether it states the noise of accelerations and of angular accelerations itself."""
        return (
            self.acceleration_density_m2_s3 is not None,
            self.angular_acceleration_density_rad2_s3 is not None,
        )

    def __call__(self, state: FilterState, step_s: float, config: FilterConfig) -> Motion:
        """Return the state after a step, and the propagation of its errors."""
        extras = _Extras.of(state)
        chaser = self.chaser.step(state.stamp_ns, state.stamp_ns + round(step_s * 1e9))
        before_rad_s = chaser.rate_before_rad_s - extras.gyro_rad_s
        after_rad_s = chaser.rate_after_rad_s - chaser.bias_kept * extras.gyro_rad_s

        R, w = rotation_matrix(state.T_chaser_target), state.rate_rad_s
        arm_m = R @ extras.centre_m
        q = state.T_chaser_target.translation + arm_m
        u = state.velocity_m_s + np.cross(w, arm_m) + np.cross(before_rad_s, q)
        W = w + before_rad_s
        to_centre = _to_centre(extras, state.size, _Instant(R, q, arm_m, w, before_rad_s))

        body = self._turned(R.T @ W, extras, step_s)
        curved = self._curved(state, extras, to_centre, R=R, W=W, step_s=step_s)
        body = body._replace(
            turn=body.turn @ exponential(curved.mean[:3]), rate_rad_s=body.rate_rad_s + curved.mean[3:]
        )
        moved = self._transition(chaser, step_s)
        qu = moved @ np.concatenate([q, u])
        if self.uses_force:
            qu[:3] -= chaser.way_m + chaser.way_by_bias @ extras.force
            qu[3:] -= chaser.speed_m_s + chaser.speed_by_bias @ extras.force
        phi = chaser.turn_by_bias @ extras.gyro_rad_s
        C = exponential(phi) @ chaser.turn
        R_after = orthonormal(C @ R @ body.turn)
        q, u, W_after = C @ qu[:3], C @ qu[3:], R_after @ body.rate_rad_s
        turned_rad = turn_of_view_rad(state, step_s)
        F, Q = of_blocks(state, step_s, turned_rad)
        F[MOTION] = _moved(extras, state.size, R=R, C=C, W=W, body=body, moved=moved, chaser=chaser)
        by_turn = _by_turn(q, u, W_after)
        if GYRO_BIAS in extras.places:
            place = extras.places[GYRO_BIAS]
            F[place, place] *= chaser.bias_kept
            Q[place, place] += chaser.bias_noise * np.eye(3)
            F[MOTION, place] += by_turn @ left_jacobian(phi) @ chaser.turn_by_bias
        Q[MOTION, MOTION] = self._noise(chaser, step_s, config) + chaser.turn_variance * by_turn @ by_turn.T
        Q[MOTION, MOTION] += _of_curvature(curved.spread, R_after, W_after)

        arm_m, w = R_after @ extras.centre_m, W_after - after_rad_s
        back = _from_centre(extras, state.size, _Instant(R_after, q, arm_m, w, after_rad_s))
        after = replace(
            state,
            T_chaser_target=pose_of(R_after, q - arm_m),
            velocity_m_s=u - np.cross(after_rad_s, q) - np.cross(w, arm_m),
            rate_rad_s=w,
            blocks=_faded(state, step_s, chaser, turned_rad),
            chaser_rate_variance=chaser.rate_variance,
        )
        return Motion(after, F @ to_centre, Q, back)

    def _turned(self, rate_rad_s: FloatArray, extras: _Extras, step_s: float) -> Turned:
        if self.inertia is None:
            return constant_rate(rate_rad_s, step_s)
        return torque_free(rate_rad_s, self.inertia.shaped(extras.shape), step_s)

    def _curved(
        self,
        state: FilterState,
        extras: _Extras,
        to_centre: FloatArray,
        *,
        R: FloatArray,
        W: FloatArray,
        step_s: float,
    ) -> Curvature:
        """Return the second-order terms of the target's rotation: a mean and a covariance.

        Euler's equations are quadratic in the rate. While rate or inertia is not known well, their second
        order matters: a rate of 8 deg/s that is assumed to be 0 changes by 1 deg/s2.
        """
        if self.inertia is None:
            return FLAT
        place = extras.places.get(INERTIA, slice(0, 0))
        chosen = np.zeros((3 + place.stop - place.start, state.size))
        chosen[:3, ATTITUDE], chosen[:3, RATE] = R.T @ cross_matrix(W), R.T
        chosen[3:, place] = np.eye(place.stop - place.start)
        chosen = chosen @ to_centre
        spread = chosen @ state.covariance @ chosen.T
        sigma = np.sqrt(np.abs(np.diag(spread)))
        bound = (np.linalg.norm(sigma[:3]) + np.linalg.norm(W) * np.linalg.norm(sigma[3:])) ** 2 * step_s
        density = self.angular_acceleration_density_rad2_s3 or 0.0
        if bound < 0.1 * np.sqrt(density * step_s):
            return FLAT
        values, axes = np.linalg.eigh(spread)
        root = axes * np.sqrt(np.maximum(values, 0.0))
        return curvature(R.T @ W, extras.shape, self.inertia, root, step_s)

    def _transition(self, chaser: ChaserStep, step_s: float) -> FloatArray:
        """Return the transition of (q, u); without an orbit or an attitude in it, that of straight motion."""
        if self.orbit_rate_rad_s is None or chaser.R_orbit_chaser is None:
            return straight(step_s)
        return inertial_transition(self.orbit_rate_rad_s, step_s, chaser.R_orbit_chaser.T)

    def _noise(self, chaser: ChaserStep, step_s: float, config: FilterConfig) -> FloatArray:
        """Return the process noise of a step, with that of the filter while turn or thrust are unknown."""
        own, filtered = (
            (self.acceleration_density_m2_s3, self.angular_acceleration_density_rad2_s3),
            (config.acceleration_density_m2_s3, config.angular_acceleration_density_rad2_s3),
        )
        chosen = [one if one is not None else other for one, other in zip(own, filtered, strict=True)]
        noise = process_noise(step_s, *chosen)
        by_force = filtered[0] * chaser.unknown
        if self.uses_force:
            by_force = by_force + chaser.force_noise + filtered[0] * chaser.unforced
        way, mixed, speed = by_force
        noise[POSITION, POSITION] += way * np.eye(3)
        noise[POSITION, VELOCITY] += mixed * np.eye(3)
        noise[VELOCITY, POSITION] += mixed * np.eye(3)
        noise[VELOCITY, VELOCITY] += speed * np.eye(3)
        return noise + process_noise(chaser.unknown[2], 0.0, filtered[1])


def _faded(state: FilterState, step_s: float, chaser: ChaserStep, turned_rad: float) -> tuple[Block, ...]:
    """Return the blocks after a step; the gyro's bias keeps the share that no star tracker has corrected."""
    return tuple(
        replace(block, value=chaser.bias_kept * block.value) if block.name == GYRO_BIAS else block
        for block in propagated_blocks(state.blocks, step_s, turned_rad)
    )


class _Instant(NamedTuple):
    """Pose and rates at the beginning or end of a step, chaser axes."""

    R: FloatArray
    """R_chaser_target, shape (3, 3)."""
    q: FloatArray
    """Position of the centre of mass, shape (3,), m."""
    arm_m: FloatArray
    """Vector from the target's origin to the centre of mass, shape (3,)."""
    w: FloatArray
    """Rate of the target relative to the chaser, shape (3,), rad/s."""
    chaser_rad_s: FloatArray
    """Rate of the chaser relative to inertial space, shape (3,)."""

    @property
    def crosses(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Cross matrices of the arm and of the rates of target and chaser."""
        return cross_matrix(self.arm_m), cross_matrix(self.w), cross_matrix(self.chaser_rad_s)


def _to_centre(extras: _Extras, size: int, at: _Instant) -> FloatArray:
    """Return the Jacobian of (q, theta, u, W, blocks) with respect to the state, shape (12 + n, 12 + n)."""
    arm, spin, own = at.crosses
    T = np.eye(size)
    T[POSITION, ATTITUDE] = -arm
    T[VELOCITY, POSITION] = own
    T[VELOCITY, ATTITUDE] = -(spin + own) @ arm
    T[VELOCITY, RATE] = -arm
    if CENTRE_OF_MASS in extras.places:
        place = extras.places[CENTRE_OF_MASS]
        T[POSITION, place] = at.R
        T[VELOCITY, place] = (spin + own) @ at.R
    if GYRO_BIAS in extras.places:
        place = extras.places[GYRO_BIAS]
        T[VELOCITY, place] = cross_matrix(at.q)
        T[RATE, place] = -np.eye(3)
    return T


def _from_centre(extras: _Extras, size: int, at: _Instant) -> FloatArray:
    """Return the Jacobian of the state with respect to (q, theta, u, W, blocks): ``_to_centre`` inverted."""
    arm, spin, own = at.crosses
    T = np.eye(size)
    T[POSITION, ATTITUDE] = arm
    T[VELOCITY, POSITION] = -own
    T[VELOCITY, ATTITUDE] = spin @ arm
    T[VELOCITY, RATE] = arm
    if CENTRE_OF_MASS in extras.places:
        place = extras.places[CENTRE_OF_MASS]
        T[POSITION, place] = -at.R
        T[VELOCITY, place] = -spin @ at.R
    if GYRO_BIAS in extras.places:
        place = extras.places[GYRO_BIAS]
        T[VELOCITY, place] = arm - cross_matrix(at.q)
        T[RATE, place] = np.eye(3)
    return T


def _moved(
    extras: _Extras,
    size: int,
    *,
    R: FloatArray,
    C: FloatArray,
    W: FloatArray,
    body: Turned,
    moved: FloatArray,
    chaser: ChaserStep,
) -> FloatArray:
    """Return the Jacobian of (q, theta, u, W) after a step with respect to those before, shape (12, 12 + n).

    The effect of the gyro's bias on the turn C is not included; ``_by_turn`` gives that of any turn.
    """
    F = np.zeros((12, size))
    R_after = R @ body.turn  # axes at rest
    F[POSITION, POSITION], F[POSITION, VELOCITY] = C @ moved[:3, :3], C @ moved[:3, 3:]
    F[VELOCITY, POSITION], F[VELOCITY, VELOCITY] = C @ moved[3:, :3], C @ moved[3:, 3:]
    turn_by_rate, rate_by_rate = R_after @ body.turn_by_rate @ R.T, R_after @ body.rate_by_rate @ R.T
    spin_after = cross_matrix(R_after @ body.rate_rad_s)
    # the rate in body axes has the error R^T (dW + W x dtheta)
    turned_by_attitude = np.eye(3) + turn_by_rate @ cross_matrix(W)
    F[ATTITUDE, ATTITUDE], F[ATTITUDE, RATE] = C @ turned_by_attitude, C @ turn_by_rate
    F[RATE, ATTITUDE] = C @ (rate_by_rate @ cross_matrix(W) - spin_after @ turned_by_attitude)
    F[RATE, RATE] = C @ (rate_by_rate - spin_after @ turn_by_rate)
    if INERTIA in extras.places:
        place, turned = extras.places[INERTIA], R_after @ body.turn_by_shape
        F[ATTITUDE, place] = C @ turned
        F[RATE, place] = C @ (R_after @ body.rate_by_shape - spin_after @ turned)
    for place in (extras.places[name] for name in FORCE_ERRORS if name in extras.places):
        F[POSITION, place], F[VELOCITY, place] = -C @ chaser.way_by_bias, -C @ chaser.speed_by_bias
    return F


def _of_curvature(spread: FloatArray, R: FloatArray, W: FloatArray) -> FloatArray:
    """Return the covariance of (q, theta, u, W) caused by the second-order terms, shape (12, 12).

    Args:
        spread: root of the covariance of turn and rate, body axes at the end, shape (6, K).
        R: attitude at the end, shape (3, 3).
        W: rate at the end, the same axes as R, shape (3,).
    """
    root = np.zeros((12, spread.shape[1]))
    root[ATTITUDE] = R @ spread[:3]
    root[RATE] = R @ spread[3:] - cross_matrix(W) @ root[ATTITUDE]
    return root @ root.T


def _by_turn(q: FloatArray, u: FloatArray, W: FloatArray) -> FloatArray:
    """Return the Jacobian of (q, theta, u, W) with respect to a turn of the chaser's axes, shape (12, 3)."""
    by_turn = np.empty((12, 3))
    by_turn[POSITION], by_turn[ATTITUDE] = -cross_matrix(q), np.eye(3)
    by_turn[VELOCITY], by_turn[RATE] = -cross_matrix(u), -cross_matrix(W)
    return by_turn
