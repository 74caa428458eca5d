"""Motion as it is measured, commanded or estimated: odometry, an IMU, thrust, angles of joints."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.arrays import Matrix6, Vector3
from rpod_schemas.bounds import (
    ACCELERATION_M_S2,
    COMMAND_M_S2,
    COMMAND_VARIANCE,
    RATE_RAD_S,
    VARIANCE,
    Text,
    bounded,
)
from rpod_schemas.poses import Attitude, Pose
from rpod_schemas.types.base import ZERO_6X6, Model, Stamped


class Odometry(Stamped):
    """Pose and twist of ``child_frame_id`` in ``frame_id`` (ICD section 1)."""

    child_frame_id: Text
    pose: Pose
    """T_frame_child."""
    linear_m_s: Vector3
    """Velocity of the child's origin, R^T dp/dt, child axes, m/s."""
    angular_rad_s: Vector3
    """Rotation rate, vee(R^T dR/dt), child axes, rad/s."""
    pose_covariance: Matrix6 = Field(default_factory=lambda: ZERO_6X6)
    """Covariance of (dp, dtheta) in the fixed axes of ``frame_id``: m2, m rad, rad2."""
    twist_covariance: Matrix6 = Field(default_factory=lambda: ZERO_6X6)
    """Covariance of (linear, angular) in child axes."""


class ImuReading(Stamped):
    """Measurement of the chaser's IMU, chaser axes; None for a quantity that it does not measure."""

    rate_rad_s: Annotated[Vector3, bounded(RATE_RAD_S)]
    """Rate relative to inertial space, shape (3,)."""
    rate_variance: Annotated[float, bounded(VARIANCE)] = 0.0
    """Mean variance of the rate about the three axes, (rad/s)^2; 0 if it is not stated."""
    force_m_s2: Annotated[Vector3, bounded(ACCELERATION_M_S2)] | None = None
    """Specific force: acceleration without that of gravity, shape (3,)."""
    force_variance: Annotated[float, bounded(VARIANCE)] = 0.0
    """Mean variance of the specific force along the three axes, (m/s2)^2; 0 if it is not stated."""
    R_orbit_chaser: Attitude | None = None
    """Attitude in the orbital frame (ICD section 1)."""
    attitude_variance: Annotated[float, bounded(VARIANCE)] = 0.0
    """Mean variance of the attitude about the three axes, rad2; 0 if it is not stated."""


class Command(Stamped):
    """Acceleration that the chaser's thrusters are commanded to give it, chaser axes.

    It holds from its stamp until that of the next command, but no longer than a second (ICD section 2).
    """

    acceleration_m_s2: Annotated[Vector3, bounded(COMMAND_M_S2)]
    """Without that of gravity, shape (3,)."""
    variance: Annotated[float, bounded(COMMAND_VARIANCE)] = 0.0
    """Mean variance of the executed acceleration along the three axes, (m/s2)^2; 0 if it is not stated."""


class Joints(Model):
    """Angles of the target's joints, by name."""

    stamp_ns: int
    angle_rad: dict[str, float]
    rate_rad_s: dict[str, float]
