"""Readings of the chaser's IMU."""

from typing import Any

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.geometry import read_rotation, read_vector, write_quaternion, write_vector
from rpod_schemas.messages.header import build, read_stamp, write_header
from rpod_schemas.rmw.cdr import message_class
from rpod_schemas.topics import CHASER
from rpod_schemas.types import ImuReading

_ABSENT = -1.0
"""First element of the covariance of what is not measured, as sensor_msgs/Imu has it."""


def read_imu(message: Any) -> ImuReading:
    """Read a sensor_msgs/Imu in chaser axes."""
    if message.header.frame_id != CHASER:
        raise MessageRejectedError(
            Reason.MALFORMED, f"frame_id is {message.header.frame_id!r}, needs {CHASER!r}: turn the readings"
        )
    rate_variance = _variance(message.angular_velocity_covariance, "angular velocity")
    attitude_variance = _variance(message.orientation_covariance, "orientation")
    force_variance = _variance(message.linear_acceleration_covariance, "linear acceleration")
    if rate_variance is None:
        raise MessageRejectedError(Reason.MALFORMED, "angular velocity is absent; the estimator needs it")
    return build(
        ImuReading,
        stamp_ns=read_stamp(message.header),
        frame_id=message.header.frame_id,
        rate_rad_s=read_vector(message.angular_velocity),
        rate_variance=rate_variance,
        force_m_s2=None if force_variance is None else read_vector(message.linear_acceleration),
        force_variance=force_variance or 0.0,
        R_orbit_chaser=None if attitude_variance is None else read_rotation(message.orientation),
        attitude_variance=attitude_variance or 0.0,
    )


def write_imu(reading: ImuReading) -> Any:
    """Return a sensor_msgs/Imu; variances of 0 are not stated."""
    attitude, force = reading.R_orbit_chaser, reading.force_m_s2
    return message_class("sensor_msgs/msg/Imu")(
        header=write_header(reading.stamp_ns, reading.frame_id),
        orientation=write_quaternion(attitude) if attitude is not None else _no_rotation(),
        orientation_covariance=_covariance(reading.attitude_variance if attitude is not None else None),
        angular_velocity=write_vector(reading.rate_rad_s),
        angular_velocity_covariance=_covariance(reading.rate_variance),
        linear_acceleration=write_vector(force if force is not None else np.zeros(3)),
        linear_acceleration_covariance=_covariance(reading.force_variance if force is not None else None),
    )


def _variance(covariance: FloatArray, field: str) -> float | None:
    """Return the mean variance of a covariance, shape (9,); None where it says that nothing is measured."""
    variances = covariance[[0, 4, 8]]
    if not np.isfinite(variances).all():
        raise MessageRejectedError(Reason.NOT_FINITE, f"{field} covariance holds a value that is not finite")
    return None if variances[0] == _ABSENT else float(variances.mean())


def _no_rotation() -> Any:
    return message_class("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=0.0, w=1.0)


def _covariance(variance: float | None) -> FloatArray:
    if variance is None:
        return np.concatenate([[_ABSENT], np.zeros(8)])
    return (variance * np.eye(3)).ravel()
