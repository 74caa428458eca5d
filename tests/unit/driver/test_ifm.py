"""An ifm O3R: its buffers are read as its SDK reads them, and what cannot be used is refused by name."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from ifm_recording import BUFFER, LENS, FakeSdk, configuration, recorded, tof_info_bytes
from pydantic import ValidationError

from rpod_driver.adapters.ifm.chunks import (
    AMPLITUDE,
    CONFIDENCE,
    DISTANCE_NOISE,
    RADIAL_DISTANCE,
    REFLECTIVITY,
    TOF_INFO,
    buffers,
)
from rpod_driver.adapters.ifm.driver import LiveIfm, open_driver
from rpod_driver.adapters.ifm.frames import FrameMaker, IfmImages, images_of, tof_info_of
from rpod_driver.adapters.ifm.tof_info import TofInfoError, read_tof_info
from rpod_driver.errors import DriverError, RecordingError
from rpod_geometry.lens import ray_cosines

CONTENT = BUFFER.read_bytes()


def test_a_buffer_holds_the_images_that_its_headers_name():
    chunks = recorded()
    images = (RADIAL_DISTANCE, DISTANCE_NOISE, AMPLITUDE, CONFIDENCE, REFLECTIVITY)
    assert set(chunks) == {*images, TOF_INFO}
    assert {chunks[kind].image().shape for kind in images} == {(172, 224)}
    assert chunks[RADIAL_DISTANCE].metadata["DistanceResolution"] == pytest.approx(10.0 / 65535)
    assert {chunk.frame_count for chunk in chunks.values()} == {1544}
    assert {chunk.stamp_ns for chunk in chunks.values()} == {324_896_000_402_000}


def test_several_buffers_in_one_file_are_several_frames():
    assert len(list(buffers(3 * CONTENT, "recorded"))) == 3


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"PNG" + CONTENT, "no 'star' at byte 4"),
        (CONTENT[:100_000], "are left"),
        (CONTENT[:-6], "cut: 0 bytes are left"),
        (CONTENT[:12] + b"\xff\xff\xff\xff" + CONTENT[16:], "says 4294967295 bytes"),
        (CONTENT[:56] + b"{{{{" + CONTENT[60:], "no JSON"),
    ],
)
def test_a_damaged_recording_is_refused_with_the_place(content, reason):
    with pytest.raises(RecordingError, match=rf"{reason}.*; correct device\.recording, or record it again"):
        list(buffers(content, "recorded"))


@pytest.mark.parametrize(
    ("kind", "changes", "reason"),
    [
        (
            RADIAL_DISTANCE,
            {"metadata": {"DistanceResolution": "0.001"}},
            "DistanceResolution of image 100 is '0",
        ),
        (RADIAL_DISTANCE, {"metadata": {"DistanceResolution": float("nan")}}, "nan, needs a number above 0"),
        (RADIAL_DISTANCE, {"metadata": {"DistanceResolution": [1, 2]}}, "needs a number above 0"),
        (AMPLITUDE, {"width": 100}, "image 101 has 100 x 172 pixels, the radial distance 224 x 172"),
        (CONFIDENCE, {"pixel_format": 6, "data": bytes(4 * 224 * 172)}, "float32, needs integers"),
    ],
)
def test_images_that_do_not_fit_are_refused_by_name(kind, changes, reason):
    chunks = recorded()
    with pytest.raises(RecordingError, match=reason):
        images_of(chunks | {kind: replace(chunks[kind], **changes)})


@pytest.mark.parametrize(("at", "value"), [(0, np.nan), (1, -1.0), (5, np.inf)])
def test_a_lens_with_terms_that_none_has_is_refused(at, value):
    damaged = bytearray(tof_info_bytes())
    struct.pack_into("<f", damaged, 0x34 + 4 * at, value)
    with pytest.raises(TofInfoError, match=r"give it as device\.calibration"):
        read_tof_info(bytes(damaged))


def test_a_lens_to_which_no_polynomial_can_be_fitted_is_refused():
    damaged = bytearray(tof_info_bytes())
    struct.pack_into("<2f", damaged, 0x34, 1e-44, 1e-44)
    struct.pack_into("<f", damaged, 0x34 + 4 * 9, 3e38)
    with pytest.raises(TofInfoError, match=r"the lens cannot be used .*; give it as device\.calibration"):
        read_tof_info(bytes(damaged)).camera(224, 172)


def test_depth_lies_along_the_boresight_and_not_along_the_rays():
    images = images_of(recorded())
    lens = configuration().device.calibration
    frame = FrameMaker(lens).frame(images, 1)
    valid = np.isfinite(frame.depth_m)
    assert valid.mean() == pytest.approx(0.2586, abs=1e-4)
    assert np.array_equal(valid, (images.confidence & 1 == 0) & (images.range_m > 0))
    u, v = np.meshgrid(np.arange(224), np.arange(172))
    off_boresight = np.hypot(u - lens.cx, v - lens.cy) > 60
    ratio = frame.depth_m / images.range_m
    assert np.allclose(ratio[valid], ray_cosines(lens)[valid], atol=1e-6)
    assert (ratio[valid & off_boresight] < 0.95).all()
    assert 0.13 < np.nanmin(frame.depth_m) < np.nanmax(frame.depth_m) < 1.35


def test_the_noise_image_becomes_the_depths_sigma():
    images = images_of(recorded())
    frame = FrameMaker(configuration().device.calibration).frame(images, 1)
    valid = np.isfinite(frame.depth_m)
    assert np.array_equal(valid, np.isfinite(frame.depth_sigma_m))
    counts = recorded()[DISTANCE_NOISE].image()[valid]
    cosines = ray_cosines(frame.camera)[valid]
    assert np.allclose(frame.depth_sigma_m[valid], counts * (10.0 / 65535) * cosines, rtol=1e-5)
    assert 1e-4 < np.median(frame.depth_sigma_m[valid]) < 1e-3


def test_amplitudes_are_the_squares_of_their_roots():
    amplitude, roots = images_of(recorded()).amplitude, recorded()[AMPLITUDE].image()
    assert (amplitude[roots == 0] == -1.0).all()
    lit = roots > 0
    assert np.allclose(amplitude[lit], (roots[lit] - 1.0) ** 2 * 1.552299089269127e-08, rtol=1e-6)


def test_an_older_tof_info_is_refused_by_its_version():
    with pytest.raises(TofInfoError, match=r"version 1 with 312 bytes.*device\.calibration"):
        read_tof_info(recorded()[TOF_INFO].data)
    with pytest.raises(TofInfoError, match="version 1 with 312 bytes"):
        open_driver(configuration(calibration=None))


def test_a_lens_that_is_not_known_is_refused_by_its_model():
    fisheye = bytearray(tof_info_bytes())
    fisheye[0x30] = 2
    info, problem = tof_info_of(bytes(fisheye))
    assert info is None
    assert "model 2" in problem


def test_the_lens_of_a_newer_tof_info_has_the_devices_own_rays():
    info = read_tof_info(tof_info_bytes())
    assert (info.version, info.distance_resolution_m) == (4, pytest.approx(10.0 / 65535))
    camera = info.camera(224, 172)
    assert (camera.fx, camera.cx, camera.cy) == pytest.approx((128.5714, 112.2824, 82.9332), abs=1e-4)
    difference = np.abs(ray_cosines(camera) - info.cosines(224, 172))
    assert difference.max() < 2e-3  # in a corner, 67 deg from the boresight
    assert np.median(difference) < 2e-4


def test_the_sdk_reads_the_same_of_tof_info():
    deserialize = pytest.importorskip("ifm3dpy.deserialize", reason="ifm3dpy is not installed")
    theirs = deserialize.TOFInfoV4.deserialize(np.frombuffer(tof_info_bytes(), np.uint8))
    ours = read_tof_info(tof_info_bytes())
    assert theirs.version == ours.version
    assert tuple(theirs.intrinsic_calibration.parameters[:10]) == ours.intrinsic
    assert theirs.distance_resolution == ours.distance_resolution_m
    assert tuple(theirs.exposure_timestamps_ns) == ours.exposures_ns


def test_a_calibration_for_another_mode_is_refused_with_both_sizes():
    lens = configuration().device.calibration.model_copy(update={"width": 352, "height": 264})
    with pytest.raises(TofInfoError, match="352 x 264 pixels, the head sends 224 x 172"):
        FrameMaker(lens).frame(images_of(recorded()), 1)


def test_a_device_is_either_live_or_recorded():
    with pytest.raises(ValidationError, match="either ip"):
        configuration(ip="192.168.0.69")


def test_a_played_recording_is_stamped_as_taken_now():
    driver = open_driver(configuration(rate_hz=1000.0, repeat=3))
    driver.connect()
    frames = list(driver.frames())
    driver.close()
    stamps = np.diff([frame.stamp_ns for frame in frames])
    assert len(frames) == 3
    assert (stamps > 0).all()
    assert driver.sync().stamp_source == "mapped"


def live(sdk, **device):
    told = {"recording": None, "calibration": None, "ip": "192.168.0.69", "port": "port3"} | device
    return LiveIfm(configuration(**told), sdk)


def test_a_live_head_sends_the_frames_that_a_recording_of_it_holds():
    sdk = FakeSdk(tof_info=tof_info_bytes())
    driver = live(sdk, settings={"ports": {"port3": {"state": "RUN"}}})
    for _ in range(2):  # the settings are applied at each connection
        driver.connect()
        frames = driver.frames()
        frame = next(each for each in frames if each is not None)
        driver.close()
    images = images_of(recorded())
    expected = FrameMaker(read_tof_info(tof_info_bytes()).camera(224, 172)).frame(
        IfmImages(**vars(images) | {"tof_info": None}), 1
    )
    assert np.allclose(frame.depth_m, expected.depth_m, atol=2e-3, equal_nan=True)
    assert sdk.settings == 2 * [{"ports": {"port3": {"state": "RUN"}}}]
    assert sdk.ports == [50013, 50013]
    assert sdk.stopped == 2


def test_a_head_that_is_silent_is_told_as_none():
    driver = live(FakeSdk(tof_info=tof_info_bytes()))
    driver.connect()
    assert next(driver.frames()) is None


def test_a_head_that_does_not_start_leaves_nothing_open():
    sdk = FakeSdk(tof_info=tof_info_bytes(), starts=False)
    with pytest.raises(DriverError, match=r"port3, does not start within 5 s"):
        live(sdk).connect()
    assert sdk.stopped == 1


def test_distances_in_counts_are_refused():
    driver = live(FakeSdk(tof_info=recorded()[TOF_INFO].data, raw=True), calibration=str(LENS))
    driver.connect()
    with pytest.raises(DriverError, match="uint16, in counts"):
        list(driver.frames())


def test_the_sdk_has_the_names_that_the_driver_calls():
    module = pytest.importorskip("ifm3dpy", reason="ifm3dpy is not installed")
    driver = live(module, ip="127.0.0.1")
    with pytest.raises(RuntimeError, match="XMLRPC"):  # there is no device
        driver.connect()


def test_settings_of_a_live_head_change_by_their_paths_while_it_runs():
    sdk = FakeSdk(tof_info=tof_info_bytes())
    driver = live(sdk)
    driver.connect()
    assert driver.settings() == {"acquisition/framerate": 10.0, "mode": "standard_range2m"}
    driver.apply({"acquisition/framerate": 5.0})
    assert sdk.settings == [{"ports": {"port3": {"acquisition": {"framerate": 5.0}}}}]
    with pytest.raises(DriverError, match=r"'framerate' is none of the head's port.*acquisition/framerate"):
        driver.apply({"framerate": 5.0})


def test_missing_numbers_of_a_live_heads_frames_are_counted():
    sdk = FakeSdk(tof_info=tof_info_bytes())
    driver = live(sdk)
    driver.connect()
    frames = (frame for frame in driver.frames() if frame is not None)
    next(frames)
    sdk.count += 3
    next(frames)
    assert driver.drops().device == 3
