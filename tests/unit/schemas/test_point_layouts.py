"""Point clouds in the layouts of well-known drivers: types, offsets and times as their sources have them."""

import numpy as np
import pytest

from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_points, time_field, write_header
from rpod_schemas.rmw.cdr import decode, encode, message_class

STAMP_NS = 1_700_000_000_250_000_000
SINCE_S = np.linspace(0.0, 0.09, 6)
NUMBERS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}

LAYOUTS = {
    # ouster-lidar/ouster-ros, ouster-ros/include/ouster_ros/os_point.h, commit 24d9c7e: a PCL point, whose
    # x, y, z fill 16 bytes; t in ns from the stamp, that of the first column
    "ouster": (
        48,
        {"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 16), "t": ("u4", 20),
         "reflectivity": ("u2", 24), "ring": ("u2", 26), "ambient": ("u2", 28), "range": ("u4", 32)},
        "t", SINCE_S * 1e9,
    ),
    # ros-drivers/velodyne 2.x, velodyne_pointcloud/src/lib/pointcloudXYZIRT.cpp, commit 571758d
    "velodyne": (
        22,
        {"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 12), "ring": ("u2", 16),
         "time": ("f4", 18)},
        "time", SINCE_S,
    ),
    # HesaiTechnology/HesaiLidar_ROS_2.0, src/manager/source_driver_ros2.hpp, commit 1aaa05a
    "hesai": (
        26,
        {"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 12), "ring": ("u2", 16),
         "timestamp": ("f8", 18)},
        "timestamp", SINCE_S + STAMP_NS * 1e-9,
    ),
    # Livox-SDK/livox_ros_driver2 1.2, src/lddc.cpp, PointCloud2 format (xfer_format 0): absolute ns
    "livox": (
        26,
        {"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "intensity": ("f4", 12), "tag": ("u1", 16),
         "line": ("u1", 17), "timestamp": ("f8", 18)},
        "timestamp", SINCE_S * 1e9 + STAMP_NS,
    ),
    # the same driver's CustomMsg, as converters write it into a cloud
    "livox custom": (
        20,
        {"x": ("f4", 0), "y": ("f4", 4), "z": ("f4", 8), "reflectivity": ("u1", 12),
         "offset_time": ("u4", 16)},
        "offset_time", SINCE_S * 1e9,
    ),
    "milliseconds": (
        24, {"x": ("f8", 0), "y": ("f4", 8), "z": ("f4", 12), "time": ("f8", 16)}, "time", SINCE_S * 1e3,
    ),
}  # fmt: skip


def cloud(layout, *, big_endian=False, values=None, shape=(2, 3)):
    step, fields, time, times = LAYOUTS[layout]
    order = ">" if big_endian else "<"
    points = np.zeros(
        6,
        np.dtype(
            {
                "names": list(fields),
                "formats": [order + kind for kind, _ in fields.values()],
                "offsets": [offset for _, offset in fields.values()],
                "itemsize": step,
            }
        ),
    )
    for number, name in enumerate(("x", "y", "z")):
        points[name] = np.arange(6) + 10.0 * number
    points[time] = times if values is None else values
    field = message_class("sensor_msgs/msg/PointField")
    message = message_class("sensor_msgs/msg/PointCloud2")(
        header=write_header(STAMP_NS, "os_lidar"),
        height=shape[0],
        width=shape[1],
        fields=[
            field(name=name, offset=offset, datatype=NUMBERS[kind], count=1)
            for name, (kind, offset) in fields.items()
        ],
        is_bigendian=big_endian,
        point_step=step,
        row_step=step * shape[1],
        data=points.view(np.uint8),
        is_dense=True,
    )
    return decode(bytes(encode(message)), message.__msgtype__)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("big_endian", [False, True])
def test_the_points_and_their_times_are_read(layout, big_endian):
    fields = read_points(cloud(layout, big_endian=big_endian))
    np.testing.assert_array_equal(fields["y"], (np.arange(6) + 10.0).reshape(2, 3))
    np.testing.assert_allclose(fields["t"], SINCE_S.reshape(2, 3), atol=1e-6)
    assert {values.dtype.name for values in fields.values()} == {"float32"}


def test_an_unorganised_cloud_stays_so():
    assert read_points(cloud("velodyne", shape=(1, 6)))["t"].shape == (6,)


@pytest.mark.parametrize("layout", ["hesai", "livox"])
def test_rays_without_a_return_that_are_filled_with_zeros_have_no_time(layout):
    times = LAYOUTS[layout][3].copy()
    times[1] = 0.0
    message = cloud(layout, values=times)
    empty = slice(message.point_step, message.point_step + 12)  # x, y and z of the second point
    data = np.array(message.data)
    data[empty] = 0
    message.data = data
    fields = read_points(message)
    np.testing.assert_array_equal(np.isnan(fields["t"].ravel()), np.arange(6) == 1)
    np.testing.assert_allclose(fields["t"].ravel()[2:], SINCE_S[2:], atol=1e-6)


@pytest.mark.parametrize("layout", ["hesai", "livox"])
def test_times_of_another_clock_are_left_out_not_refused(layout):
    message = cloud(layout, values=np.full(6, 8.5e5 * (1e9 if layout == "livox" else 1.0)))
    assert "t" not in read_points(message)
    assert time_field(message).name == "timestamp"


def test_a_cloud_without_coordinates_is_refused():
    message = cloud("ouster")
    message.fields[0].name = "range_x"
    with pytest.raises(MessageRejectedError, match="point fields x are missing"):
        read_points(message)
    message.fields[1].datatype = 12
    message.fields[0].name = "x"
    with pytest.raises(MessageRejectedError, match="'y' is no number"):
        read_points(message)
