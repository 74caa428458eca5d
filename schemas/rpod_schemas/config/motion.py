"""Motion of chaser and target: the trajectory, the target's attitude, and the sun.

Chaser axes: z is the direction of approach and the sensors' boresight, x points right, y down.
Quantities at the epoch are in the chaser's axes at the epoch.
"""

from math import isclose, radians
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray, Vector3
from rpod_schemas.config.base import Config, Finite, Name, NonNegative, Positive
from rpod_schemas.poses import Attitude, Pose, make_pose

TRUTH_RATE_HZ = 250.0
"""Rate of the truth, if the motion service is not configured otherwise, Hz."""


def _with_direction(vector: FloatArray) -> FloatArray:
    if not vector.any():
        raise ValueError("is the zero vector, which has no direction; give one of any length above 0")
    return vector


def _all_positive(vector: FloatArray) -> FloatArray:
    if (vector <= 0.0).any():
        raise ValueError(f"is {vector.tolist()}, needs positive numbers")
    return vector


Direction = Annotated[Vector3, AfterValidator(_with_direction)]
"""A direction, shape (3,), not zero; its length does not matter."""

FACING = Rotation.from_quat([0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)])
"""Attitude R_chaser_target with the target's x axis, the front of the mock-up, towards the chaser and its y
axis to the right."""


class ApproachConfig(Config):
    """The target's origin moves on a straight line in the chaser's axes."""

    kind: Literal["approach"] = "approach"
    """Selects this trajectory."""
    start_m: Vector3 = Field(default_factory=lambda: np.array([0.0, 0.0, 7.0]))
    """Position of the target's origin at the epoch, chaser axes, m."""
    end_m: Vector3 = Field(default_factory=lambda: np.array([0.0, 0.0, 2.0]))
    """Position of the target's origin at the end, chaser axes, m."""
    ramp_share: Annotated[float, Field(ge=0, le=0.5)] = 0.1
    """Share of the duration in which the speed rises, and in which it falls at the end; 0 is constant
    velocity."""

    synchronised: bool = False
    """Whether the chaser turns with the target and flies around it, so that the line is fixed in target axes
    as well. Otherwise the chaser holds its inertial attitude."""

    @model_validator(mode="after")
    def _is_a_line_in_front(self) -> Self:
        if self.start_m[2] <= 0 or self.end_m[2] <= 0:
            raise ValueError(
                "start_m and end_m need a positive third component, the range along the boresight"
            )
        if np.array_equal(self.start_m, self.end_m):
            raise ValueError("start_m equals end_m: an approach needs two positions")
        given = self.model_fields_set & {"start_m", "end_m"}
        if len(given) == 1:
            missing = "end_m" if "start_m" in given else "start_m"
            raise ValueError(f"{missing} is missing: an approach needs both, or neither for 7 to 2 m")
        return self


class StationKeepingConfig(Config):
    """The chaser circles the target's centre of mass on a safety ellipse; its z axis points at it."""

    kind: Literal["station_keeping"] = "station_keeping"
    """Selects this trajectory."""
    least_range_m: Positive = 20.0
    """Semi-minor axis of the ellipse, along the radius of the orbit, m."""
    greatest_range_m: Positive = 50.0
    """Semi-major axis of the ellipse, along and across the track, m."""
    phase_deg: Finite = 0.0
    """Phase at the epoch, deg: 0 is straight below the target, at the least range; 90 is ahead of it, at the
    greatest. The target's argument of latitude is 90 deg more."""
    semi_major_axis_m: Annotated[float, Field(gt=6.4e6, allow_inf_nan=False)] = 7.144e6
    """Semi-major axis of the target's mean orbit, a circle, m; the default is ENVISAT's, with a period of
    100.3 min."""
    inclination_deg: Annotated[float, Field(ge=1, le=179)] = 98.5
    """Inclination of the target's mean orbit, deg; the default is ENVISAT's."""

    @model_validator(mode="after")
    def _clears_the_track(self) -> Self:
        if self.greatest_range_m <= 2.0 * self.least_range_m:
            raise ValueError(
                f"greatest_range_m is {self.greatest_range_m:g}, needs more than twice least_range_m "
                f"({self.least_range_m:g}): a relative orbit is twice as long along the track as along the "
                "radius, and only a longer one keeps clear of the track"
            )
        return self


