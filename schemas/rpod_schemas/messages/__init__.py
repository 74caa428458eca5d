"""Conversion of ROS messages to the domain types and back, where every field is checked.

``read_*`` take a decoded message and return a domain type, or raise ``MessageRejectedError`` with
the reason under which the message is counted. ``write_*`` are their inverses. Arrays stay views.
"""

from rpod_schemas.messages.command import read_command, write_command
from rpod_schemas.messages.geometry import (
    read_odometry,
    read_place,
    read_pose,
    read_transforms,
    read_vector_stamped,
    write_clock,
    write_odometry,
    write_pose,
    write_pose_stamped,
    write_transforms,
    write_vector_stamped,
)
from rpod_schemas.messages.header import build, read_stamp, write_header, write_stamp
from rpod_schemas.messages.health import (
    read_diagnostics,
    read_integrity,
    read_status,
    read_validity,
    write_diagnostics,
    write_integrity,
    write_status,
    write_validity,
)
from rpod_schemas.messages.images import (
    is_measured,
    pixel_format,
    read_amplitude,
    read_camera,
    read_depth,
    read_image,
    write_camera,
    write_compressed,
    write_image,
)
from rpod_schemas.messages.imu import read_imu, write_imu
from rpod_schemas.messages.info import (
    read_info,
    read_lidar_info,
    read_pmd_info,
    write_lidar_info,
    write_pmd_info,
)
from rpod_schemas.messages.joints import read_joints, write_joints
from rpod_schemas.messages.points import read_points, time_field, write_points
from rpod_schemas.rmw.cdr import NANOSECONDS

__all__ = [
    "NANOSECONDS",
    "build",
    "is_measured",
    "pixel_format",
    "read_amplitude",
    "read_camera",
    "read_command",
    "read_depth",
    "read_diagnostics",
    "read_image",
    "read_imu",
    "read_info",
    "read_integrity",
    "read_joints",
    "read_lidar_info",
    "read_odometry",
    "read_place",
    "read_pmd_info",
    "read_points",
    "read_pose",
    "read_stamp",
    "read_status",
    "read_transforms",
    "read_validity",
    "read_vector_stamped",
    "time_field",
    "write_camera",
    "write_clock",
    "write_command",
    "write_compressed",
    "write_diagnostics",
    "write_header",
    "write_image",
    "write_imu",
    "write_integrity",
    "write_joints",
    "write_lidar_info",
    "write_odometry",
    "write_pmd_info",
    "write_points",
    "write_pose",
    "write_pose_stamped",
    "write_stamp",
    "write_status",
    "write_transforms",
    "write_validity",
    "write_vector_stamped",
]
