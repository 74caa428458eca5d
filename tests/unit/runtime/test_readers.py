"""Readers of sensors: images as drivers send them, compressed, radial or saturated."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rpod_runtime import Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.frames import PartRejectedError, SensorReader, open_reader
from rpod_runtime.readers.lidar import LidarReader
from rpod_runtime.readers.pmd import PmdReader, saturated_pixels
from rpod_runtime.sensor_data.codecs import decompressed
from rpod_schemas.config.source import SourceConfig
from rpod_schemas.errors import ConfigurationError, MessageRejectedError
from rpod_schemas.messages import write_camera, write_header, write_image, write_lidar_info, write_points
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode, message_class
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.topics import AMPLITUDE, CAMERA_INFO, COMPRESSED_IMAGE, DEPTH, POINTS, Topic
from rpod_schemas.types import Camera, LidarInfo

CAMERA = Camera(width=60, height=40, fx=50.0, fy=51.0, cx=29.5, cy=19.5)
FORWARD = make_pose(translation_m=[0.5, 0.0, 0.2])
DEPTH_MM = np.arange(1000, 3400, dtype=np.uint16).reshape(40, 60)


def received(topic, message):
    return Received(topic, "k", memoryview(bytes(encode(message))), Attachment(1, 0, bytes(16)), 0, 0.0)


def compressed(image, form, suffix=".png", before=b""):
    data = np.frombuffer(before + cv2.imencode(suffix, image)[1].tobytes(), np.uint8)
    return message_class(COMPRESSED_IMAGE)(header=write_header(1, "c"), format=form, data=data)


def frame(depth, amplitude=None, camera=CAMERA):
    parts = {"depth": depth, "camera_info": write_camera(1, "c", camera)}
    if amplitude is not None:
        parts["amplitude"] = amplitude
    topics = {"depth": DEPTH, "camera_info": CAMERA_INFO, "amplitude": AMPLITUDE}
    sent = {}
    for name, message in parts.items():
        topic = topics[name].of("pmd")
        sent[name] = received(Topic(topic.name, message.__msgtype__), message)
    return Assembled(1, sent)


def plain(image, encoding):
    return write_image(1, "c", image, encoding)


def test_compressed_depth_of_16uc1_loses_nothing():
    sent = frame(compressed(DEPTH_MM, "16UC1; compressedDepth png", before=bytes(12)))
    np.testing.assert_allclose(PmdReader().read(sent).depth_m, DEPTH_MM * 1e-3, rtol=1e-6)


@pytest.mark.parametrize(("encoding", "unit_m"), [("32FC1", 1e-3), ("16UC1", 1e-4)])
def test_depth_in_another_unit_is_read_with_that_unit(encoding, unit_m):
    sent = DEPTH_MM.astype(np.float32) if encoding == "32FC1" else DEPTH_MM
    reader = PmdReader(SourceConfig(depth_unit_m=unit_m))
    np.testing.assert_allclose(
        reader.read(frame(plain(sent, encoding))).depth_m, DEPTH_MM * unit_m, rtol=1e-6
    )


def broken(**changes):
    message = plain(DEPTH_MM, "16UC1")
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("depth", "amplitude", "told"),
    [
        (broken(step=60), None, "step is 60 bytes, a row needs 120; correct the driver"),
        (broken(data=np.zeros(100, np.uint8)), None, "data has 100 bytes, step x height is 4800; correct"),
        (broken(encoding="depth_f32"), None, r"known are 32FC1, .*; let the driver publish one of them"),
        (None, broken(encoding="16UC4", width=15), r"needs mono16, mono8 or 32FC1; .*source.topics"),
        (
            plain(np.full((40, 60), np.nan, np.float32), "32FC1"),
            None,
            r"no finite pixel .*; check the sensor",
        ),
    ],
)
def test_an_image_that_cannot_be_used_is_refused_with_figures_and_remedy(depth, amplitude, told):
    with pytest.raises(PartRejectedError, match=told):
        PmdReader().read(frame(plain(DEPTH_MM, "16UC1") if depth is None else depth, amplitude))


def test_a_camera_info_without_a_calibration_is_refused_with_the_remedy():
    sent = frame(plain(DEPTH_MM, "16UC1"))
    message = write_camera(1, "c", CAMERA)
    message.k = np.zeros(9)
    sent.parts["camera_info"] = received(CAMERA_INFO.of("pmd"), message)
    with pytest.raises(PartRejectedError, match=r"is not calibrated; .*rpod calibrate camera"):
        PmdReader().read(sent)


@pytest.mark.parametrize(("suffix", "most"), [(".png", 0), (".jpg", 3)])
def test_a_compressed_amplitude_is_read(suffix, most):
    image = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 200, (40, 60), np.uint8), (0, 0), 4)
    sent = frame(plain(DEPTH_MM, "16UC1"), compressed(image, "mono8; jpeg compressed mono8", suffix))
    assert np.abs(PmdReader().read(sent).amplitude.astype(int) - image).max() <= most


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (compressed(DEPTH_MM, "32FC1; compressedDepth png", before=bytes(12)), "loses depth"),
        (compressed(DEPTH_MM, "16UC1; compressedDepth rvl", before=bytes(12)), "set its format to png"),
        (compressed(DEPTH_MM, "16UC1; compressedDepth png", before=bytes(7)), "cannot be decoded"),
        (compressed(np.zeros((4, 4, 3), np.uint8), "bgr8; png compressed bgr8"), "channels"),
    ],
)
def test_what_no_codec_restores_is_refused(message, reason):
    with pytest.raises(MessageRejectedError, match=reason):
        decompressed(message)


@pytest.mark.parametrize("kind", [b"IDAT", b"IHDR"])
def test_a_png_whose_chunk_states_more_bytes_than_there_are_is_not_decoded(kind, monkeypatch):
    message = compressed(DEPTH_MM, "16UC1; compressedDepth png", before=bytes(12))
    at, data = message.data.tobytes().index(kind), message.data.copy()
    data[at - 4 : at] = 0xFF
    message.data = data
    monkeypatch.setattr(cv2, "imdecode", pytest.fail)  # it takes 4 GB
    with pytest.raises(
        MessageRejectedError, match=r"its chunks state at least 4294967\d{3} bytes, it has \d+"
    ):
        decompressed(message)


@pytest.mark.parametrize("distortion", [np.zeros(5), np.array([-0.3, 0.1, 0.001, 0.0, 0.0])])
def test_radial_depth_becomes_depth_along_the_boresight(distortion):
    camera = CAMERA.model_copy(update={"distortion": distortion})
    column, row = np.meshgrid(np.arange(60.0), np.arange(40.0))
    pixels = np.stack((column, row), axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(pixels, camera.K, distortion).reshape(40, 60, 2)
    radial_m = (2.0 * np.sqrt(1.0 + (rays**2).sum(axis=-1))).astype(np.float32)
    reader = PmdReader(SourceConfig(depth="radial"))
    for _ in range(2):
        read = reader.read(frame(plain(radial_m, "32FC1"), camera=camera))
        np.testing.assert_allclose(read.depth_m, 2.0, rtol=1e-4)


def test_radial_depth_of_a_lens_without_an_inverse_is_refused():
    folding = CAMERA.model_copy(update={"distortion": np.array([-8.0, 0, 0, 0, 0])})
    with pytest.raises(PartRejectedError, match="no inverse"):
        PmdReader(SourceConfig(depth="radial")).read(frame(plain(DEPTH_MM, "16UC1"), camera=folding))


def noisy(scale, largest, dtype):
    image = np.random.default_rng(2).normal(500.0, 150.0, (200, 300)) * scale
    return np.clip(image, 0.0, largest).astype(dtype)


def test_saturation_is_recognised_by_the_encoding_or_by_a_pile():
    assert saturated_pixels(noisy(1.0, 65535, np.uint16), None) is None
    for image in (noisy(100.0, 65535, np.uint16), noisy(5.0, 4095, np.uint16), noisy(0.002, 1.0, np.float32)):
        np.testing.assert_array_equal(saturated_pixels(image, None), image == image.max())
    assert np.count_nonzero(saturated_pixels(noisy(1.0, 65535, np.uint16), 900.0)) > 100
    flat = np.where(np.arange(6000).reshape(60, 100) % 7 < 3, 255, 0).astype(np.uint16)
    assert saturated_pixels(flat, None) is None  # a mask, not a clipped image


def test_the_depth_of_saturated_pixels_is_not_used():
    amplitude = np.full((40, 60), 900, np.uint16)
    amplitude[10:20, 10:20] = 65535
    read = PmdReader().read(frame(plain(DEPTH_MM, "16UC1"), plain(amplitude, "mono16")))
    np.testing.assert_array_equal(read.saturated, amplitude == 65535)
    np.testing.assert_array_equal(np.isnan(read.depth_m), read.saturated)


def test_points_with_x_forward_are_turned_to_the_boresight():
    ahead = {"x": np.float32([5, 6]), "y": np.float32([1, 1]), "z": np.float32([2, 2])}
    cloud = write_points(1, "os_lidar", {**ahead, "t": np.float32([0.0, 0.1])})
    source = SourceConfig(axes="forward", stamp="start", duration_s=0.1)
    scan = LidarReader(source).read(Assembled(1, {"points": received(POINTS.of("lidar"), cloud)}))
    np.testing.assert_array_equal(scan.points_m, [[-1, -2, 5], [-1, -2, 6]])
    np.testing.assert_allclose(scan.time_s, [-0.05, 0.05])
    mount = source.boresight_mount(SourceConfig().boresight_mount(FORWARD))
    np.testing.assert_allclose(mount.apply([-1.0, -2.0, 5.0]), FORWARD.apply([5.0, 1.0, 2.0]))


def test_of_a_turning_head_only_what_lies_ahead_is_used():
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(180.0, -180.0, -5.0)), np.radians(np.arange(20, -21, -5))
    )
    rays = np.stack((np.cos(azimuth), np.sin(azimuth), np.tan(elevation)), axis=-1)
    room = (8.0 * rays).astype(np.float32)
    cloud = write_points(1, "os_lidar", {name: room[..., n].copy() for n, name in enumerate("xyz")})
    reader = LidarReader(SourceConfig(axes="forward"))
    scan = reader.read(Assembled(1, {"points": received(POINTS.of("lidar"), cloud)}))
    assert (
        scan.points_m.shape
        == (reader.newest_info.elevation_rad.size, reader.newest_info.azimuth_rad.size, 3)
        == (9, 33, 3)
    )
    assert (scan.points_m[..., 2] > 0.0).all()
    seen = np.arctan2(scan.points_m[4, :, 0], scan.points_m[4, :, 2])
    np.testing.assert_allclose(reader.newest_info.azimuth_rad, seen, atol=1e-3)


@pytest.mark.parametrize("begin_deg", [-180, 0, 90])
def test_a_head_may_state_its_azimuths_by_any_turn_and_begin_anywhere(begin_deg):
    stated = np.radians(np.arange(begin_deg, begin_deg + 360, 5.0) + 2.5)
    azimuth, elevation = np.meshgrid(stated, np.radians(np.arange(-20, 21, 5)))
    rays = np.stack((np.sin(azimuth), np.tan(elevation), np.cos(azimuth)), axis=-1)
    cloud = write_points(1, "lidar", {name: 8.0 * rays[..., n] for n, name in enumerate("xyz")})
    info = LidarInfo(
        azimuth_rad=np.where(stated > 2.0 * np.pi, stated - 2.0 * np.pi, stated),
        elevation_rad=elevation[:, 0], scan_time_s=0.1, sigma_range_m=0.02,
    )  # fmt: skip
    reader = LidarReader()
    reader.learn(write_lidar_info(1, "lidar", info))
    scan = reader.read(Assembled(1, {"points": received(POINTS.of("lidar"), cloud)}))
    front = reader.newest_info.azimuth_rad
    np.testing.assert_allclose(front, np.radians(np.arange(-77.5, 80.0, 5.0)), atol=1e-9)
    assert scan.points_m.shape == (9, front.size, 3)
    np.testing.assert_allclose(np.arctan2(scan.points_m[4, :, 0], scan.points_m[4, :, 2]), front, atol=1e-6)


def test_a_pattern_that_is_inferred_is_not_stated_by_the_lidar():
    azimuth, elevation = np.meshgrid(np.radians(np.arange(-20.0, 20.0)), np.radians(np.arange(-8.0, 8.0)))
    rays = np.stack((np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth)), axis=-1)
    cloud = write_points(1, "lidar", {name: 5.0 * rays[..., n] for n, name in enumerate("xyz")})
    reader = LidarReader()
    reader.read(Assembled(1, {"points": received(POINTS.of("lidar"), cloud)}))
    assert reader.newest_info is not None
    assert reader.stated_info is None
    info = LidarInfo(
        azimuth_rad=azimuth[0], elevation_rad=elevation[:, 0], scan_time_s=0.1, sigma_range_m=0.02
    )
    reader.learn(write_lidar_info(1, "lidar", info))
    assert reader.stated_info is reader.newest_info


def test_a_configured_pattern_counts_before_an_inferred_one_and_behind_a_published_one():
    azimuth, elevation = np.meshgrid(np.radians(np.arange(-20.0, 20.0)), np.radians(np.arange(-8.0, 8.0)))
    rays = np.stack((np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth)), axis=-1)
    cloud = write_points(1, "lidar", {name: 5.0 * rays[..., n] for n, name in enumerate("xyz")})
    configured, published = (
        LidarInfo(
            azimuth_rad=azimuth[0], elevation_rad=elevation[:, 0], scan_time_s=0.0, sigma_range_m=sigma_m
        )
        for sigma_m in (0.01, 0.02)
    )
    reader = LidarReader()
    reader.assume(configured)
    reader.read(Assembled(1, {"points": received(POINTS.of("lidar"), cloud)}))
    assert (reader.newest_info, reader.stated_info) == (configured, None)
    reader.learn(write_lidar_info(1, "lidar", published))
    assert reader.newest_info.sigma_range_m == reader.stated_info.sigma_range_m == 0.02


def test_a_reader_without_anything_to_tell_has_the_defaults_of_the_protocol():
    class Plain(SensorReader):
        newest_info = "info"

        def learn(self, message): ...
        def read(self, frame): ...

    reader = Plain()
    reader.assume(None)
    assert (reader.stated_info, reader.inconsistency, reader.hint) == ("info", "", "")
    assert PmdReader().hint == ""


class OldReader:
    """A reader of a package from before the protocol had defaults."""

    newest_info = None

    def __init__(self, source): ...
    def learn(self, message): ...
    def read(self, frame): ...


def test_a_reader_that_lacks_a_part_of_the_protocol_is_refused_with_the_remedy():
    kind = replace(sensor_kind("pmd"), reader=f"{__name__}:OldReader")
    with pytest.raises(ConfigurationError, match=r"pmd: reader: .*let it inherit from rpod_runtime\.frames"):
        open_reader(kind)


def test_staggered_rows_beside_a_stated_pattern_are_told_with_the_remedy(caplog):
    azimuth, elevation = np.radians(np.arange(-20.0, 20.0)), np.radians(np.arange(-8.0, 8.0))
    el, az = np.meshgrid(elevation, azimuth, indexing="ij")
    az = az + np.radians(np.tile([4.0, 1.3, -1.3, -4.0], 4))[:, None]
    rays = np.stack((np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)), axis=-1)
    cloud = write_points(1, "lidar", {name: 5.0 * rays[..., n] for n, name in enumerate("xyz")})
    info = LidarInfo(azimuth_rad=azimuth, elevation_rad=elevation, scan_time_s=0.1, sigma_range_m=0.02)
    reader = LidarReader()
    reader.learn(write_lidar_info(1, "lidar", info))
    scan = reader.read(Assembled(1, {"points": received(POINTS.of("lidar"), cloud)}))
    assert scan.points_m.shape == (16, 40, 3)
    assert "rows are up to 4.0 deg beside the columns of the info" in caplog.text
    assert "destagger" in caplog.text


def test_a_scan_whose_times_are_all_unknown_is_read():
    azimuth, elevation = np.meshgrid(np.radians(np.arange(-20.0, 20.0)), np.radians(np.arange(-8.0, 8.0)))
    rays = np.stack((np.sin(azimuth), np.tan(elevation), np.cos(azimuth)), axis=-1)
    fields = {name: 5.0 * rays[..., n] for n, name in enumerate("xyz")}
    cloud = write_points(1, "lidar", fields | {"t": np.full(azimuth.shape, np.nan, np.float32)})
    scan = LidarReader().read(Assembled(1, {"points": received(POINTS.of("lidar"), cloud)}))
    assert np.isfinite(scan.points_m).all()