class FixedAttitudeConfig(Config):
    """A stabilised target: its attitude relative to the chaser is constant."""

    kind: Literal["fixed"] = "fixed"
    """Selects this attitude motion."""
    R_chaser_target: Attitude = FACING
    """Attitude during the whole scenario."""


class SpinConfig(Config):
    """The target turns at a constant rate about an axis that is fixed in its body and in inertial space."""

    kind: Literal["spin"] = "spin"
    """Selects this attitude motion."""
    R_chaser_target: Attitude = FACING
    """Attitude at the epoch."""
    axis: Direction = Field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    """Axis of the rotation, target axes, shape (3,)."""
    rate_deg_s: Finite = 5.0
    """Rate about the axis relative to inertial space, deg/s."""


class TumbleConfig(Config):
    """The target is a rigid body without torque, with the inertia of its target file."""

    kind: Literal["tumble"] = "tumble"
    """Selects this attitude motion."""
    R_chaser_target: Attitude = FACING
    """Attitude at the epoch."""
    rate_deg_s: Vector3
    """Rotation rate at the epoch relative to inertial space, target axes, deg/s, shape (3,)."""


class SwayConfig(Config):
    """The target turns to and fro about each of its axes, as robots turn it for a calibration."""

    kind: Literal["sway"] = "sway"
    """Selects this attitude motion."""
    R_chaser_target: Attitude = FACING
    """Attitude about which it sways, relative to the chaser."""
    amplitude_deg: Vector3 = Field(default_factory=lambda: np.array([40.0, 20.0, 20.0]))
    """Largest roll, pitch and yaw (321 angles in target axes), deg."""
    period_s: Annotated[Vector3, AfterValidator(_all_positive)] = Field(
        default_factory=lambda: np.array([23.0, 17.0, 13.0])
    )
    """Periods of roll, pitch and yaw, s."""


class TruthErrorConfig(Config):
    """Errors of the published truth, as of robots or of motion capture.

    They are a stationary first-order Gauss-Markov process for each axis; the truth states their covariance.
    """

    sigma_position_m: NonNegative = 0.00156
    """Standard deviation along each axis, m; the default is the accuracy that Klionovska et al. 2018 give for
    the EPOS facility."""
    sigma_attitude_deg: NonNegative = 0.2
    """Standard deviation about each axis, deg; the default is that of the same source."""
    correlation_s: NonNegative = 1.0
    """Time after which errors are correlated by 1/e, s; 0 for errors that are independent."""


class SlewConfig(Config):
    """The chaser turns to and fro about an axis, by a sine of time, beside its trajectory."""

    axis: Direction = Field(default_factory=lambda: np.array([0.0, 1.0, 0.0]))
    """Axis, chaser axes, shape (3,)."""
    amplitude_deg: Positive = 10.0
    """Largest angle, deg."""
    period_s: Positive = 60.0
    """Period, s."""


class ImuNoiseConfig(Config):
    """The chaser's emulated IMU: noise, and biases that are drawn once for the run."""

    rate_hz: Positive = 50.0
    """Rate of the readings, Hz; a divisor of the truth's rate."""
    gyro_noise_deg_sqrt_s: NonNegative = 0.0025
    """Angular random walk, deg/sqrt(s); the default is 0.15 deg/sqrt(h), a tactical MEMS gyro."""
    gyro_bias_sigma_deg_s: NonNegative = 0.003
    """Standard deviation of the gyro's bias about each axis, deg/s; the default is 10 deg/h."""
    star_tracker_sigma_deg: NonNegative | None = None
    """Standard deviation of the attitude in the orbital frame about each axis, deg; none is stated if left
    out."""
    acceleration_noise_m_s_sqrt_s: NonNegative | None = None
    """Velocity random walk of the accelerometer, m/s/sqrt(s); no accelerometer if left out."""
    acceleration_bias_sigma_m_s2: NonNegative = 1e-4
    """Standard deviation of the accelerometer's bias along each axis, m/s2."""


