"""A recording as a sensor: each form is played at its pace, and what is left out is told."""

import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from rpod_driver.adapters.replay.config import ReplayConfig
from rpod_driver.adapters.replay.driver import open_driver
from rpod_driver.errors import MissingSdkError, RecordingError
from rpod_geometry.lens import ray_cosines
from rpod_schemas.messages import write_camera, write_image, write_lidar_info, write_pmd_info, write_points
from rpod_schemas.registry import resolve
from rpod_schemas.rmw.cdr import encode, typestore
from rpod_schemas.types import Camera, LidarInfo, PmdInfo

CAMERA = Camera(width=8, height=6, fx=6.0, fy=6.0, cx=3.5, cy=2.5)
BOTTLE = Path(__file__).parents[2] / "recordings" / "depth_bottle"
START_NS = 1_600_000_000_000_000_000
PERIOD_NS = 20_000_000
INFO = PmdInfo(
    modulation_frequency_hz=[2e7], integration_time_s=1e-3, electrons_per_count=9, saturation_count=99
)


def depth(number):
    return np.full((6, 8), 1.0 + number, np.float32)


def written(folder: Path, plugin: StoragePlugin, messages) -> Path:
    """Write a rosbag2 of (topic, message, stamp)."""
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, message, stamp_ns in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=typestore())
            writer.write(connections[topic], stamp_ns, bytes(encode(message)))
    return folder


def camera_messages(
    count=4,
    *,
    depth_topic="/front/depth/image_raw",
    info_topic="/front/camera_info",
    period_ns=PERIOD_NS,
):
    yield "/front/info", write_pmd_info(START_NS, "front_optical", INFO), START_NS
    for number in range(count):
        stamp_ns = START_NS + number * period_ns
        yield info_topic, write_camera(stamp_ns, "front_optical", CAMERA), stamp_ns
        image = write_image(stamp_ns, "front_optical", depth(number), "32FC1")
        yield depth_topic, image, stamp_ns


def driver(kind="pmd", **device):
    told = {"name": "front", "kind": kind, "device": {"speed": 100.0} | device}
    return open_driver(ReplayConfig.model_validate(told))


