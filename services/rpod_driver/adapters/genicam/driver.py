"""The driver of GenICam cameras."""

import logging
import time
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_driver.adapters.genicam.config import GenicamConfig, GenicamDevice
from rpod_driver.adapters.genicam.depth import Scan3d, amplitude_of, confident, depth_of
from rpod_driver.adapters.genicam.features import execute, offers, read, write, write_all
from rpod_driver.errors import DriverError
from rpod_driver.gaps import GapCounter
from rpod_driver.pauses import Pauses
from rpod_driver.ports import Drops
from rpod_driver.registered import sdk
from rpod_driver.stamps import StampMapper
from rpod_schemas.config.driver import Setting
from rpod_schemas.types import PmdFrame, SensorSync

log = logging.getLogger(__name__)

_USUAL = ("ExposureTime", "Gain", "AcquisitionFrameRate", "DeviceLinkThroughputLimit")
"""Features of the SFNC that are settings even if the configuration does not name them."""
_WAIT_S = 0.5
"""Longest wait for a buffer, s: without a limit harvesters waits for ever (harvesters#354)."""


def open_driver(config: GenicamConfig) -> "GenicamCamera":
    """Return the driver. Raises ``MissingSdkError``."""
    needs = "pip install 'rpod[genicam]'"
    return GenicamCamera(config, sdk("harvesters.core", driver="genicam", needs=needs))


