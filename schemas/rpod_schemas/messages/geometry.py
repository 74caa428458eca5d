"""Poses, transforms and odometry."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.bounds import IRRADIANCE_W_M2, POSITION_M, RATE_RAD_S, SPEED_M_S, check_covariance
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages.header import (
    accepted,
    build,
    read_stamp,
    read_text,
    within,
    write_header,
    write_stamp,
)
from rpod_schemas.poses import covariance_at, make_pose, rotation_matrix, rotation_of
from rpod_schemas.rmw.cdr import message_class
from rpod_schemas.types import Odometry


def write_vector(value: NDArray[np.float64]) -> Any:
    """Return a geometry_msgs/Vector3 of a vector, shape (3,)."""
    return message_class("geometry_msgs/msg/Vector3")(x=float(value[0]), y=float(value[1]), z=float(value[2]))


def read_vector(value: Any, names: str = "xyz") -> NDArray[np.float64]:
    """Return the numbers of a vector or a quaternion, unchecked, shape (3,) or (4,)."""
    return np.array([getattr(value, name) for name in names])


def read_rotation(quaternion: Any) -> Rotation:
    """Read a geometry_msgs/Quaternion."""
    return Rotation.from_quat(_read_quaternion(quaternion))


def _read_quaternion(quaternion: Any) -> list[float]:
    """Return the checked numbers x, y, z, w: plain ones, since each check of an array takes microseconds."""
    numbers = [quaternion.x, quaternion.y, quaternion.z, quaternion.w]
    if not all(map(math.isfinite, numbers)):
        raise MessageRejectedError(Reason.NOT_FINITE, "orientation")
    norm = math.hypot(*numbers)
    if abs(norm - 1.0) > 1e-3:
        raise MessageRejectedError(Reason.MALFORMED, f"orientation of norm {norm:.4f}, needs 1")
    return numbers


def _read_translation(vector: Any) -> list[float]:
    numbers = [vector.x, vector.y, vector.z]
    if not all(map(math.isfinite, numbers)):
        raise MessageRejectedError(Reason.NOT_FINITE, "position")
    return [within(POSITION_M, "position", number) for number in numbers]


def _read_covariance(field: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
    covariance = values.reshape(6, 6)
    if not np.isfinite(covariance).all():
        raise MessageRejectedError(Reason.NOT_FINITE, f"{field} holds a value that is not finite")
    return accepted(check_covariance, field, covariance)


def write_quaternion(rotation: Rotation) -> Any:
    """Return a geometry_msgs/Quaternion."""
    x, y, z, w = rotation.as_quat()
    return message_class("geometry_msgs/msg/Quaternion")(x=float(x), y=float(y), z=float(z), w=float(w))


def write_pose(pose: RigidTransform) -> Any:
    """Return a geometry_msgs/Pose."""
    x, y, z = pose.translation
    point = message_class("geometry_msgs/msg/Point")(x=float(x), y=float(y), z=float(z))
    return message_class("geometry_msgs/msg/Pose")(
        position=point, orientation=write_quaternion(rotation_of(pose))
    )


def read_pose(message: Any) -> RigidTransform:
    """Read a geometry_msgs/Pose."""
    return make_pose(
        rotation=read_rotation(message.orientation), translation_m=_read_translation(message.position)
    )


def read_place(message: Any) -> list[float]:
    """Return the checked numbers of a geometry_msgs/Pose: quaternion x, y, z, w, then translation, m."""
    return _read_quaternion(message.orientation) + _read_translation(message.position)


def read_vector_stamped(message: Any) -> tuple[int, NDArray[np.float64]]:
    """Return stamp, ns, and vector, W/m2, shape (3,), of the Vector3Stamped of ``environment/sun``."""
    vector = read_vector(message.vector)
    if not np.isfinite(vector).all():
        raise MessageRejectedError(Reason.NOT_FINITE, "irradiance")
    within(IRRADIANCE_W_M2, "irradiance", float(np.hypot.reduce(vector)))
    return read_stamp(message.header), vector


def write_vector_stamped(stamp_ns: int, frame_id: str, vector: NDArray[np.float64]) -> Any:
    """Return a geometry_msgs/Vector3Stamped of a vector, shape (3,), in the axes of ``frame_id``."""
    return message_class("geometry_msgs/msg/Vector3Stamped")(
        header=write_header(stamp_ns, frame_id), vector=write_vector(vector)
    )


def write_clock(stamp_ns: int) -> Any:
    """Return a rosgraph_msgs/Clock."""
    return message_class("rosgraph_msgs/msg/Clock")(clock=write_stamp(stamp_ns))


def write_transforms(stamp_ns: int, transforms: Iterable[tuple[str, str, RigidTransform]]) -> Any:
    """Return a tf2_msgs/TFMessage of (parent, child, T_parent_child)."""
    return message_class("tf2_msgs/msg/TFMessage")(
        transforms=[
            message_class("geometry_msgs/msg/TransformStamped")(
                header=write_header(stamp_ns, parent),
                child_frame_id=child,
                transform=message_class("geometry_msgs/msg/Transform")(
                    translation=write_vector(pose.translation), rotation=write_quaternion(rotation_of(pose))
                ),
            )
            for parent, child, pose in transforms
        ]
    )


def read_transforms(message: Any) -> list[tuple[int, str, str, RigidTransform]]:
    """Return (stamp_ns, parent, child, T_parent_child) of a TFMessage."""
    return [
        (
            read_stamp(item.header),
            read_text("frame_id", item.header.frame_id),
            read_text("child_frame_id", item.child_frame_id),
            make_pose(
                rotation=read_rotation(item.transform.rotation),
                translation_m=_read_translation(item.transform.translation),
            ),
        )
        for item in message.transforms
    ]


def read_odometry(message: Any) -> Odometry:
    """Read a nav_msgs/Odometry."""
    twist = message.twist.twist
    return build(
        Odometry,
        stamp_ns=read_stamp(message.header),
        frame_id=message.header.frame_id,
        child_frame_id=message.child_frame_id,
        pose=read_pose(message.pose.pose),
        linear_m_s=within(SPEED_M_S, "linear velocity", read_vector(twist.linear)),
        angular_rad_s=within(RATE_RAD_S, "angular velocity", read_vector(twist.angular)),
        pose_covariance=_read_covariance("pose covariance", message.pose.covariance),
        twist_covariance=_read_covariance("twist covariance", message.twist.covariance),
    )


def write_odometry(odometry: Odometry) -> Any:
    """Return a nav_msgs/Odometry."""
    twist = message_class("geometry_msgs/msg/Twist")(
        linear=write_vector(odometry.linear_m_s), angular=write_vector(odometry.angular_rad_s)
    )
    return message_class("nav_msgs/msg/Odometry")(
        header=write_header(odometry.stamp_ns, odometry.frame_id),
        child_frame_id=odometry.child_frame_id,
        pose=_pose_with_covariance(odometry.pose, odometry.pose_covariance),
        twist=message_class("geometry_msgs/msg/TwistWithCovariance")(
            twist=twist, covariance=odometry.twist_covariance.ravel()
        ),
    )


def write_pose_stamped(odometry: Odometry, *, T_child_frame: RigidTransform | None = None) -> Any:
    """Return the pose of an odometry as geometry_msgs/PoseWithCovarianceStamped.

    With ``T_child_frame`` it is the pose of a frame that is fixed to the child, its covariance at its place.
    """
    pose, covariance = odometry.pose, odometry.pose_covariance
    if T_child_frame is not None:
        arm_m = rotation_matrix(pose) @ T_child_frame.translation
        pose, covariance = pose * T_child_frame, covariance_at(covariance, arm_m)
    return message_class("geometry_msgs/msg/PoseWithCovarianceStamped")(
        header=write_header(odometry.stamp_ns, odometry.frame_id),
        pose=_pose_with_covariance(pose, covariance),
    )


def _pose_with_covariance(pose: RigidTransform, covariance: NDArray[np.float64]) -> Any:
    return message_class("geometry_msgs/msg/PoseWithCovariance")(
        pose=write_pose(pose), covariance=covariance.ravel()
    )
