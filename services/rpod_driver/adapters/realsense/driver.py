"""The driver of RealSense cameras."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from rpod_driver.adapters.realsense import RealsenseConfig
from rpod_driver.errors import DriverError
from rpod_driver.gaps import GapCounter
from rpod_driver.ports import Drops
from rpod_driver.registered import sdk
from rpod_driver.stamps import StampMapper
from rpod_schemas.config.driver import Setting
from rpod_schemas.types import Camera, PmdFrame, SensorSync

_WAIT_MS = 500
_AUTOMATIC = "enable_auto"
"""Beginning of the names of options that are written last: writing an exposure ends automatic exposure."""
_UNDISTORTED = ("none", "brown_conrady", "inverse_brown_conrady")
"""Distortion models of depth streams; their coefficients are all 0, since depth images are rectified."""


class Stream(Protocol):
    """Where sets of frames come from: a pipeline, or the syncer of a software device."""

    def try_wait_for_frames(self, timeout_ms: int) -> tuple[bool, Any]:
        """Return whether a set came in time, and the set."""
        ...


def open_driver(config: RealsenseConfig) -> "RealsenseCamera":
    """Return the driver. Raises ``MissingSdkError``."""
    needs = "pip install 'rpod[realsense]'"
    return RealsenseCamera(config, sdk("pyrealsense2", driver="realsense", needs=needs))


class RealsenseCamera:
    """A camera that measures depth by stereo or time of flight; pixels with 0 have no depth."""

    def __init__(self, config: RealsenseConfig, module: Any) -> None:
        self._name, self._device, self._module = config.name, config.device, module
        self._pipeline: Any = None
        self._gaps = GapCounter()
        self._begin()

    def _begin(self) -> None:
        self._stamps = StampMapper(self._name, self._device.stamps)
        self._gaps.begin()

    def connect(self) -> None:
        """Start the streams, and write the options. Raises ``DriverError``, or what the SDK raises."""
        self._begin()
        rs, device = self._module, self._device
        if not list(rs.context().query_devices()):  # the pipeline would wait for one for 15 s
            raise DriverError("no RealSense camera is connected; check its USB cable and its udev rules")
        config = rs.config()
        if device.serial:
            config.enable_device(device.serial)
        size = (device.width, device.height)
        config.enable_stream(rs.stream.depth, *size, rs.format.z16, device.rate_hz)
        if device.infrared:
            config.enable_stream(rs.stream.infrared, 1, *size, rs.format.y8, device.rate_hz)
        pipeline = rs.pipeline()
        profile = pipeline.start(config)
        self._pipeline = pipeline
        try:
            self._sensor = profile.get_device().first_depth_sensor()
            self.apply(device.options)
        except BaseException:
            self.close()
            raise

    def frames(self) -> Iterator[PmdFrame | None]:
        """Yield frames as they come."""
        yield from self.read(self._pipeline)

    def read(self, stream: Stream) -> Iterator[PmdFrame | None]:
        """Yield the frames of a stream, None where none comes in half a second."""
        while True:
            came, frames = stream.try_wait_for_frames(_WAIT_MS)
            depth = frames.get_depth_frame() if came else None
            yield self._frame(depth, frames) if depth else None

    def close(self) -> None:
        """Stop the streams."""
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = None

    def sync(self) -> SensorSync:
        """Return where the stamps come from."""
        return self._stamps.sync

    def drops(self) -> Drops:
        """Return how many numbers of depth frames are missing; the SDK's own queue loses some of them."""
        return Drops(device=self._gaps.lost)

    def settings(self) -> Mapping[str, Setting]:
        """Return the options of the depth sensor that can be written, by their names in the SDK."""
        sensor = self._sensor
        return {
            option.name: float(sensor.get_option(option))
            for option in sensor.get_supported_options()
            if not sensor.is_option_read_only(option)
        }

    def apply(self, settings: Mapping[str, Setting]) -> None:
        """Write options. Raises ``DriverError``, or what the SDK raises; then none has changed."""
        sensor = self._sensor
        options = [_checked(self._module, sensor, name, value) for name, value in settings.items()]
        options.sort(key=lambda each: each[0].name.startswith(_AUTOMATIC))
        before = [(option, sensor.get_option(option)) for option, _ in options]
        try:
            for option, value in options:
                sensor.set_option(option, value)
        except Exception:
            for option, value in before:
                with suppress(Exception):  # the first error is told
                    sensor.set_option(option, value)
            raise

    def _middle_ns(self, depth: Any) -> int | None:
        """Return the middle of the exposure, by the metadata; the stamp is of the beginning of readout.

        None if the stamp is that of the arrival, which the SDK gives where it has no metadata.
        """
        if depth.frame_timestamp_domain == self._module.timestamp_domain.system_time:
            return None
        values = self._module.frame_metadata_value
        both = (values.frame_timestamp, values.sensor_timestamp)
        stamp_ns = round(float(depth.timestamp) * 1e6)
        if not all(map(depth.supports_frame_metadata, both)):
            return stamp_ns
        read_us, middle_us = (int(depth.get_frame_metadata(each)) for each in both)
        return stamp_ns - (read_us - middle_us) * 1000

    def _frame(self, depth: Any, frames: Any) -> PmdFrame:
        self._gaps.take(int(depth.get_frame_number()))
        counts = np.asarray(depth.get_data())
        metres = counts * np.float32(depth.get_units())
        infrared = frames.get_infrared_frame() if self._device.infrared else None
        return PmdFrame(
            stamp_ns=self._stamps.utc_ns(self._middle_ns(depth)),
            frame_id="",
            depth_m=np.where(counts > 0, metres, np.float32(np.nan)).astype(np.float32),
            amplitude=np.array(infrared.get_data()) if infrared else None,
            camera=camera_of(depth.profile.as_video_stream_profile().intrinsics),
        )


def camera_of(intrinsics: Any) -> Camera:
    """Return the lens of a depth stream. Raises ``DriverError`` if it is distorted."""
    model = str(intrinsics.model).rpartition(".")[2]
    if any(intrinsics.coeffs) or model not in _UNDISTORTED:
        raise DriverError(
            f"the depth stream has lens {model} with coefficients {list(intrinsics.coeffs)}, a rectified "
            "one is needed; take another profile"
        )
    return Camera(
        width=intrinsics.width,
        height=intrinsics.height,
        fx=intrinsics.fx,
        fy=intrinsics.fy,
        cx=intrinsics.ppx,
        cy=intrinsics.ppy,
    )


def _checked(rs: Any, sensor: Any, name: str, value: Setting) -> tuple[Any, float]:
    """Return an option and its value as the SDK takes them. Raises ``DriverError``."""
    option = getattr(rs.option, name, None)
    if option is None or not sensor.supports(option):
        raise DriverError(f"option {name!r}: the camera has none of this name; correct it")
    limits = sensor.get_option_range(option)
    if isinstance(value, str) or not limits.min <= value <= limits.max:
        raise DriverError(f"option {name} is {value!r}, the camera takes {limits.min:g} to {limits.max:g}")
    return option, float(value)
