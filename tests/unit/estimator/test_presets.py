"""The shipped presets: each is loaded, and a frame in its driver's layout is played through the port.

The clouds of tests/recordings/point_clouds were written by open tools; README.md there tells how.
"""

import runpy
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from rpod_estimator.frame_reader import FrameReader
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import methods_of
from rpod_runtime import Received
from rpod_runtime.frames import PartRejectedError
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator import EstimatorConfig, LidarInput
from rpod_schemas.messages import write_camera, write_header, write_image
from rpod_schemas.rmw.cdr import decode, encode, message_class
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import Topic
from rpod_schemas.types import Camera
from rpod_target import load_target

FOLDER = Path(__file__).parents[3] / "deploy" / "sensors"
CLOUDS = Path(__file__).parents[2] / "recordings" / "point_clouds"
SEEN = SimpleNamespace(**runpy.run_path(str(CLOUDS / "packets.py")))
"""The scene of the clouds: the mock-up moves."""
STAMP_NS = 1_700_000_000_250_000_000
CAMERA = Camera(width=60, height=40, fx=50.0, fy=51.0, cx=29.5, cy=19.5)
WIDE = CAMERA.model_copy(update={"distortion": np.array([5.26, 3.55, 4e-5, -9e-5, 0.18, 5.59, 5.41, 0.95])})
MILLIMETRES = np.full((40, 60), 2000, np.uint16)
METRES = np.full((40, 60), 2.0, np.float32)
SIGNAL = np.random.default_rng(1).integers(100, 200, (40, 60))
NUMBERS = {"u1": 2, "u2": 4, "u4": 6, "f4": 7, "f8": 8}
XYZ = [("x", "f4", 0), ("y", "f4", 4), ("z", "f4", 8)]
RING = [*XYZ, ("intensity", "f4", 12), ("ring", "u2", 16)]
OUSTER = [*XYZ, ("intensity", "f4", 16), ("t", "u4", 20), ("ring", "u2", 26), ("range", "u4", 32)]


def image(pixels, encoding):
    return write_image(STAMP_NS, "optical", pixels, encoding)


def depth_camera(depth, amplitude, camera=CAMERA):
    return {"depth": depth, "camera_info": write_camera(STAMP_NS, "optical", camera), "amplitude": amplitude}


def cloud(fields, step, times, *, rows=1):
    """Return a wall 5 m ahead (x), seen by a head that turns about z, from left to right in 0.02 s."""
    azimuth, elevation = np.meshgrid(np.radians(np.linspace(20, -20, 21)), np.radians(np.linspace(8, -8, 9)))
    points = np.zeros(
        azimuth.shape,
        np.dtype(
            {
                "names": [name for name, _, _ in fields],
                "formats": ["<" + kind for _, kind, _ in fields],
                "offsets": [offset for _, _, offset in fields],
                "itemsize": step,
            }
        ),
    )
    points["x"], points["y"] = 5.0, 5.0 * np.tan(azimuth)
    points["z"] = 5.0 / np.cos(azimuth) * np.tan(elevation)
    name, make = times
    points[name] = make(np.broadcast_to(np.linspace(0.04, 0.06, 21), azimuth.shape))
    points = points.reshape((9, 21) if rows > 1 else (1, -1))
    field = message_class("sensor_msgs/msg/PointField")
    return message_class("sensor_msgs/msg/PointCloud2")(
        header=write_header(STAMP_NS, "lidar"),
        height=points.shape[0],
        width=points.shape[1],
        fields=[field(name=n, offset=o, datatype=NUMBERS[kind], count=1) for n, kind, o in fields],
        is_bigendian=False,
        point_step=step,
        row_step=step * points.shape[1],
        data=points.reshape(-1).view(np.uint8),
        is_dense=True,
    )


CAMERAS = {
    "realsense": partial(depth_camera, image(MILLIMETRES, "16UC1"), image(SIGNAL.astype("u1"), "mono8")),
    "azure-kinect": partial(
        depth_camera, image(MILLIMETRES, "16UC1"), image(SIGNAL.astype("u2"), "mono16"), WIDE
    ),
    "ifm-o3r": partial(depth_camera, image(METRES, "32FC1"), image(SIGNAL.astype("f4"), "32FC1")),
    "pico-flexx": partial(depth_camera, image(METRES, "32FC1"), image(SIGNAL.astype("u2"), "mono16")),
    "orbbec": partial(depth_camera, image(MILLIMETRES, "16UC1"), image(SIGNAL.astype("u2"), "mono16")),
}
LIDARS = {
    "ouster": partial(cloud, OUSTER, 48, ("t", lambda since_s: since_s * 1e9), rows=9),
    "velodyne": partial(cloud, [*RING, ("time", "f4", 18)], 22, ("time", lambda since_s: since_s - 0.1)),
    "hesai": partial(
        cloud, [*RING, ("timestamp", "f8", 18)], 26, ("timestamp", lambda since_s: STAMP_NS * 1e-9 + since_s)
    ),
    "livox": partial(
        cloud,
        [*XYZ, ("intensity", "f4", 12), ("tag", "u1", 16), ("line", "u1", 17), ("timestamp", "f8", 18)],
        26,
        ("timestamp", lambda since_s: STAMP_NS + since_s * 1e9),
    ),
}


def played(kind, name, messages):
    """Return the measurement that the configured port makes of a driver's messages."""
    sensor = {"kind": kind, "source": str(FOLDER / f"{name}.yaml"), "T_chaser_sensor": {}}
    port = FrameReader(check(EstimatorConfig, {"target": "mockup", "sensors": [sensor]}, source=name).sensors)
    topics = dict(zip((part for _, part in port.parts.values()), port.streams, strict=True))
    frames = []
    for part, message in messages.items():
        topic = Topic(topics[part].name, message.__msgtype__)
        assert topic == topics[part]
        payload = memoryview(bytes(encode(message)))
        received = Received(topic, "k", payload, Attachment(0, 0, bytes(16)), 0, 0.0)
        frames += port.assemblers[kind].add(part, port.stamp_ns(kind, received), received)
    return port.measurement(kind, frames[0]), port.infos[kind]


