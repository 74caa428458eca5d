"""Accelerations that the chaser's guidance commands."""

from typing import Any

import numpy as np

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.geometry import read_vector, write_vector
from rpod_schemas.messages.header import build, read_stamp, write_header
from rpod_schemas.rmw.cdr import message_class
from rpod_schemas.topics import CHASER
from rpod_schemas.types import Command

_LINEAR = [0, 7, 14]
"""Places of the linear variances in the covariance of (linear, angular), shape (36,)."""


def read_command(message: Any) -> Command:
    """Read a geometry_msgs/AccelWithCovarianceStamped in chaser axes; its angular part is not used."""
    if message.header.frame_id != CHASER:
        raise MessageRejectedError(
            Reason.MALFORMED, f"frame_id is {message.header.frame_id!r}, needs {CHASER!r}: turn the command"
        )
    variances = message.accel.covariance[_LINEAR]
    if not np.isfinite(variances).all():
        raise MessageRejectedError(
            Reason.NOT_FINITE, "linear covariance holds a value that is not finite; send 0 for unknown"
        )
    if (variances < 0.0).any():
        raise MessageRejectedError(
            Reason.MALFORMED,
            f"linear covariance holds the variance {variances.min():g} (m/s2)^2, needs 0 or more; send 0 "
            "for unknown",
        )
    return build(
        Command,
        stamp_ns=read_stamp(message.header),
        frame_id=message.header.frame_id,
        acceleration_m_s2=read_vector(message.accel.accel.linear),
        variance=float(variances.mean()),
    )


def write_command(command: Command) -> Any:
    """Return a geometry_msgs/AccelWithCovarianceStamped; a variance of 0 is not stated."""
    covariance = np.zeros(36)
    covariance[_LINEAR] = command.variance
    accel = message_class("geometry_msgs/msg/Accel")(
        linear=write_vector(command.acceleration_m_s2), angular=write_vector(np.zeros(3))
    )
    return message_class("geometry_msgs/msg/AccelWithCovarianceStamped")(
        header=write_header(command.stamp_ns, command.frame_id),
        accel=message_class("geometry_msgs/msg/AccelWithCovariance")(accel=accel, covariance=covariance),
    )
