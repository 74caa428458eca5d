"""The recorded buffer of an ifm O3R in docs/examples/ifm, and what a head's SDK makes of such images."""

import time
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from rpod_driver.adapters.ifm.chunks import RADIAL_DISTANCE, buffers
from rpod_driver.adapters.ifm.config import IfmConfig
from rpod_driver.adapters.ifm.frames import images_of

FOLDER = Path(__file__).parents[1] / "docs" / "examples" / "ifm"
BUFFER, TOF_INFO, LENS = FOLDER / "O3RBuffer.data", FOLDER / "tof_info.data", FOLDER / "lens.yaml"
TOF_INFO_HEADER_BYTES = 16
"""Length of what stands before the structure in the file."""


def tof_info_bytes() -> bytes:
    """Return a TOF_INFO of version 4."""
    return TOF_INFO.read_bytes()[TOF_INFO_HEADER_BYTES:]


def configuration(**device: object) -> IfmConfig:
    """Return the configuration of a recording; the buffer in the repository unless told otherwise."""
    told = {"recording": str(BUFFER), "calibration": str(LENS)} | device
    return IfmConfig.model_validate({"name": "front", "device": told})


def recorded():
    """Return the chunks of the one buffer."""
    (chunks,) = buffers(BUFFER.read_bytes(), "recorded")
    return chunks


class FakeSdk:
    """``ifm3dpy`` with one head that sends the recorded images, after ``silent`` waits without a frame."""

    def __init__(self, *, tof_info: bytes, starts: bool = True, raw: bool = False) -> None:
        names = ("RADIAL_DISTANCE_IMAGE", "RADIAL_DISTANCE_NOISE", "NORM_AMPLITUDE_IMAGE", "CONFIDENCE_IMAGE")
        self.settings: list[dict] = []
        self.port_settings = {
            "acquisition": {"framerate": 10.0, "version": {"major": 1}},
            "mode": "standard_range2m",
        }
        self.count = 0
        self.ports: list[int] = []
        self.stopped = 0
        self._starts, self._silent = starts, 1
        images = images_of(recorded())
        arrays = (images.range_m, images.sigma_m, images.amplitude, images.confidence)
        self._buffers = dict(zip(names, arrays, strict=True)) | {
            "TOF_INFO": np.frombuffer(tof_info, np.uint8)[None]
        }
        if raw:
            self._buffers["RADIAL_DISTANCE_IMAGE"] = recorded()[RADIAL_DISTANCE].image()
        self.device = SimpleNamespace(O3R=lambda _: self)
        self.framegrabber = SimpleNamespace(
            FrameGrabber=self._grab, buffer_id=SimpleNamespace(**{name: name for name in self._buffers})
        )

    def set(self, settings):
        self.settings.append(settings)
        for changed in settings["ports"].values():
            acquisition = self.port_settings["acquisition"] | changed.get("acquisition", {})
            self.port_settings |= changed | {"acquisition": acquisition}

    def get(self, paths):
        (path,) = paths
        return {"ports": {path.rpartition("/")[2]: self.port_settings | {"info": {"sensorID": "IRS2381C"}}}}

    def frame_count(self):
        self.count += 1
        return self.count

    def port(self, name):
        return SimpleNamespace(pcic_port=50010 + int(name[-1]))

    def _grab(self, _device, port):
        self.ports.append(port)
        return self

    def start(self, _wanted):
        return SimpleNamespace(wait_for=lambda _: (self._starts, None))

    def stop(self):
        self.stopped += 1
        return SimpleNamespace(wait_for=lambda _: (True, None))

    def wait_for_frame(self):
        self._silent -= 1
        return SimpleNamespace(wait_for=lambda _: (False, None) if self._silent >= 0 else (True, self))

    def has_buffer(self, name):
        return name in self._buffers

    def get_buffer(self, name):
        return self._buffers[name]

    def timestamps(self):
        return [datetime.fromtimestamp(324_896.5, UTC)]


class PlayedSdk(FakeSdk):
    """A head whose distances have noise, and whose frames come at their pace, those of a pause at once."""

    PERIOD_S = 0.05

    def __init__(self) -> None:
        super().__init__(tof_info=tof_info_bytes())
        self._radial_m = self._buffers["RADIAL_DISTANCE_IMAGE"]
        self._random, self._next_s = np.random.default_rng(1), 0.0

    def wait_for_frame(self):
        self._next_s = (self._next_s or time.time()) + self.PERIOD_S
        time.sleep(max(0.0, self._next_s - time.time()))
        noise = 1e-3 * self._random.standard_normal(self._radial_m.shape).astype(np.float32)
        self._buffers["RADIAL_DISTANCE_IMAGE"] = np.where(self._radial_m > 0, self._radial_m + noise, 0)
        return SimpleNamespace(wait_for=lambda _: (True, self))

    def timestamps(self):
        return [datetime.fromtimestamp(self._next_s % 1e6, UTC)]