def test_every_preset_is_played() -> None:
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {*CAMERAS, *LIDARS}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_depth_camera_of_a_preset_is_read(name):
    measurement, _ = played("pmd", name, CAMERAS[name]())
    frame = measurement.data
    np.testing.assert_array_equal(frame.amplitude, SIGNAL)
    column, row = 10, 5
    slope = np.hypot((column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy)
    expected = 2.0 / np.hypot(1.0, slope) if name == "ifm-o3r" else 2.0
    assert frame.depth_m[row, column] == pytest.approx(expected, rel=1e-4)
    assert frame.camera.distortion.size == (8 if name == "azure-kinect" else 5)


@pytest.mark.parametrize("name", LIDARS)
def test_a_lidar_of_a_preset_is_read(name):
    measurement, info = played("lidar", name, {"points": LIDARS[name]()})
    scan = measurement.data
    points = scan.points_m.reshape(-1, 3)
    assert np.abs(points[:, 2] - 5.0).max() < 1e-5  # the wall is ahead
    turned = measurement.T_chaser_sensor.apply(points.astype(float))
    assert np.abs(turned[:, 0] - 5.0).max() < 1e-5  # along x of the frame that the driver names
    np.testing.assert_allclose([scan.time_s.min(), scan.time_s.max()], [-0.01, 0.01], atol=1e-4)
    middle_ns = STAMP_NS + (-1 if name == "velodyne" else 1) * 50_000_000
    assert measurement.stamp_ns == middle_ns
    assert scan.organised == (name == "ouster")
    steps = (
        np.degrees(np.abs(np.median(np.diff(info.azimuth_rad)))),
        np.degrees(np.abs(np.median(np.diff(info.elevation_rad)))),
    )
    np.testing.assert_allclose(steps, [2.0, 2.0], rtol=0.05)


def recorded(name):
    return decode((CLOUDS / f"{name}.cdr").read_bytes(), "sensor_msgs/msg/PointCloud2")


def beside_the_surface_m(points_m):
    """Return the distance of points to the mock-up's surface, target axes."""
    field = load_target("mockup").require_field()
    axes = [
        origin + field.spacing_m * np.arange(count)
        for origin, count in zip(field.origin_m, field.values.shape, strict=True)
    ]
    return RegularGridInterpolator(axes, field.values)(points_m)


@pytest.mark.parametrize(
    ("name", "preset", "returns", "off_deg", "off_m"),
    [
        ("velodyne", "velodyne", 210, 0.6, 0.005),
        ("velodyne-decoder", "velodyne", 210, 0.6, 0.005),
        ("hesai", "hesai", 455, 0.3, 0.030),  # measured 25 ms before its stamp, at 1 m/s
        ("livox", "livox", 162, 2.5, 0.020),  # takes 0.1 s
        ("py-livox2", "livox", 162, 2.5, 0.020),
    ],
)
def test_a_cloud_of_open_tools_shows_the_moving_mockup_at_the_time_of_each_point(
    name, preset, returns, off_deg, off_m
):
    measurement, info = played("lidar", preset, {"points": recorded(name)})
    scan = measurement.data
    points_m = scan.points_m.reshape(-1, 3).astype(float)
    hit = np.isfinite(points_m).all(axis=1) & points_m.any(axis=1)
    assert hit.sum() == returns
    stamp_s = measurement.stamp_ns * 1e-9 - SEEN.BEGIN_S
    since_s = stamp_s + scan.time_s.reshape(-1)[hit]
    seen_m = measurement.T_chaser_sensor.apply(points_m[hit])
    beside_m = beside_the_surface_m((seen_m - SEEN.origin_m(since_s)) @ SEEN.rotation())
    assert np.abs(beside_m).max() < 0.004
    assert np.sqrt(np.mean(beside_m**2)) < 0.001  # 5 ms are 2 to 3 mm
    found = methods_of(LidarInput(), load_target("mockup"), ScanPattern.of(info)).acquirer.acquire(scan)
    assert found.begins_track, found.belief.refusal
    pose = measurement.T_chaser_sensor * found.pose
    turned = Rotation.from_matrix(SEEN.rotation()).inv() * pose.rotation
    assert np.degrees(turned.magnitude()) < off_deg
    assert np.linalg.norm(pose.translation - SEEN.origin_m(stamp_s)) < off_m


def test_a_field_of_a_name_that_is_no_time_is_not_read_as_one():
    """What hydra4 calls ``stamp`` spans 350 s, since it adds microseconds as seconds."""
    scan = played("lidar", "hesai", {"points": recorded("hydra4")})[0].data
    others = played("lidar", "hesai", {"points": recorded("hesai")})[0].data
    np.testing.assert_array_equal(scan.points_m, others.points_m)
    assert not np.any(scan.time_s)


def test_a_row_step_of_0_is_read_in_a_single_row_alone():
    """velodyne_pointcloud left it at 0 until 2021 (its pull request 404)."""
    message = recorded("velodyne")
    message.row_step = 0
    assert played("lidar", "velodyne", {"points": message})[0].data.points_m.shape == (210, 3)
    message.height, message.width = 2, 105
    with pytest.raises(PartRejectedError, match=r"row_step is 0 bytes, needs 2,310 or more .* set row_step"):
        played("lidar", "velodyne", {"points": message})
