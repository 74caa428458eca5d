"""How the estimator predicts the motion of target and chaser between measurements."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, model_validator

from rpod_schemas.config.base import Config, NonNegative, Positive
from rpod_schemas.config.tuning import Provenance, Tuning
from rpod_schemas.poses import Attitude

_SHORTEST_S = 3600.0
"""Shortest period of an orbit, s. At the surface of a body of density rho it is sqrt(3 pi / (G rho)): 5,060 s
at the Earth, and 4,230 s at one of iron."""


def _possible(period_s: float) -> float:
    if period_s < _SHORTEST_S:
        raise ValueError(
            f"is {period_s:g} s, needs {_SHORTEST_S:g} s or more: no body is dense enough for a shorter "
            "orbit; state the period in seconds"
        )
    return period_s


class OrbitConfig(Config):
    """The target's circular orbit, and the chaser's attitude in the orbital frame (ICD section 1)."""

    period_s: Annotated[Positive, AfterValidator(_possible)]
    """Period of the target's orbit, s. Set it to that of the mission's orbit, some 6,000 s in low orbits."""
    R_orbit_chaser: Attitude | None = None
    """Attitude of the chaser in the orbital frame, if it holds one there. Leave it out where ``chaser/imu``
    states the attitude."""


class ImuConfig(Config):
    """The chaser's IMU, ``chaser/imu``."""

    gyro_bias_sigma_deg_s: NonNegative = 0.003
    """Standard deviation of the gyro's bias about each axis, deg/s, of which nothing is known at first. Set
    it to the data sheet's; the default is 10 deg/h."""
    acceleration_bias_sigma_m_s2: NonNegative | None = None
    """Standard deviation of the accelerometer's bias, m/s2. Set it to use the measured accelerations, in
    orbit only: on Earth an accelerometer measures its weight. If left out, they are not used."""


class CommandTuning(Tuning):
    """Errors of thrusters, where ``guidance/command`` does not state them."""

    sigma: Annotated[
        Positive,
        Provenance(
            "physics",
            "thrusters are 1 to 5 % off, in direction by about as much; both proportional to the thrust (C. "
            "R. Gates, A Simplified Model of Midcourse Maneuver Execution Errors, JPL TR 32-504, 1963)",
        ),
    ] = 0.03
    """Standard deviation of the executed acceleration along each axis, over the size of the command, for
    commands that do not state their covariance. It lasts: one thruster, one error."""
    noise_m_s_sqrt_s: Annotated[
        Positive,
        Provenance("physics", "on-times rounded to 10 ms, ten pulses a second of thrusters for 0.02 m/s2"),
    ] = 2e-4
    """Noise of the speed while thrusters are commanded, m/s/sqrt(s)."""
    delay_sigma_s: Annotated[
        Positive, Provenance("physics", "valves open within 10 ms, within a cycle of 10 ms of a computer")
    ] = 0.02
    """Standard deviation of the time between a command's stamp and the change of thrust, s."""


class CommandConfig(Config):
    """The acceleration that the chaser's thrusters are commanded to give it, ``guidance/command``."""

    tuning: CommandTuning = CommandTuning()
    """Numbers outside the public interface. A guidance that knows its thrusters states their errors by the
    covariance of its commands instead."""


class DynamicsTuning(Tuning):
    """Noise of motion that no model contains."""

    acceleration_density_m2_s3: Annotated[
        Positive, Provenance("physics", "differential drag of 1e-6 m/s2 at 600 km that lasts for 1,000 s")
    ] = 1e-9
    """Spectral density of accelerations in free flight, m2/s3, where thrust is known or there is none."""
    angular_acceleration_density_rad2_s3: Annotated[
        Positive, Provenance("physics", "gravity gradient in low orbits, 1e-6 rad/s2, that lasts for 10 s")
    ] = 2e-11
    """Spectral density of angular accelerations of a body without torque, rad2/s3."""
    gyro_noise_deg_sqrt_s: Annotated[
        Positive, Provenance("physics", "0.15 deg/sqrt(h), a tactical MEMS gyro (STIM300 data sheet)")
    ] = 0.0025
    """Angular random walk of a gyro whose readings do not state their variance, deg/sqrt(s)."""
    accelerometer_noise_m_s_sqrt_s: Annotated[
        Positive, Provenance("physics", "0.06 m/s/sqrt(h), a tactical MEMS accelerometer")
    ] = 0.001
    """Velocity random walk of an accelerometer whose readings do not state their variance, m/s/sqrt(s)."""
    gyro_bias_walk_deg_s_sqrt_s: Annotated[
        Positive, Provenance("physics", "0.3 deg/h, its bias instability (STIM300 data sheet), in 1,000 s")
    ] = 2.6e-6
    """Random walk of the gyro's bias, deg/s/sqrt(s), where a star tracker determines the bias."""


class DynamicsConfig(Config):
    """How a track is predicted: by default at a constant velocity and rate, as seen from the chaser."""

    target: Literal["constant_rate", "torque_free"] = "constant_rate"
    """Rotation of the target. Set ``torque_free`` for a tumbling body without attitude control; it is then
    predicted for minutes by Euler's equations."""
    inertia_sigma: NonNegative = 0.1
    """Relative standard deviation of the target's inertia as its file states it, for ``torque_free``; ratios
    of the moments are estimated. Raise it if propellant or damage makes the file doubtful; 0 trusts it."""
    centre_of_mass_sigma_m: NonNegative = 0.0
    """Standard deviation of each coordinate of the centre of mass as the target's file states it, m. Set it
    to have the centre of mass estimated from the tumbling; 0 trusts the file."""
    orbit: OrbitConfig | None = None
    """The orbit, for a prediction by Clohessy and Wiltshire's equations of free flight. Set it where the
    chaser does not thrust during gaps, or where its accelerations are measured or commanded."""
    imu: ImuConfig | None = None
    """The chaser's IMU, which measures the chaser's rotation. Set it if the chaser turns and publishes
    ``chaser/imu``."""
    command: CommandConfig | None = None
    """The commanded acceleration. Set it, to ``{}``, if the chaser thrusts and your guidance publishes
    ``guidance/command``; the accelerometer is then left out."""
    tuning: DynamicsTuning = DynamicsTuning()
    """Limits and numbers of the method that are outside the public interface; change them only to study
    it."""

    @property
    def is_default(self) -> bool:
        """Whether the prediction is that of a constant velocity and rate as seen from the chaser."""
        simple = self.target == "constant_rate" and not self.centre_of_mass_sigma_m
        return simple and self.orbit is None and self.imu is None and self.command is None

    @property
    def uses_accelerometer(self) -> bool:
        """Whether the accelerations that the IMU measures are used."""
        return self.imu is not None and self.imu.acceleration_bias_sigma_m_s2 is not None

    @model_validator(mode="after")
    def _one_source_of_acceleration(self) -> Self:
        if self.command is not None and self.uses_accelerometer:
            raise ValueError(
                "command: the IMU measures the same acceleration; leave out command, or "
                "imu.acceleration_bias_sigma_m_s2"
            )
        return self

    @model_validator(mode="after")
    def _the_orbit_needs_an_attitude(self) -> Self:
        if self.orbit is not None and self.orbit.R_orbit_chaser is None and self.imu is None:
            raise ValueError(
                "orbit: the chaser's attitude in the orbital frame is not known; set orbit.R_orbit_chaser, "
                "or imu if chaser/imu states it"
            )
        return self
