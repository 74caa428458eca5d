"""Info messages of sensors, which are latched."""

from typing import Any

from rpod_schemas.messages.header import build, read_stamp, write_header
from rpod_schemas.rmw.cdr import message_class
from rpod_schemas.types import LidarInfo, PmdInfo, SensorInfo


def read_pmd_info(message: Any) -> PmdInfo:
    """Read an rpod_msgs/PmdInfo."""
    read_stamp(message.header)
    return build(
        PmdInfo,
        modulation_frequency_hz=message.modulation_frequency_hz,
        integration_time_s=message.integration_time_s,
        electrons_per_count=message.electrons_per_count,
        saturation_count=message.saturation_count,
    )


def write_pmd_info(stamp_ns: int, frame_id: str, info: PmdInfo) -> Any:
    """Return an rpod_msgs/PmdInfo."""
    return message_class("rpod_msgs/msg/PmdInfo")(header=write_header(stamp_ns, frame_id), **dict(info))


def read_lidar_info(message: Any) -> LidarInfo:
    """Read an rpod_msgs/LidarInfo."""
    read_stamp(message.header)
    return build(
        LidarInfo,
        azimuth_rad=message.azimuth_rad,
        elevation_rad=message.elevation_rad,
        scan_time_s=message.scan_time_s,
        rows_are_elevation=message.rows_are_elevation,
        sigma_range_m=message.sigma_range_m,
    )


def write_lidar_info(stamp_ns: int, frame_id: str, info: LidarInfo) -> Any:
    """Return an rpod_msgs/LidarInfo."""
    fields = {name: value for name, value in info if name != "row_azimuth_rad"}
    return message_class("rpod_msgs/msg/LidarInfo")(header=write_header(stamp_ns, frame_id), **fields)


_READERS = {"rpod_msgs/msg/PmdInfo": read_pmd_info, "rpod_msgs/msg/LidarInfo": read_lidar_info}


def read_info(message: Any) -> SensorInfo:
    """Read the info of a camera or a LIDAR, by the type of its message."""
    return _READERS[message.__msgtype__](message)