def played(opened):
    opened.connect()
    frames = [frame for frame in opened.frames() if frame is not None]
    opened.close()
    return frames


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_a_rosbag_is_played_at_its_pace_as_if_taken_now(tmp_path, plugin):
    bag = written(tmp_path / "bag", plugin, camera_messages())
    opened = driver(bag=bag, speed=2.0)
    begun_ns = time.time_ns()
    frames = played(opened)
    assert opened.connect().modulation_frequency_hz.tolist() == [2e7]
    assert [frame.depth_m[0, 0] for frame in frames] == [1.0, 2.0, 3.0, 4.0]
    assert np.diff([frame.stamp_ns for frame in frames]).tolist() == [PERIOD_NS // 2] * 3
    assert frames[0].stamp_ns >= begun_ns
    assert time.time_ns() >= frames[-1].stamp_ns


def test_a_single_mcap_file_is_a_recording(tmp_path):
    bag = written(tmp_path / "bag", StoragePlugin.MCAP, camera_messages())
    (file,) = bag.glob("*.mcap")
    assert len(played(driver(bag=file))) == 4


def test_a_foreign_driver_is_read_by_its_source(tmp_path):
    topics = {"depth": "/cam/distance", "camera_info": "/cam/camera_info"}
    messages = camera_messages(depth_topic="/cam/distance", info_topic="/cam/camera_info")
    bag = written(tmp_path / "bag", StoragePlugin.SQLITE3, messages)
    frames = played(driver(bag=bag, source={"topics": topics, "depth": "radial"}))
    assert np.allclose(frames[1].depth_m, 2.0 * ray_cosines(CAMERA), rtol=1e-6)


def test_a_lidar_is_played_with_its_pattern_and_its_times(tmp_path):
    info = LidarInfo(
        azimuth_rad=np.linspace(-0.3, 0.3, 5),
        elevation_rad=np.linspace(-0.2, 0.2, 3),
        scan_time_s=0.1,
        sigma_range_m=0.01,
    )
    ones = np.ones((3, 5), np.float32)
    fields = {"x": ones * 0.1, "y": ones * 0.2, "z": ones, "intensity": ones, "t": ones * 0.01}
    messages = [
        ("/front/info", write_lidar_info(START_NS, "front", info), START_NS),
        ("/front/points", write_points(START_NS, "front", fields), START_NS),
    ]
    opened = driver("lidar", bag=written(tmp_path / "bag", StoragePlugin.MCAP, messages))
    assert opened.connect().azimuth_rad.size == 5
    (scan,) = played(opened)
    assert scan.points_m.shape == (3, 5, 3)
    assert np.allclose(scan.time_s, 0.01)


def test_a_repeated_recording_goes_on_in_time(tmp_path):
    bag = written(tmp_path / "bag", StoragePlugin.SQLITE3, camera_messages(3))
    frames = played(driver(bag=bag, repeat=3))
    steps = np.diff([frame.stamp_ns for frame in frames])
    assert len(frames) == 9
    assert (steps == PERIOD_NS // 100).all()


def test_a_gap_of_the_recording_is_announced_until_its_end(tmp_path):
    first, second = camera_messages(2, period_ns=70 * 10**9), None
    opened = driver(bag=written(tmp_path / "bag", StoragePlugin.MCAP, first))
    opened.connect()
    assert opened.due_s() < time.monotonic()
    for frame in opened.frames():
        if frame is None:
            assert 0.0 <= opened.due_s() - time.monotonic() < 0.7
            second = opened.due_s()
    assert second is not None
    assert opened.due_s() < time.monotonic()


def test_what_is_left_out_is_told_with_the_reason(tmp_path, caplog):
    messages = list(camera_messages(4))
    messages[4] = (
        messages[4][0],
        write_image(START_NS + PERIOD_NS, "", depth(1)[:, :5], "32FC1"),
        messages[4][2],
    )
    frames = played(driver(bag=written(tmp_path / "bag", StoragePlugin.MCAP, messages)))
    assert len(frames) == 3
    assert "1 frames of" in caplog.text
    assert "image is 5 x 6 pixels, camera_info says 8 x 6" in caplog.text


def test_a_recording_without_the_topics_says_what_it_holds(tmp_path):
    bag = written(tmp_path / "bag", StoragePlugin.MCAP, camera_messages(1, depth_topic="/cam/depth"))
    with pytest.raises(
        RecordingError, match=r"lacks front/depth/image_raw .*cam/depth \(sensor_msgs/msg/Image\)"
    ):
        driver(bag=bag)


@pytest.mark.parametrize("content", [None, b"", b"no recording" * 100])
def test_what_is_no_recording_is_refused(tmp_path, content):
    file = tmp_path / "run.mcap"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(RecordingError, match="is no rosbag2 or MCAP file"):
        driver(bag=file)


def images(folder: Path, **changes):
    for number in range(3):
        counts = np.full((6, 8), 1000 * (number + 1), np.uint16)
        counts[0, 0], counts[0, 1] = 0, 65535
        cv2.imwrite(str(folder / f"depth_{number}.png"), counts)
        cv2.imwrite(str(folder / f"grey_{number}.png"), np.full((6, 8), number, np.uint8))
    lens = {"width": 8, "height": 6, "fx": 6.0, "fy": 6.0, "cx": 3.5, "cy": 2.5}
    return {"folder": folder, "depth": "depth_*.png", "camera": lens, "rate_hz": 50} | changes


def test_a_folder_of_images_is_a_camera(tmp_path):
    frames = played(driver(images=images(tmp_path, amplitude="grey_*.png"), speed=1.0))
    assert [float(frame.depth_m[1, 1]) for frame in frames] == [1.0, 2.0, 3.0]
    assert np.isnan(frames[0].depth_m[0, :2]).all()
    assert [int(frame.amplitude[0, 0]) for frame in frames] == [0, 1, 2]
    assert np.diff([frame.stamp_ns for frame in frames]).tolist() == [PERIOD_NS] * 2


def test_a_frame_of_a_real_stereo_camera_is_played():
    camera = {"width": 848, "height": 480, "fx": 425.773, "fy": 425.773, "cx": 427.202, "cy": 237.662}
    (frame,) = played(driver(images={"folder": BOTTLE, "depth": "depth.png", "camera": camera}))
    assert np.isfinite(frame.depth_m).mean() == pytest.approx(0.643, abs=1e-3)
    assert np.nanmedian(frame.depth_m) == pytest.approx(0.55, abs=0.01)


def test_radial_images_become_z_depth(tmp_path):
    frames = played(driver(images=images(tmp_path, radial=True, metres_per_count=0.002)))
    assert np.allclose(frames[0].depth_m[1:], 2.0 * ray_cosines(CAMERA)[1:], rtol=1e-6)


def test_images_without_opencv_say_what_to_install(tmp_path, monkeypatch):
    given = images(tmp_path)
    monkeypatch.setitem(sys.modules, "cv2", None)
    resolve.cache_clear()
    with pytest.raises(MissingSdkError, match=r"images need pip install 'rpod\[estimator\]'"):
        driver(images=given)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"depth": "none_*.png"}, "holds no image 'none_"),
        ({"depth": "grey_*.png"}, r"type uint8, needs \(6, 8\)"),
        ({"amplitude": "grey_0.png"}, r"holds 3 images 'depth_\*.png' and 1 "),
        ({"camera": {"width": 9, "height": 6, "fx": 6, "fy": 6, "cx": 3, "cy": 2}}, r"needs \(6, 9\)"),
    ],
)
def test_images_that_cannot_be_used_are_refused_by_name(tmp_path, changes, reason):
    with pytest.raises(RecordingError, match=reason):
        driver(images=images(tmp_path, **changes))


@pytest.mark.parametrize(
    ("kind", "device", "reason"),
    [("pmd", {}, "needs either bag"), ("lidar", {"images": None, "bag": None}, "needs either bag")],
)
def test_a_configuration_names_one_recording(kind, device, reason):
    with pytest.raises(ValidationError, match=reason):
        driver(kind, **device)


def test_images_are_of_a_camera(tmp_path):
    with pytest.raises(ValidationError, match="images are of a camera"):
        driver("lidar", images=images(tmp_path))


def test_a_recording_is_opened_once_a_pass_and_not_for_each_frame(tmp_path, monkeypatch):
    bag = written(tmp_path / "bag", StoragePlugin.MCAP, camera_messages(count=20))
    opened, read = driver(bag=bag), []

    class Counted(Reader):
        def __init__(self, *paths):
            read.append(paths)
            super().__init__(*paths)

    monkeypatch.setattr("rpod_driver.adapters.replay.bag.Reader", Counted)
    assert len(played(opened)) == 20
    assert len(read) == 3  # for the info at connect and for the stamps, and for the frames