class CommandErrorConfig(Config):
    """Thrusters that execute ``guidance/command`` with errors, of which size and direction are drawn once.

    The trajectory is what they achieve, so that the published commands are those that lead to it.
    """

    rate_hz: Positive = 10.0
    """Rate of the commands, Hz; a divisor of the truth's rate, at least 1."""
    sigma: NonNegative = 0.03
    """Standard deviation of the executed acceleration along each axis, over the size of the command;
    thrusters are 1 to 5 % off."""
    delay_s: NonNegative = 0.02
    """Time from a command's stamp to the change of thrust, s."""
    noise_m_s_sqrt_s: NonNegative = 2e-4
    """Noise of the speed while thrusters are commanded, m/s/sqrt(s); the default is that of on-times rounded
    to 10 ms, ten pulses a second of thrusters for 0.02 m/s2."""


class SunConfig(Config):
    """The sun, at rest in inertial space."""

    direction: Direction
    """Direction to the sun, chaser axes at the epoch."""
    irradiance_W_m2: NonNegative = 1361.0
    """Irradiance over the whole spectrum, W/m2; the default is that of space at one astronomical unit."""


TrajectoryConfig = Annotated[ApproachConfig | StationKeepingConfig, Field(discriminator="kind")]
AttitudeConfig = Annotated[
    FixedAttitudeConfig | SpinConfig | TumbleConfig | SwayConfig, Field(discriminator="kind")
]


class JointMotionConfig(Config):
    """Motion of a joint of the target: at a constant rate from an angle."""

    angle_deg: Finite = 0.0
    """Angle at the epoch."""
    rate_deg_s: Finite = 0.0
    """Rate, deg/s."""

    def angle_rad(self, time_s: float) -> float:
        """Return the angle at a time from the epoch."""
        return radians(self.angle_deg + self.rate_deg_s * time_s)


class BodyMotionConfig(Config):
    """A frame of a known body, such as a link of an arm: motion publishes its pose in the robot's place."""

    fixed_to: Literal["chaser", "target"] = "target"
    """Body with which the frame moves: the target, as the arm that holds it, or the chaser, whose laboratory
    stands still."""
    pose: Pose = Field(default_factory=make_pose)
    """Pose of the frame in the axes of that body."""
    error: Pose = Field(default_factory=make_pose)
    """Pose of the published frame in the true frame: the error of the robot's encoders or of its
    calibration."""
    rate_hz: Positive = 50.0
    """Rate of the messages, Hz; a divisor of the truth's rate."""


class MotionConfig(Config):
    """Motion of chaser and target, and the sun."""

    trajectory: TrajectoryConfig = Field(default_factory=ApproachConfig)
    """Trajectory of the target relative to the chaser."""
    attitude: AttitudeConfig = Field(default_factory=FixedAttitudeConfig)
    """Attitude motion of the target."""
    sun: SunConfig | None = None
    """The sun; darkness if left out."""
    joints: dict[str, JointMotionConfig] = Field(default_factory=dict)
    """Motion of the target's joints, by name; one that is left out stays at 0 deg."""
    slew: SlewConfig | None = None
    """Rotation of the chaser beside its trajectory; none if left out."""
    imu: ImuNoiseConfig | None = None
    """The chaser's IMU; it has none if left out."""
    command: CommandErrorConfig | None = None
    """The commands of a guidance, ``guidance/command``; none are published if left out."""
    bodies: dict[Name, BodyMotionConfig] = Field(default_factory=dict)
    """Frames of known bodies whose poses are published as ``bodies/<frame>/odometry``, by name."""

    def check_rates(self, truth_hz: float) -> None:
        """Check that each rate of readings divides a rate of the truth. Raises ``ValueError``."""
        rates = {f"motion.bodies.{name}.rate_hz": body.rate_hz for name, body in self.bodies.items()}
        if self.imu is not None:
            rates["motion.imu.rate_hz"] = self.imu.rate_hz
        if self.command is not None:
            rates["motion.command.rate_hz"] = self.command.rate_hz
        for field, rate_hz in rates.items():
            possible_hz = truth_hz / max(1, round(truth_hz / rate_hz))
            if not isclose(rate_hz, possible_hz, rel_tol=1e-6):
                raise ValueError(
                    f"{field} is {rate_hz:g}, needs a divisor of the truth's rate, {truth_hz:g} Hz: the "
                    f"nearest is {possible_hz:.6g}"
                )
