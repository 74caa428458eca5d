"""The error-state Kalman filter's configuration."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import Config, NonNegative, Positive


class FilterConfig(Config):
    """Constant velocity driven by white noise, gated measurements of the pose.

    The densities cover a tumbling target of ENVISAT's size at 8 deg/s seen once a second, even where its
    centre of mass is declared 4 m off, and do not slow a camera at 15 Hz; where the centre of mass is known,
    a twentieth of the acceleration does as well and filters slow motions better.
    """

    acceleration_density_m2_s3: Positive = 2e-3
    """Spectral density of the white acceleration of the target's centre of mass, each axis."""
    angular_acceleration_density_rad2_s3: Positive = 1e-4
    """Spectral density of the white angular acceleration, each axis."""
    position_floor_m: NonNegative = 0.002
    """Sigma added in squares to every measured position: errors of model and calibration."""
    attitude_floor_deg: NonNegative = 0.15
    """Sigma added in squares to every measured attitude."""
    correlation_inflation: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 2.0
    """Factor on a measurement's covariance, since the errors of successive frames are alike; 6 at 45 Hz."""
    gate_nis: Positive = 16.8
    """Largest normalised innovation squared that is accepted; 16.8 is 99 % of chi-square with 6 degrees."""
    initial_velocity_sigma_m_s: Positive = 0.3
    """Of each axis, where a filter starts without a velocity."""
    initial_rate_sigma_deg_s: Positive = 6.0
    """Of each axis, where a filter starts without a rotation rate."""
    max_delay_s: NonNegative = 1.0
    """A measurement may be this much older than the newest one and is still applied, at its own stamp."""
