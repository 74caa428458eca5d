"""The driver of ifm O3R heads."""

import logging
import time
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from rpod_driver.adapters.ifm.chunks import buffers
from rpod_driver.adapters.ifm.config import IfmConfig
from rpod_driver.adapters.ifm.frames import FrameMaker, IfmImages, images_of, middle_ns, tof_info_of
from rpod_driver.adapters.ifm.settings import nested, scalars
from rpod_driver.errors import DriverError, RecordingError
from rpod_driver.gaps import GapCounter
from rpod_driver.pauses import Pauses
from rpod_driver.ports import Driver, Drops
from rpod_driver.registered import sdk
from rpod_driver.stamps import StampMapper
from rpod_schemas.config.driver import Setting
from rpod_schemas.types import PmdFrame, SensorSync

log = logging.getLogger(__name__)

_WAIT_MS = 500
"""Longest wait for a frame, ms: without frames the host gets None about twice a second."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def open_driver(config: IfmConfig) -> Driver:
    """Return the driver of a recording or of a live head. Raises ``DriverError``."""
    if config.device.recording is not None:
        return RecordedIfm(config, config.device.recording)
    module = sdk("ifm3dpy", driver="ifm", needs="pip install 'rpod[ifm]'")
    return LiveIfm(config, module)


class _Head:
    """Common part of a recorded and a live head: lens and stamps of a connection."""

    def __init__(self, config: IfmConfig) -> None:
        self._name, self._device = config.name, config.device
        self._begin()

    def _begin(self) -> None:
        self._maker = FrameMaker(self._device.calibration)
        self._stamps = StampMapper(self._name, self._device.stamps)

    def _frame(self, images: IfmImages) -> PmdFrame:
        return self._maker.frame(images, self._stamps.utc_ns(images.stamp_ns))

    def sync(self) -> SensorSync:
        """Return where the stamps come from."""
        return self._stamps.sync


class RecordedIfm(_Head):
    """Plays recorded buffers at a rate, as if they came now."""

    def __init__(self, config: IfmConfig, path: Path) -> None:
        """Read the recording. Raises ``RecordingError``, ``TofInfoError``."""
        stamps = config.device.stamps.model_copy(update={"source": "mapped"})
        device = config.device.model_copy(update={"stamps": stamps})
        super().__init__(config.model_copy(update={"device": device}))
        self._pauses = Pauses()
        try:
            content = path.read_bytes()
        except OSError as error:
            raise RecordingError(
                path, f"cannot be read ({error.strerror}); correct device.recording"
            ) from error
        self._frames = [images_of(chunks) for chunks in buffers(content, str(path))]
        if not self._frames:
            raise RecordingError(path, "holds no buffer; correct device.recording, or record it again")
        for images in self._frames:
            self._maker.frame(images, images.stamp_ns)
        log.info("%s: %s holds %d frames", self._name, path, len(self._frames))

    def connect(self) -> None:
        """Begin to play."""
        self._begin()
        self._pauses = Pauses()

    def frames(self) -> Iterator[PmdFrame | None]:
        """Yield the frames at their rate. A frame that is played again has a later stamp."""
        begun_s, period_s = time.monotonic(), 1.0 / self._device.rate_hz
        first_ns = self._frames[0].stamp_ns
        total = len(self._frames) * self._device.repeat
        for number in range(total):
            yield from self._pauses.until(begun_s + number * period_s)
            images = self._frames[number % len(self._frames)]
            played_ns = first_ns + round(number * period_s * 1e9)
            yield self._maker.frame(images, self._stamps.utc_ns(played_ns))

    def close(self) -> None:
        """Do nothing: the recording stays in memory."""

    def due_s(self) -> float:
        """Return when the next frame is due, s of the monotonic clock."""
        return self._pauses.due_s


class LiveIfm(_Head):
    """A head that is connected to a VPU."""

    def __init__(self, config: IfmConfig, module: Any) -> None:
        super().__init__(config)
        self._module = module
        self._grabber: Any = None
        self._gaps = GapCounter()

    def connect(self) -> None:
        """Connect, apply the settings, and start the stream."""
        self._begin()
        self._gaps.begin()
        device, fg = self._module.device, self._module.framegrabber
        self._vpu = vpu = device.O3R(self._device.ip)
        if self._device.settings:
            vpu.set(self._device.settings)
        ids = fg.buffer_id
        self._ids = ids
        self._grabber = fg.FrameGrabber(vpu, vpu.port(self._device.port).pcic_port)
        wanted = [
            ids.RADIAL_DISTANCE_IMAGE,
            ids.RADIAL_DISTANCE_NOISE,
            ids.NORM_AMPLITUDE_IMAGE,
            ids.CONFIDENCE_IMAGE,
            ids.TOF_INFO,
        ]
        try:
            self._start(wanted)
        except BaseException:
            self.close()
            raise

    def _start(self, wanted: list[Any]) -> None:
        ready, _ = self._grabber.start(wanted).wait_for(10 * _WAIT_MS)
        if not ready:
            raise DriverError(
                f"the head at {self._device.ip}, {self._device.port}, does not start within "
                f"{10 * _WAIT_MS / 1e3:g} s; check that its state is RUN and that no one else holds the port"
            )

    def frames(self) -> Iterator[PmdFrame | None]:
        """Yield frames as they come."""
        while True:
            arrived, frame = self._grabber.wait_for_frame().wait_for(_WAIT_MS)
            if not arrived:
                yield None
                continue
            self._gaps.take(int(frame.frame_count()))
            yield self._frame(self._images(frame))

    def close(self) -> None:
        """Stop the stream."""
        if self._grabber is not None:
            self._grabber.stop().wait_for(_WAIT_MS)
            self._grabber = None

    def drops(self) -> Drops:
        """Return how many numbers are missing in the head's frame counter."""
        return Drops(device=self._gaps.lost)

    def settings(self) -> Mapping[str, Setting]:
        """Return the settings of the head by their paths below its port, as ``acquisition/framerate``."""
        told = self._vpu.get([f"/ports/{self._device.port}"])["ports"][self._device.port]
        return dict(scalars(told))

    def apply(self, settings: Mapping[str, Setting]) -> None:
        """Write settings; the VPU takes all of them or none. Raises what the SDK raises."""
        self._vpu.set({"ports": {self._device.port: nested(settings)}})

    def _images(self, frame: Any) -> IfmImages:
        def image(name: Any) -> Any:
            return np.asarray(frame.get_buffer(name)) if frame.has_buffer(name) else None

        ids = self._ids
        range_m = image(ids.RADIAL_DISTANCE_IMAGE)
        if range_m is None:
            raise DriverError("the head sends no radial distance; check the mode of its application")
        told = image(ids.TOF_INFO)
        info, problem = tof_info_of(b"" if told is None else told.tobytes())
        if range_m.dtype != np.float32:
            raise DriverError(
                f"the SDK delivers distances as {range_m.dtype}, in counts: it reads no TOF_INFO; update "
                f"the firmware ({problem})"
            )
        return IfmImages(
            stamp_ns=middle_ns(info, _nanoseconds(frame.timestamps()[0])),
            range_m=range_m,
            sigma_m=image(ids.RADIAL_DISTANCE_NOISE),
            amplitude=image(ids.NORM_AMPLITUDE_IMAGE),
            confidence=image(ids.CONFIDENCE_IMAGE),
            tof_info=info,
            problem=problem,
        )


def _nanoseconds(stamp: datetime) -> int:
    """Return a stamp of ifm3dpy, ns since 1970; a stamp without a time zone is in this machine's zone."""
    since = stamp.astimezone(UTC) - _EPOCH
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