class GenicamCamera:
    """A camera with depth."""

    def __init__(self, config: GenicamConfig, module: Any) -> None:
        self._name, self._device, self._module = config.name, config.device, module
        self._harvester: Any = None
        self._acquirer: Any = None
        self._missed = 0
        self._gaps, self._underruns = GapCounter(), 0
        self._named = dict.fromkeys([*chain.from_iterable(config.device.settings), *_USUAL])
        self._begin()

    def _begin(self) -> None:
        self._stamps = StampMapper(self._name, self._device.stamps)
        self._told: set[str] = set()
        self._pauses = Pauses()
        self._gaps.begin()

    def connect(self) -> None:
        """Open the camera, write its settings, and start it. Raises ``DriverError``."""
        self._begin()
        device = self._device
        if not device.producer.is_file():
            raise DriverError(
                f"device.producer is {device.producer}, which is no file; correct the path, or "
                "install the producer"
            )
        self._harvester = self._module.Harvester()
        try:
            self._harvester.add_file(str(device.producer))
            self._harvester.update()
            self._acquirer = self._harvester.create(self._selected(self._harvester.device_info_list))
            self._nodes = self._acquirer.remote_device.node_map
            for name, value in chain.from_iterable(each.items() for each in device.settings):
                write(self._nodes, name, value)
            self._set_trigger(device)
            self._acquirer.start()
            self._scan = Scan3d(self._nodes, device.calibration)
        except BaseException:
            self.close()
            raise

    def frames(self) -> Iterator[PmdFrame | None]:
        """Yield frames as they come. An incomplete frame is left out and reported."""
        software = self._device.trigger == "software"
        while True:
            started_s = time.monotonic()
            if software:
                self.trigger()
            buffer = self._acquirer.try_fetch(timeout=_WAIT_S)
            if buffer is None:
                self._missed += software  # when a trigger by hardware is due is not known
                yield None
                continue
            try:
                self._gaps.take(_number(buffer))
                frame = self._frame(buffer)
            finally:
                buffer.queue()
            yield frame
            if software:
                yield from self._pauses.until(started_s + 1.0 / self._device.trigger_rate_hz)

    def due_s(self) -> float:
        """Return when the next software trigger is due, s of the monotonic clock."""
        return self._pauses.due_s

    def trigger(self) -> None:
        """Ask for one frame by software. Raises ``FeatureError``."""
        execute(self._nodes, "TriggerSoftware")

    def close(self) -> None:
        """Stop and release the camera and its producer."""
        self._underruns += self._underruns_now()
        acquirer, self._acquirer = self._acquirer, None
        harvester, self._harvester = self._harvester, None
        try:
            if acquirer is not None:
                acquirer.stop()
                acquirer.destroy()
        finally:
            if harvester is not None:
                harvester.reset()

    def sync(self) -> SensorSync:
        """Return how frames are triggered and stamped."""
        told = {"trigger": self._device.trigger, "stamp_source": self._stamps.source}
        missed = {"trigger_missed": self._missed} if self._device.trigger == "software" else {}
        return SensorSync.model_validate(told | missed)

    def drops(self) -> Drops:
        """Return the frames that the camera counted and did not deliver, and those without a free buffer.

        Both stay 0 with producers that number no frames, or count no underruns.
        """
        queue = self._underruns + self._underruns_now()
        return Drops(device=max(self._gaps.lost - queue, 0), queue=queue)

    def settings(self) -> Mapping[str, Setting]:
        """Return the configured features, those written since, and usual ones that the camera has now."""
        values = {name: read(self._nodes, name) for name in self._named}
        return {name: value for name, value in values.items() if value is not None}

    def apply(self, settings: Mapping[str, Setting]) -> None:
        """Write features in their order. Raises ``FeatureError``; then the former values are restored."""
        write_all(self._nodes, settings)
        self._named |= dict.fromkeys(settings)

    def _underruns_now(self) -> int:
        try:
            return sum(int(each.module.num_underrun) for each in self._acquirer.data_streams)
        except Exception:  # noqa: BLE001 - not told: an exception of compiled code without a common base
            return 0

    def _selected(self, found: Any) -> int:
        """Return the number of the one camera that ``device.select`` describes. Raises ``DriverError``."""
        producer, select = self._device.producer, self._device.select
        if not found:
            raise DriverError(f"{producer} finds no camera; check its network and power")
        fit = [
            number
            for number, each in enumerate(found)
            if all(_property(each, name) == value for name, value in select.items())
        ]
        if len(fit) == 1:
            return fit[0]
        known = "; ".join(f"{each.model} {each.serial_number}" for each in found)
        if not select:
            raise DriverError(f"{producer} finds several cameras ({known}); set device.select")
        raise DriverError(
            f"device.select {select} describes {len(fit) or 'none'} of the cameras that {producer} finds "
            f"({known}); correct it, so that it describes one"
        )

    def _set_trigger(self, device: GenicamDevice) -> None:
        if device.trigger == "none":
            self._end_trigger(device)
            return
        source = "Software" if device.trigger == "software" else device.trigger_line
        wanted = {"TriggerSelector": "FrameStart", "TriggerMode": "On", "TriggerSource": source}
        for name, value in wanted.items():
            write(self._nodes, name, value)

    def _end_trigger(self, device: GenicamDevice) -> None:
        """End a trigger that another program, or an earlier start, left in the camera.

        Where the settings themselves write TriggerMode, they count.
        """
        if any("TriggerMode" in each for each in device.settings):
            return
        if offers(self._nodes, "TriggerSelector", "FrameStart"):
            write(self._nodes, "TriggerSelector", "FrameStart")
        if read(self._nodes, "TriggerMode") not in (None, "Off"):
            write(self._nodes, "TriggerMode", "Off")

    def _frame(self, buffer: Any) -> PmdFrame:
        components = list(buffer.payload.components)
        depth_m = depth_of(components, self._scan)
        height, width = depth_m.shape
        amplitude, kept = amplitude_of(components), confident(components)
        if amplitude is None:
            formats = ", ".join(each.data_format for each in components)
            self._log_once(f"no grey image among {formats}: frames have no amplitude")
        amplitude = self._of_size(amplitude, "intensity", depth_m.shape)
        if (kept := self._of_size(kept, "confidence", depth_m.shape)) is not None:
            depth_m = np.where(kept, depth_m, np.float32(np.nan))
        return PmdFrame(
            stamp_ns=self._stamps.utc_ns(_stamp_ns(buffer)),
            frame_id="",
            depth_m=depth_m,
            amplitude=amplitude,
            camera=self._scan.camera(width, height),
        )

    def _of_size(self, image: NDArray[Any] | None, what: str, shape: tuple[int, ...]) -> NDArray[Any] | None:
        """Return an image if it has the size of the depth; it is logged once if it has not."""
        if image is None or image.shape == shape:
            return image
        self._log_once(f"the {what} is {image.shape}, the depth {shape}: it is left out")
        return None

    def _log_once(self, text: str) -> None:
        if text not in self._told:
            self._told.add(text)
            log.warning("%s: %s", self._name, text)


def _property(info: Any, name: str) -> Any:
    """Return what a producer says of a camera, None if it does not."""
    try:
        return getattr(info, name, None)
    except Exception:  # noqa: BLE001 - not available: an exception of compiled code without a common base
        return None


def _number(buffer: Any) -> int | None:
    """Return the number of a frame by the camera's count; None if the producer gives none."""
    try:
        return int(buffer.module.frame_id)
    except Exception:  # noqa: BLE001 - not available: an exception of compiled code without a common base
        return None


def _stamp_ns(buffer: Any) -> int | None:
    """Return a buffer's stamp by the camera's clock, ns; None if the producer gives none."""
    try:
        return int(buffer.timestamp_ns)
    except Exception:  # noqa: BLE001 - not available: an exception of compiled code without a common base
        return None
