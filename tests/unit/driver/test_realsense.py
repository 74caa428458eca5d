"""A RealSense camera, by the software device of its SDK: no device is needed."""

import time
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest
from realsense_fakes import SHAPE, UTC_MS, FakeSdk, SoftwareCamera, rs

from rpod_driver.adapters.realsense import RealsenseConfig
from rpod_driver.adapters.realsense.driver import RealsenseCamera, camera_of, open_driver
from rpod_driver.errors import DriverError


@pytest.fixture
def software():
    camera = SoftwareCamera()
    yield camera
    camera.close()


def driver(**device):
    stamps = {"stamps": {"source": "device"}}
    return open_driver(RealsenseConfig.model_validate({"name": "front", "device": stamps | device}))


def test_the_frames_of_a_software_device_come_with_depth_amplitude_lens_and_stamp(software):
    depth = np.arange(48 * 64, dtype=np.uint16).reshape(SHAPE)
    infrared = np.full(SHAPE, 77, np.uint8)
    opened = driver()
    for number in range(3):
        software.send(number, depth + np.uint16(number), infrared)
    frames = islice(opened.read(software.stream), 6)
    frame = next(each for each in frames if each is not None and each.amplitude is not None)
    first = round((frame.stamp_ns / 1e6 - UTC_MS) / 33.0)
    assert np.isnan(frame.depth_m).sum() == (1 if first == 0 else 0)
    assert np.nanmax(np.abs(frame.depth_m * 1000 - depth - first)) < 1e-3
    assert (frame.amplitude == 77).all()
    assert (frame.camera.fx, frame.camera.fy, frame.camera.cx, frame.camera.cy) == (50.0, 51.0, 31.0, 23.5)
    assert opened.sync().stamp_source == "device"


def test_a_silent_camera_is_told_as_none(software):
    assert next(driver().read(software.stream)) is None


def test_the_stamp_is_moved_from_the_readout_to_the_middle_of_the_exposure():
    values = rs.frame_metadata_value
    metadata = {values.frame_timestamp: 5_008_000, values.sensor_timestamp: 5_000_000}
    depth = SimpleNamespace(
        timestamp=UTC_MS,
        frame_timestamp_domain=rs.timestamp_domain.global_time,
        supports_frame_metadata=metadata.__contains__,
        get_frame_metadata=metadata.__getitem__,
    )
    assert driver()._middle_ns(depth) == round(UTC_MS * 1e6) - 8_000_000


def test_a_stamp_of_the_arrival_is_not_taken_for_the_device_s(software):
    opened = driver(stamps={"source": "auto", "delay_s": 0.02})
    begun_ns = time.time_ns()
    for number in range(3):
        images = np.full(SHAPE, 1000, np.uint16), np.full(SHAPE, 77, np.uint8)
        software.send(number, *images, domain=rs.timestamp_domain.system_time)
    frame = next(each for each in islice(opened.read(software.stream), 6) if each is not None)
    assert begun_ns <= frame.stamp_ns + 20_000_000 <= time.time_ns()
    assert opened.sync().stamp_source == "host"


def test_a_distorted_depth_stream_is_refused():
    lens = SimpleNamespace(model=rs.distortion.kannala_brandt4, coeffs=[0.1, 0, 0, 0, 0])
    with pytest.raises(DriverError, match="kannala_brandt4"):
        camera_of(lens)


def test_without_a_camera_that_is_told_at_once_and_nothing_is_open():
    opened = driver()
    with pytest.raises(DriverError, match="no RealSense camera is connected"):
        opened.connect()
    opened.close()


def test_options_are_written_at_each_connection():
    sdk = FakeSdk()
    opened = RealsenseCamera(
        RealsenseConfig(name="front", device={"options": {"exposure": 8}, "serial": "7"}), sdk
    )
    for _ in range(2):
        sdk.written.clear()
        opened.connect()
        opened.close()
        assert sdk.written == {rs.option.exposure: 8.0}
    assert sdk.stopped == 2
    assert sdk.streams[0] == "7"
    assert len(sdk.streams) == 6


def test_options_change_while_it_runs_all_or_none_and_automatic_exposure_is_written_last():
    sdk = FakeSdk()
    opened = RealsenseCamera(RealsenseConfig(name="front"), sdk)
    opened.connect()
    opened.apply({"enable_auto_exposure": 1, "exposure": 9})
    assert list(sdk.written) == [rs.option.exposure, rs.option.enable_auto_exposure]
    assert opened.settings() == {"exposure": 9.0, "enable_auto_exposure": 1.0}
    with pytest.raises(DriverError, match=r"exposure is 500(\.0)?, the camera takes 1 to 100"):
        opened.apply({"enable_auto_exposure": 0, "exposure": 500})
    assert opened.settings()["enable_auto_exposure"] == 1.0


def test_where_the_sdk_refuses_an_option_the_others_get_their_former_values():
    sdk = FakeSdk()
    opened = RealsenseCamera(RealsenseConfig(name="front"), sdk)
    opened.connect()
    opened.apply({"enable_auto_exposure": 1, "exposure": 9})
    sdk.refused = rs.option.enable_auto_exposure
    with pytest.raises(RuntimeError, match="hwmon"):
        opened.apply({"exposure": 20, "enable_auto_exposure": 0})
    assert opened.settings() == {"exposure": 9.0, "enable_auto_exposure": 1.0}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"exposure": 500}, r"exposure is 500(\.0)?, the camera takes 1 to 100"),
        ({"gain": 16}, "option 'gain': the camera has none"),
        ({"colour": 1}, "option 'colour': the camera has none"),
    ],
)
def test_an_option_that_the_camera_does_not_take_is_refused_and_nothing_stays_open(options, reason):
    sdk = FakeSdk()
    with pytest.raises(DriverError, match=reason):
        RealsenseCamera(RealsenseConfig(name="front", device={"options": options}), sdk).connect()
    assert sdk.stopped == 1
