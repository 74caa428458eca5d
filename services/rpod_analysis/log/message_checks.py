"""Checks that a logged message can be read, as fast as its type allows.

A report reads every message of a log. Poses at 250 Hz and images are checked by their numbers only; small or
rare messages are decoded completely, as in a service.
"""

from collections.abc import Callable
from typing import Any

from rpod_analysis.log.logged import Logged
from rpod_schemas.bounds import POSITION_M
from rpod_schemas.messages import (
    read_camera,
    read_image,
    read_lidar_info,
    read_pmd_info,
    read_points,
    read_pose,
    read_stamp,
    read_transforms,
    read_vector_stamped,
)
from rpod_schemas.rmw.cdr import is_known
from rpod_schemas.topics import (
    CAMERA_INFO,
    CLOCK,
    DEPTH,
    ESTIMATE_POSE,
    LIDAR_INFO,
    PMD_INFO,
    POINTS,
    SUN,
    TF,
    TRUTH,
)

_UNIT = 1e-3
"""Largest difference of a quaternion's squared norm from 1 without a complete check."""


def check_message(logged: Logged) -> None:
    """Raise ``MessageRejectedError`` if a message of a type of the ICD cannot be read."""
    if is_known(logged.type):
        message = logged.decode()
        if read := _READERS.get(logged.type):
            read(message)


def pose_numbers(pose: Any) -> tuple[float, float, float, float, float, float, float]:
    """Return x, y, z and the quaternion x, y, z, w of a geometry_msgs/Pose.

    Raises:
        MessageRejectedError: the pose is not valid.
    """
    p, q = pose.position, pose.orientation
    norm = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    most_m = POSITION_M.high  # each one is compared: the greatest of numbers may hide a NaN
    near = abs(p.x) <= most_m and abs(p.y) <= most_m and abs(p.z) <= most_m
    if not (near and abs(norm - 1.0) < _UNIT):
        read_pose(pose)  # raises the error with its reason
    return (p.x, p.y, p.z, q.x, q.y, q.z, q.w)


def _check_pose(message: Any) -> None:
    read_stamp(message.header)
    pose_numbers(message.pose.pose)


_READERS: dict[str, Callable[[Any], Any]] = {
    TRUTH.type: _check_pose,
    ESTIMATE_POSE.type: _check_pose,
    SUN.type: read_vector_stamped,
    TF.type: read_transforms,
    CLOCK.type: read_stamp,
    DEPTH.type: read_image,
    CAMERA_INFO.type: read_camera,
    PMD_INFO.type: read_pmd_info,
    POINTS.type: read_points,
    LIDAR_INFO.type: read_lidar_info,
}
"""Readers by message type."""
