"""Attitude of the target over time: fixed to the chaser, swaying, spinning, or tumbling without torque."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import cos, sin
from typing import Protocol

import numpy as np

from rpod_motion.errors import MotionError
from rpod_motion.trajectories.trajectory import TrajectoryState
from rpod_schemas.arrays import FloatArray

RELATIVE_TOLERANCE = 1e-12
"""Relative tolerance of the integration; the relative error of the energy is about as large after hundreds of
turns."""
_REMEMBERED = 8
"""Number of times for which an interpolated attitude is remembered."""

_X, _Y, _Z = np.eye(3)


class TargetAttitude(Protocol):
    """Attitude of the target over time."""

    def relative(self, time_s: float, chaser: TrajectoryState) -> tuple[FloatArray, FloatArray]:
        """Return R_chaser_target, shape (3, 3), and the rate vee(R^T dR/dt), target axes, shape (3,)."""
        ...


@dataclass(frozen=True, eq=False)
class FixedAttitude:
    """An attitude that is constant relative to the chaser."""

    R_chaser_target: FloatArray
    """The attitude, shape (3, 3)."""

    def relative(self, time_s: float, chaser: TrajectoryState) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002
        """See ``TargetAttitude.relative``; the rate is zero."""
        return self.R_chaser_target, np.zeros(3)


@dataclass(frozen=True, eq=False)
class Spin:
    """A constant rate about an axis fixed in the target and in inertial space."""

    R_epoch_target: FloatArray
    """Attitude at the epoch, shape (3, 3)."""
    axis: FloatArray
    """Unit vector, target axes, shape (3,)."""
    rate_rad_s: float

    def relative(self, time_s: float, chaser: TrajectoryState) -> tuple[FloatArray, FloatArray]:
        """See ``TargetAttitude.relative``."""
        turn = rotation_about(self.axis, self.rate_rad_s * time_s)
        return _seen_from(chaser, self.R_epoch_target @ turn, self.rate_rad_s * self.axis)


@dataclass(frozen=True, eq=False)
class Sway:
    """Sines of roll, pitch and yaw about an attitude relative to the chaser."""

    R_chaser_middle: FloatArray
    """Attitude about which the target sways, shape (3, 3)."""
    amplitude_rad: FloatArray
    """Amplitudes of roll, pitch and yaw, shape (3,)."""
    period_s: FloatArray
    """Periods of roll, pitch and yaw, shape (3,)."""

    def relative(self, time_s: float, chaser: TrajectoryState) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002
        """See ``TargetAttitude.relative``."""
        phase = 2.0 * np.pi * time_s / self.period_s
        a, b, c = (self.amplitude_rad * np.sin(phase)).tolist()
        da, db, dc = (self.amplitude_rad * np.cos(phase) * 2.0 * np.pi / self.period_s).tolist()
        turn = rotation_about(_Z, c) @ rotation_about(_Y, b) @ rotation_about(_X, a)
        rate = np.array(
            [
                da - dc * sin(b),
                db * cos(a) + dc * cos(b) * sin(a),
                dc * cos(b) * cos(a) - db * sin(a),
            ]
        )
        return self.R_chaser_middle @ turn, rate


@dataclass(frozen=True, eq=False)
class Tumble:
    """Torque-free rotation of a rigid body, integrated once and interpolated.

    Euler's equations, once integrated: the angular momentum H about the centre of mass is constant in
    inertial space, so omega = J^-1 R(q)^T H and dq/dt = q (omega, 0) / 2 (quaternion x, y, z, w). Four
    states instead of seven, and the momentum is conserved exactly.
    """

    inertia_inverse: FloatArray
    """J^-1, 1 / (kg m2), target axes, shape (3, 3)."""
    momentum_E: FloatArray
    """H, kg m2/s, epoch axes, shape (3,)."""
    before: Callable[[float], FloatArray]
    """Quaternion of R_epoch_target, not normalised, shape (4,), over the times before the epoch."""
    after: Callable[[float], FloatArray]
    """The same from the epoch on."""

    def relative(self, time_s: float, chaser: TrajectoryState) -> tuple[FloatArray, FloatArray]:
        """See ``TargetAttitude.relative``."""
        quaternion = self.after(time_s) if time_s >= 0.0 else self.before(time_s)
        R_epoch_target = _matrix(quaternion)
        return _seen_from(chaser, R_epoch_target, self.inertia_inverse @ (R_epoch_target.T @ self.momentum_E))


def integrate_tumble(
    *,
    quaternion_xyzw: FloatArray,
    rate_rad_s: FloatArray,
    inertia_kg_m2: FloatArray,
    span_s: tuple[float, float],
) -> Tumble:
    """Integrate the torque-free rotation over a span of time that contains the epoch.

    Args:
        quaternion_xyzw: unit quaternion of R_epoch_target at the epoch, shape (4,).
        rate_rad_s: rate at the epoch relative to inertial space, target axes, shape (3,).
        inertia_kg_m2: inertia about the centre of mass, target axes, shape (3, 3).
        span_s: first and last time, counted from the epoch.

    Raises:
        MotionError: the inertia is not that of a rigid body, or the integration fails.
    """
    from scipy.integrate import solve_ivp  # noqa: PLC0415 - loaded in 0.2 s; only a tumbling target needs it

    _require_rigid_body(inertia_kg_m2)
    inverse: FloatArray = np.linalg.inv(inertia_kg_m2).astype(np.float64)
    momentum = _matrix(quaternion_xyzw) @ inertia_kg_m2 @ rate_rad_s

    def quaternion_rate(_: float, quaternion: FloatArray) -> FloatArray:
        return _quaternion_rate(quaternion, inverse @ (_matrix(quaternion).T @ momentum))

    def solution(end_s: float) -> Callable[[float], FloatArray]:
        result = solve_ivp(
            quaternion_rate,
            (0.0, end_s),
            quaternion_xyzw,
            method="DOP853",
            dense_output=True,
            rtol=RELATIVE_TOLERANCE,
            atol=RELATIVE_TOLERANCE,
        )
        if not result.success or result.sol is None:
            raise MotionError(
                f"the tumbling cannot be integrated: {result.message}; lower the rate or the duration"
            )
        # of one tick, the trajectory and the attitude ask for the same times
        return lru_cache(maxsize=_REMEMBERED)(result.sol)

    return Tumble(inverse, momentum, before=solution(span_s[0]), after=solution(span_s[1]))


def _require_rigid_body(inertia_kg_m2: FloatArray) -> None:
    if not np.allclose(inertia_kg_m2, inertia_kg_m2.T, rtol=1e-9, atol=0.0):
        raise MotionError("the target's inertia is not symmetric; correct it in the target file")
    least, middle, greatest = np.linalg.eigvalsh(inertia_kg_m2)
    if least <= 0.0 or greatest > (least + middle) * (1.0 + 1e-9):
        raise MotionError(
            f"the target's principal moments of inertia {least:g}, {middle:g}, {greatest:g} kg m2 are not "
            "those of a rigid body: each must be positive and at most the sum of the other two; correct the "
            "inertia in the target file"
        )


def _seen_from(
    chaser: TrajectoryState, R_epoch_target: FloatArray, target_angular_rad_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    R_chaser_target = chaser.R_epoch_chaser.T @ R_epoch_target
    return R_chaser_target, target_angular_rad_s - R_chaser_target.T @ chaser.chaser_angular_rad_s


def rotation_about(axis: FloatArray, angle_rad: float) -> FloatArray:
    """Return Rodrigues' rotation matrix, shape (3, 3), about a unit vector, shape (3,), by an angle, rad.

    Scipy's Rotation takes ten times as long at this size.
    """
    x, y, z = axis
    c, s = cos(angle_rad), sin(angle_rad)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return c * np.eye(3) + s * cross + (1.0 - c) * np.outer(axis, axis)


def _matrix(quaternion_xyzw: FloatArray) -> FloatArray:
    """Return the rotation matrix of a quaternion of any norm."""
    x, y, z, w = quaternion_xyzw.tolist()
    s = 2.0 / (x * x + y * y + z * z + w * w)
    return np.array(
        [
            [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)],
        ]
    )


def _quaternion_rate(quaternion_xyzw: FloatArray, rate_rad_s: FloatArray) -> FloatArray:
    """Return dq/dt = q (omega, 0) / 2 for a rate in body axes."""
    x, y, z, w = quaternion_xyzw.tolist()
    a, b, c = rate_rad_s.tolist()
    return 0.5 * np.array(
        [w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a, -x * a - y * b - z * c]
    )
