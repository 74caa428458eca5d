"""Rotation and measured acceleration of the chaser between two times: held, or as its IMU has measured."""

from typing import NamedTuple, Protocol

import numpy as np

from rpod_pose.navigation.filter.rotations import exponential
from rpod_schemas.arrays import FloatArray


class ChaserStep(NamedTuple):
    """Motion of the chaser relative to inertial space in a step.

    Axes without another name are the chaser's at the start of the step. A bias b of the gyro (of the
    accelerometer) is in chaser axes; the numbers here are those for a bias of zero, with their derivatives.
    """

    turn: FloatArray
    """Coordinates in chaser axes at the start to those at the end, of what is at rest, shape (3, 3)."""
    turn_by_bias: FloatArray
    """Derivatives of the turn by the gyro's bias, as left errors, shape (3, 3): Exp(D b) turn."""
    rate_before_rad_s: FloatArray
    """Rate at the start, chaser axes at the start, shape (3,)."""
    rate_after_rad_s: FloatArray
    """Rate at the end, chaser axes at the end, shape (3,)."""
    turn_variance: float
    """Variance of the turn about each axis, by the noise of the gyro, rad2."""
    unknown_s: float
    """Part of the time in which the chaser's rotation is unknown, s."""
    speed_m_s: FloatArray
    """Integral of the measured specific force, shape (3,)."""
    way_m: FloatArray
    """Its integral, shape (3,)."""
    speed_by_bias: FloatArray
    """Derivatives of ``speed_m_s`` by the accelerometer's bias, shape (3, 3)."""
    way_by_bias: FloatArray
    """Derivatives of ``way_m`` by the accelerometer's bias, shape (3, 3)."""
    R_orbit_chaser: FloatArray | None
    """Attitude in the orbital frame at the start, shape (3, 3); None if it is unknown."""
    bias_kept: float = 1.0
    """Share of the gyro's bias that is left at the end, where a star tracker takes it out in the step."""
    bias_noise: float = 0.0
    """Variance about each axis of the noise that is added to this share, (rad/s)^2."""


class Chaser(Protocol):
    """Known motion of the chaser."""

    def step(self, begin_ns: int, end_ns: int) -> ChaserStep:
        """Return the motion between two stamps."""
        ...


class Held:
    """A chaser that holds its attitude, in inertial space or in the orbital frame.

    Args:
        R_orbit_chaser: attitude in the orbital frame, shape (3, 3); None for one in inertial space.
        orbit_rate_rad_s: rate of the orbit.
    """

    def __init__(self, R_orbit_chaser: FloatArray | None = None, orbit_rate_rad_s: float = 0.0) -> None:
        self._attitude = R_orbit_chaser
        self._rate_rad_s = np.zeros(3)
        if R_orbit_chaser is not None:
            self._rate_rad_s = orbit_rate_rad_s * R_orbit_chaser[2]

    def step(self, begin_ns: int, end_ns: int) -> ChaserStep:
        """Return the motion between two stamps."""
        turn = exponential(-self._rate_rad_s * ((end_ns - begin_ns) * 1e-9))
        nothing, none = np.zeros((3, 3)), np.zeros(3)
        rate = self._rate_rad_s
        return ChaserStep(turn, nothing, rate, rate, 0.0, 0.0, none, none, nothing, nothing, self._attitude)
