"""Configuration of the error-state Kalman filter."""

from math import inf
from typing import Annotated, Literal

from pydantic import Field

from rpod_schemas.config.base import Config, NonNegative, Positive
from rpod_schemas.config.tuning import Provenance, Tuning

LEAST_INFLATION = 2.0
"""Factor on a measurement's covariance if no other frame is near. Hand: as for a camera at 15 Hz."""


class FilterTuning(Tuning):
    """The gate of the filter."""

    gate_nis: Annotated[
        Positive, Provenance("physics", "99 % quantile of chi squared with six degrees of freedom")
    ] = 16.8
    """Largest accepted normalised innovation squared: the 99 % quantile of chi-squared with six degrees of
    freedom."""
    model_turn_deg: Annotated[
        Positive,
        Provenance(
            "physics", "after 57 deg, 1 rad, the cosines by which faces count have changed by their own size"
        ),
    ] = 57.0
    """Turn of the view after which errors of the target's model are correlated by 1/e, deg."""
    alike_s: Annotated[
        Positive,
        Provenance(
            "campaign",
            "twelve sequences of an independent emulator, seed 1, no quantile: the mean NEES at 45 Hz is 2.1 "
            "times that at 15 Hz with one factor for both rates, and 0.9 times with this value",
        ),
    ] = 0.133
    """Time within which frames of a sensor show the same errors, s, where ``correlation_inflation`` is not
    set."""
    correlation_inflation: Annotated[
        Annotated[float, Field(ge=1, allow_inf_nan=False)] | None,
        Provenance("physics", "none: the factor follows from the rate of the frames (``alike_s``)"),
    ] = None
    """Factor on a measurement's covariance that replaces the one by the rate of the frames."""


class FilterConfig(Config):
    """Error-state Kalman filter: constant velocity driven by white noise, gated pose measurements.

    The default densities cover a tumbling target of ENVISAT's size at 8 deg/s that is seen once a second,
    even if the declared centre of mass is 4 m off. They do not slow down a camera at 15 Hz. If the centre of
    mass is known, a twentieth of the acceleration density is sufficient and smooths slow motions better.
    """

    acceleration_density_m2_s3: Positive = 2e-3
    """Spectral density of the white acceleration of the target's centre of mass, each axis, m2/s3. Raise it
    if the chaser manoeuvres hard, so that the estimates follow. Lower it for smoother estimates of a slow
    target. Where believed poses show larger accelerations, the filter raises it for a while by itself, until
    the velocity is as uncertain after a step as ``initial_velocity_sigma_m_s`` says."""
    angular_acceleration_density_rad2_s3: Positive = 1e-4
    """Spectral density of the white angular acceleration, each axis, rad2/s3. Raise it for targets that
    tumble faster than 8 deg/s or nutate. Lower it for smoother rates of a stabilised target. The filter
    raises it by itself likewise, up to ``initial_rate_sigma_deg_s``."""
    position_floor_m: NonNegative = 0.002
    """Standard deviation that is added in squares to every measured position, m, for errors of the target's
    model and the mount. Raise it if constant offsets appear; lower it if both are known better."""
    attitude_floor_deg: NonNegative = 0.15
    """Standard deviation that is added in squares to every measured attitude, deg, for the same errors. Raise
    it if attitudes are constantly off by more than their covariance says."""
    errors: Literal["considered", "inflated"] = "inflated"
    """How errors that last from frame to frame are treated. ``considered`` carries them as states, as large
    as the sensor's method and the target's ``tolerance_m`` say. ``inflated`` adds the two floors above and
    multiplies the covariance by a factor: 2 up to 15 frames a second, rising with their rate to 6 at 45.
    Sensors whose methods do not separate these errors always have floors and factor. Set ``considered`` where
    the target's file is right within its ``tolerance_m``."""
    mount_sigma_deg: NonNegative = 0.0
    """Standard deviation of the attitude of a sensor's mount about each axis, deg, for which the filter
    estimates it. Set it where mounts are not calibrated well: the difference between the mounts of two
    sensors is then estimated from their poses, and the covariance of the estimate contains what remains
    unknown."""
    mount_sigma_m: NonNegative = 0.0
    """The same of the place of a sensor's mount along each axis, m. Set it together with
    ``mount_sigma_deg``."""
    initial_velocity_sigma_m_s: Positive | None = None
    """Standard deviation of the velocity of each axis, m/s, when a filter starts without one. If left out, it
    follows from the range: three times it is the speed from which 3 m/s2 stop the chaser before the target,
    so that it is 1 m/s at 1.5 m and 5 m/s at 40 m. Set it to a third of the largest relative speed that your
    mission allows, for a more certain velocity in the first frames; at more, the second measurement is
    rejected."""
    initial_rate_sigma_deg_s: Positive = 6.0
    """Standard deviation of the rotation rate of each axis, deg/s, when a filter starts without one. Set it
    to a third of the largest tumbling rate that the mission allows. The default covers 18 deg/s."""
    max_delay_s: Positive = 1.0
    """Largest delay of a measurement, s. A frame that is older on arrival is late and not used. A measurement
    that is up to this time older than the newest one is applied at its own stamp. Raise it for slow links,
    long exposures, or a slow sensor beside a fast one; memory and computation grow with it."""
    tuning: FilterTuning = FilterTuning()
    """Limits and numbers of the method that are outside the public interface; change them only to study
    it."""

    def inflation(self, since_s: float = inf) -> float:
        """Return the factor on a measurement's covariance.

        Args:
            since_s: time since the frame of its sensor before it that was accepted, s.
        """
        if self.tuning.correlation_inflation is not None:
            return self.tuning.correlation_inflation
        return max(LEAST_INFLATION, self.tuning.alike_s / max(since_s, 1e-9))
