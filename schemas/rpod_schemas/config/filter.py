"""The error-state Kalman filter's configuration."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import Config, NonNegative, Positive
from rpod_schemas.config.tuning import Provenance, Tuning


class FilterTuning(Tuning):
    """The gate of the filter."""

    gate_nis: Annotated[
        Positive, Provenance("physics", "99 % quantile of chi squared with six degrees of freedom")
    ] = 16.8
    """Largest normalised innovation squared that is accepted; 16.8 is 99 % of chi-square with 6 degrees."""


class FilterConfig(Config):
    """Constant velocity driven by white noise, gated measurements of the pose.

    The densities cover a tumbling target of ENVISAT's size at 8 deg/s seen once a second, even where its
    centre of mass is declared 4 m off, and do not slow a camera at 15 Hz; where the centre of mass is known,
    a twentieth of the acceleration does as well and filters slow motions better.
    """

    acceleration_density_m2_s3: Positive = 2e-3
    """Spectral density of the white acceleration of the target's centre of mass, each axis. Raise it where
    the chaser manoeuvres hard, so that estimates follow; lower it for smoother ones of a slow target."""
    angular_acceleration_density_rad2_s3: Positive = 1e-4
    """Spectral density of the white angular acceleration, each axis. Raise it for targets that tumble faster
    than 8 deg/s or nutate; lower it for smoother rates of a stabilised one."""
    position_floor_m: NonNegative = 0.002
    """Sigma added in squares to every measured position, for errors of the target's model and the mount.
    Raise it where consistent offsets show; lower it where both are known better."""
    attitude_floor_deg: NonNegative = 0.15
    """Sigma added in squares to every measured attitude, for the same errors."""
    correlation_inflation: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 2.0
    """Factor on a measurement's covariance, since the errors of successive frames are alike. Raise it with
    the sensor's rate, 6 at 45 Hz; too low a factor makes the filter overconfident."""
    initial_velocity_sigma_m_s: Positive = 0.3
    """Sigma of the velocity of each axis, where a filter starts without one. Raise it where targets drift
    faster: the second measurement would else be rejected."""
    initial_rate_sigma_deg_s: Positive = 6.0
    """Sigma of the rotation rate of each axis, where a filter starts without one. Raise it for targets that
    tumble faster: the second measurement would else be rejected."""
    max_delay_s: NonNegative = 1.0
    """How much older than the newest measurement one may be and is still applied, at its own stamp. Raise
    it for a slow sensor beside a fast one; memory and work grow with it."""
    tuning: FilterTuning = FilterTuning()
    """Limits and numbers that are no part of the promise; change them only to study the method."""
