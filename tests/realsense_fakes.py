"""Parts of a RealSense camera: the software device of its SDK, and a pipeline with options."""

import time
from types import SimpleNamespace

import pytest

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

    def send(self, number, depth, infrared, stamp_ms=None, domain=rs.timestamp_domain.global_time):
        for profile, image in zip(self._profiles, (depth, infrared), strict=True):
            frame = rs.software_video_frame()
            frame.pixels, frame.stride, frame.bpp = image, image.strides[0], image.itemsize
            stamp_ms = UTC_MS + 33.0 * number if stamp_ms is None else stamp_ms
            frame.timestamp, frame.frame_number = stamp_ms, number
            frame.domain, frame.profile = domain, profile.as_video_stream_profile()
            frame.depth_units = 0.001
            self._sensor.on_video_frame(frame)

    def close(self):
        self._sensor.stop()
        self._sensor.close()


class FakeSdk:
    """A pipeline whose depth sensor has two options; the rest is the SDK's."""

    stream, format, option, timestamp_domain = rs.stream, rs.format, rs.option, rs.timestamp_domain

    def __init__(self) -> None:
        self.written: dict[object, float] = {}
        self.refused: object = None
        """Option whose next write fails."""
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
        limits = {rs.option.exposure: (1.0, 100.0), rs.option.enable_auto_exposure: (0.0, 1.0)}
        values = self.written
        sensor = SimpleNamespace(
            supports=limits.__contains__,
            get_supported_options=lambda: list(limits),
            is_option_read_only=lambda _: False,
            get_option=lambda option: values.get(option, limits[option][0]),
            get_option_range=lambda option: SimpleNamespace(min=limits[option][0], max=limits[option][1]),
            set_option=self.set_option,
        )
        return SimpleNamespace(get_device=lambda: SimpleNamespace(first_depth_sensor=lambda: sensor))

    def set_option(self, option, value):
        if option == self.refused:
            self.refused = None
            raise RuntimeError("hwmon command 0x4c failed")
        self.written[option] = value

    def stop(self):
        self.stopped += 1


class PlayedSdk(FakeSdk):
    """A pipeline that sends pairs of depth and infrared images by the software device, as if taken now."""

    def __init__(self, images, period_s) -> None:
        super().__init__()
        self._images, self._period_s = images, period_s
        self._number = 0

    def start(self, config):
        self._camera = SoftwareCamera()
        self._next_s = time.time()
        return super().start(config)

    def try_wait_for_frames(self, timeout_ms):
        self._next_s += self._period_s
        time.sleep(max(0.0, self._next_s - time.time()))
        images = self._images[self._number % len(self._images)]
        self._number += 1
        self._camera.send(self._number, *images, stamp_ms=1e3 * self._next_s)
        return self._camera.stream.try_wait_for_frames(timeout_ms)

    def stop(self):
        super().stop()
        self._camera.close()
