"""The chaser's IMU, emulated: rate, specific force and attitude with noise and bias."""

from math import radians, sqrt

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_motion.motion import Motion
from rpod_motion.thrust import specific_force_m_s2
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import ImuNoiseConfig
from rpod_schemas.messages import write_imu
from rpod_schemas.topics import CHASER
from rpod_schemas.types import ImuReading

_STREAM = 0x696D75
"""Number that separates this noise from other noise of the same seed: "imu" in ASCII."""


class Imu:
    """Measures a motion with noise and bias; the biases are drawn once.

    The specific force is that of ``thrust.specific_force_m_s2``. Without an orbit, the orbital frame is the
    epoch axes.

    Args:
        config: noise and biases.
        motion: the motion.
        centre_of_mass_m: centre of mass of the target, target axes, shape (3,).
        seed: seed of the noise.
    """

    def __init__(
        self, config: ImuNoiseConfig, motion: Motion, *, centre_of_mass_m: FloatArray, seed: int
    ) -> None:
        self._config, self._motion, self._centre_m = config, motion, centre_of_mass_m
        self._seed, self.rate_hz = seed, config.rate_hz
        drawn = np.random.default_rng((seed, _STREAM)).standard_normal((2, 3))
        self.gyro_bias_rad_s: FloatArray = radians(config.gyro_bias_sigma_deg_s) * drawn[0]
        """Bias of the gyro, chaser axes, shape (3,)."""
        self.acceleration_bias_m_s2: FloatArray = config.acceleration_bias_sigma_m_s2 * drawn[1]
        """Bias of the accelerometer, chaser axes, shape (3,)."""
        self._rate_sigma = radians(config.gyro_noise_deg_sqrt_s) * sqrt(config.rate_hz)

    def reading(self, stamp_ns: int, time_s: float) -> ImuReading:
        """Return what is measured at a time from the epoch, under its stamp; its noise is keyed by both."""
        config, state = self._config, self._motion.state(time_s)
        number = round(time_s * config.rate_hz)
        noise = np.random.default_rng((self._seed, _STREAM, number + 1_000_000)).standard_normal((3, 3))
        force = attitude = None
        if config.acceleration_noise_m_s_sqrt_s is not None:
            sigma = config.acceleration_noise_m_s_sqrt_s * sqrt(config.rate_hz)
            force = specific_force_m_s2(self._motion, self._centre_m, time_s)
            force = force + self.acceleration_bias_m_s2 + sigma * noise[1]
        if config.star_tracker_sigma_deg is not None:
            true = state.R_epoch_chaser if state.R_orbit_chaser is None else state.R_orbit_chaser
            error = Rotation.from_rotvec(radians(config.star_tracker_sigma_deg) * noise[2])
            attitude = Rotation.from_matrix(true) * error
        return ImuReading(
            stamp_ns=stamp_ns,
            frame_id=CHASER,
            rate_rad_s=state.chaser_angular_rad_s + self.gyro_bias_rad_s + self._rate_sigma * noise[0],
            rate_variance=self._rate_sigma**2,
            force_m_s2=force,
            force_variance=(config.acceleration_noise_m_s_sqrt_s or 0.0) ** 2 * config.rate_hz,
            R_orbit_chaser=attitude,
            attitude_variance=radians(config.star_tracker_sigma_deg or 0.0) ** 2,
        )

    def message(self, stamp_ns: int, time_s: float) -> object:
        """Return the sensor_msgs/Imu of a reading."""
        return write_imu(self.reading(stamp_ns, time_s))
