"""Rotation and acceleration of the chaser between two times: held, measured by its IMU, or commanded."""

from typing import NamedTuple, Protocol

import numpy as np

from rpod_pose.navigation.filter.rotations import exponential
from rpod_schemas.arrays import FloatArray


class ChaserStep(NamedTuple):
    """Motion of the chaser relative to inertial space in a step.

    Vectors are in the chaser's axes at the start of the step, unless stated otherwise. A bias b of the gyro
    or of the accelerometer is in chaser axes. The values hold for a bias of zero, and their derivatives with
    respect to the bias are given. Commanded accelerations have four errors of thrust (``command_track``) in
    place of the accelerometer's bias; K is their number, or 3.
    """

    turn: FloatArray
    """Rotation matrix from chaser axes at the start to chaser axes at the end, for a vector at rest in
    inertial space, shape (3, 3)."""
    turn_by_bias: FloatArray
    """Derivatives D of the turn with respect to the gyro's bias, s, shape (3, 3): Exp(D b) turn."""
    rate_before_rad_s: FloatArray
    """Rate at the start, chaser axes at the start, shape (3,)."""
    rate_after_rad_s: FloatArray
    """Rate at the end, chaser axes at the end, shape (3,)."""
    turn_variance: float
    """Variance of the turn about each axis caused by the noise of the gyro, rad2."""
    unknown: FloatArray
    """``pushed`` of the parts in which the chaser's rotation and acceleration are unknown, shape (3,)."""
    speed_m_s: FloatArray
    """First integral of the measured or commanded specific force: a change of velocity, shape (3,)."""
    way_m: FloatArray
    """Second integral of the same: a displacement, shape (3,)."""
    speed_by_bias: FloatArray
    """Derivatives of ``speed_m_s`` with respect to the acceleration's errors, s or m/s, shape (3, K)."""
    way_by_bias: FloatArray
    """Derivatives of ``way_m`` with respect to the acceleration's errors, s2 or m, shape (3, K)."""
    R_orbit_chaser: FloatArray | None
    """Attitude in the orbital frame at the start, shape (3, 3); None if it is unknown."""
    bias_kept: float = 1.0
    """Share of the gyro's bias that remains at the end of a step in which a star tracker corrects it."""
    bias_noise: float = 0.0
    """Variance about each axis of the noise that is added to this share, (rad/s)^2."""
    force_noise: FloatArray = np.zeros(3)
    """Variance of ``way_m`` along each axis, its covariance with ``speed_m_s``, and the variance of that, by
    the noise of accelerometer or thrust, m2, m2/s and (m/s)^2, shape (3,)."""
    rate_variance: float = 0.0
    """Variance of ``rate_after_rad_s`` about each axis, by the noise of the gyro, (rad/s)^2."""
    unforced: FloatArray = np.zeros(3)
    """``pushed`` of the parts in which no command holds, so that the acceleration is unknown, shape (3,)."""


def pushed(begin_s: FloatArray | float, end_s: FloatArray | float, step_s: float) -> FloatArray:
    """Return what a white acceleration in a part of a step does to way and speed at the step's end.

    An acceleration at the begin of a long step moves the chaser until its end.

    Args:
        begin_s: begin of the part, from that of the step, s; or of each of several, shape (N,).
        end_s: its end, the same.
        step_s: duration of the step.

    Returns:
        ``ChaserStep.force_noise`` for a density of 1 m2/s3, s3, s2 and s, shape (3,) or (3, N).
    """
    since_s, until_s = step_s - begin_s, step_s - end_s
    way, mixed = (since_s**3 - until_s**3) / 3.0, (since_s**2 - until_s**2) / 2.0
    return np.array([way, mixed, since_s - until_s])


class Chaser(Protocol):
    """The known motion of the chaser."""

    def step(self, begin_ns: int, end_ns: int) -> ChaserStep:
        """Return the motion between two stamps, ns."""
        ...

    def turn(self, begin_ns: int, end_ns: int) -> FloatArray:
        """Return the ``turn`` of a step alone, shape (3, 3)."""
        ...


class Held:
    """A chaser that holds its attitude, in inertial space or in the orbital frame.

    Args:
        R_orbit_chaser: attitude held in the orbital frame, shape (3, 3); None for one in inertial space.
        orbit_rate_rad_s: rate of the orbit.
    """

    def __init__(self, R_orbit_chaser: FloatArray | None = None, orbit_rate_rad_s: float = 0.0) -> None:
        self._attitude = R_orbit_chaser
        self._rate_rad_s = np.zeros(3)
        if R_orbit_chaser is not None:
            self._rate_rad_s = orbit_rate_rad_s * R_orbit_chaser[2]

    def step(self, begin_ns: int, end_ns: int) -> ChaserStep:
        """Return the motion between two stamps."""
        turn = self.turn(begin_ns, end_ns)
        nothing, none = np.zeros((3, 3)), np.zeros(3)
        rate = self._rate_rad_s
        return ChaserStep(turn, nothing, rate, rate, 0.0, none, none, none, nothing, nothing, self._attitude)

    def turn(self, begin_ns: int, end_ns: int) -> FloatArray:
        """Return the rotation matrix from chaser axes at one stamp to those at another, shape (3, 3)."""
        return exponential(-self._rate_rad_s * ((end_ns - begin_ns) * 1e-9))
