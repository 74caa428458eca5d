"""Angles of the target's joints."""

from typing import Any

import numpy as np

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.header import read_stamp, read_text, write_header
from rpod_schemas.rmw.cdr import message_class
from rpod_schemas.types import Joints


def write_joints(joints: Joints) -> Any:
    """Return a sensor_msgs/JointState."""
    return message_class("sensor_msgs/msg/JointState")(
        header=write_header(joints.stamp_ns, ""),
        name=list(joints.angle_rad),
        position=np.array([*joints.angle_rad.values()], np.float64),
        velocity=np.array([joints.rate_rad_s[name] for name in joints.angle_rad], np.float64),
        effort=np.zeros(0),
    )


def read_joints(message: Any) -> Joints:
    """Read a sensor_msgs/JointState; rates that are left out are 0."""
    names = [read_text("name", name) for name in message.name]
    angles, rates = np.asarray(message.position, np.float64), np.asarray(message.velocity, np.float64)
    rates = rates if rates.size else np.zeros(len(names))
    if not len(names) == angles.size == rates.size:
        raise MessageRejectedError(
            Reason.MALFORMED, f"{len(names)} names, {angles.size} positions, {rates.size} velocities"
        )
    if not (np.isfinite(angles).all() and np.isfinite(rates).all()):
        raise MessageRejectedError(
            Reason.NOT_FINITE, "position or velocity of a joint holds a value that is not finite"
        )
    return Joints(
        stamp_ns=read_stamp(message.header),
        angle_rad=dict(zip(names, angles.tolist(), strict=True)),
        rate_rad_s=dict(zip(names, rates.tolist(), strict=True)),
    )
