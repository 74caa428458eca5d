"""A RealSense camera, by the software device of its SDK: no device is needed."""

from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

from rpod_driver.adapters.realsense import RealsenseConfig
from rpod_driver.adapters.realsense.driver import RealsenseCamera, camera_of, open_driver
from rpod_driver.errors import DriverError

rs = pytest.importorskip("pyrealsense2", reason="pyrealsense2 is not installed (pip install --group devices)")
SHAPE = (48, 64)
UTC_MS = 1_700_000_000_000.0


class SoftwareCamera:
    """A camera of the SDK that sends the images it is given."""

    def __init__(self) -> None:
        self._device = rs.software_device()
        self._sensor = self._device.add_sensor("Stereo Module")
        streams = ((rs.stream.depth, 0, rs.format.z16, 2), (rs.stream.infrared, 1, rs.format.y8, 1))
        self._profiles = [self._profile(*stream) for stream in streams]
        self._sensor.add_read_only_option(rs.option.depth_units, 0.001)
        self.stream = rs.syncer()
        self._sensor.open(self._profiles)
        self._sensor.start(self.stream)

    def _profile(self, kind, index, form, bytes_per_pixel):
        intrinsics = rs.intrinsics()
        intrinsics.height, intrinsics.width = SHAPE
        intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = 50.0, 51.0, 31.0, 23.5
        intrinsics.model, intrinsics.coeffs = rs.distortion.brown_conrady, [0.0] * 5
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fmt = kind, index, int(kind), form
        stream.height, stream.width = SHAPE
        stream.fps, stream.bpp, stream.intrinsics = 30, bytes_per_pixel, intrinsics
        return self._sensor.add_video_stream(stream)

    def send(self, number, depth, infrared):
        for profile, image in zip(self._profiles, (depth, infrared), strict=True):
            frame = rs.software_video_frame()
            frame.pixels, frame.stride, frame.bpp = image, image.strides[0], image.itemsize
            frame.timestamp, frame.frame_number = UTC_MS + 33.0 * number, number
            frame.domain, frame.profile = rs.timestamp_domain.system_time, profile.as_video_stream_profile()
            frame.depth_units = 0.001
            self._sensor.on_video_frame(frame)

    def close(self):
        self._sensor.stop()
        self._sensor.close()


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
        supports_frame_metadata=metadata.__contains__,
        get_frame_metadata=metadata.__getitem__,
    )
    assert driver()._middle_ns(depth) == round(UTC_MS * 1e6) - 8_000_000


def test_a_distorted_depth_stream_is_refused():
    lens = SimpleNamespace(model=rs.distortion.kannala_brandt4, coeffs=[0.1, 0, 0, 0, 0])
    with pytest.raises(DriverError, match="kannala_brandt4"):
        camera_of(lens)


def test_without_a_camera_that_is_told_at_once_and_nothing_is_open():
    opened = driver()
    with pytest.raises(DriverError, match="no RealSense camera is connected"):
        opened.connect()
    opened.close()


class FakeSdk:
    """A pipeline whose depth sensor has one option; the rest is the SDK's."""

    stream, format, option = rs.stream, rs.format, rs.option

    def __init__(self) -> None:
        self.written: dict[object, float] = {}
        self.streams: list[tuple] = []
        self.stopped = 0
        self.frame_metadata_value = rs.frame_metadata_value

    def context(self):
        return SimpleNamespace(query_devices=lambda: [self])

    def config(self):
        return SimpleNamespace(
            enable_device=self.streams.append, enable_stream=lambda *a: self.streams.append(a)
        )

    def pipeline(self):
        return self

    def start(self, _config):
        sensor = SimpleNamespace(
            supports=lambda option: option == rs.option.exposure,
            get_option_range=lambda _: SimpleNamespace(min=1.0, max=100.0),
            set_option=self.written.__setitem__,
        )
        return SimpleNamespace(get_device=lambda: SimpleNamespace(first_depth_sensor=lambda: sensor))

    def stop(self):
        self.stopped += 1


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


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"exposure": 500}, "exposure is 500, the camera takes 1 to 100"),
        ({"gain": 16}, "no option 'gain'"),
        ({"colour": 1}, "no option 'colour'"),
    ],
)
def test_an_option_that_the_camera_does_not_take_is_refused_and_nothing_stays_open(options, reason):
    sdk = FakeSdk()
    with pytest.raises(DriverError, match=reason):
        RealsenseCamera(RealsenseConfig(name="front", device={"options": options}), sdk).connect()
    assert sdk.stopped == 1
