"""A GenICam camera of fakes: features, buffers, and what harvesters makes of them."""

import time
from types import SimpleNamespace

import numpy as np

from rpod_driver.adapters.genicam.config import GenicamConfig
from rpod_driver.adapters.genicam.driver import GenicamCamera


class Nodes:
    """Features with limits."""

    def __init__(self, **values) -> None:
        self.executed: list[str] = []
        for name, value in values.items():
            setattr(self, name, SimpleNamespace(value=value))
        self.TriggerSoftware = SimpleNamespace(execute=lambda: self.executed.append("TriggerSoftware"))

    def has_node(self, name):
        return hasattr(self, name)


SCAN = {
    "Scan3dOutputMode": "CalibratedABC_Grid",
    "Scan3dCoordinateSystem": "Cartesian",
    "Scan3dDistanceUnit": "Millimeter",
    "Scan3dCoordinateSelector": "CoordinateA",
    "Scan3dCoordinateScale": 0.5,
    "Scan3dCoordinateOffset": 100.0,
    "Scan3dInvalidDataFlag": True,
    "Scan3dInvalidDataValue": 0.0,
    "Scan3dFocalLength": 4.0,
    "Scan3dPrincipalPointU": 1.5,
    "Scan3dPrincipalPointV": 1.0,
    "Width": 4,
    "Height": 3,
}


def component(data_format, data, width=4, height=3):
    return SimpleNamespace(data_format=data_format, data=np.ravel(data), width=width, height=height)


COUNTS = np.arange(12, dtype=np.uint16).reshape(3, 4)


class Buffer:
    """A buffer with depth, intensity and a stamp."""

    timestamp_ns = 77_000_000_000

    def __init__(self, depth=COUNTS + 1, grey=COUNTS, number=1) -> None:
        height, width = depth.shape
        parts = [
            component("Coord3D_C16", depth, width, height),
            component("Mono16", grey, width, height),
        ]
        self.module = SimpleNamespace(frame_id=number)
        self.payload = SimpleNamespace(components=parts)
        self.queued = 0

    def queue(self):
        self.queued += 1


class FakeHarvesters:
    """``harvesters.core`` with one camera that gives the buffers of a list, None for a time-out."""

    def __init__(self, nodes, buffers) -> None:
        self.nodes, self._buffers = nodes, list(buffers)
        self.remote_device = SimpleNamespace(node_map=nodes)
        self.device_info_list = [SimpleNamespace(model="Fake", serial_number="1")]
        self.calls: list[str] = []
        self.underruns = 0

    def Harvester(self):  # noqa: N802 - harvesters' name
        return self

    def create(self, _selected):
        return self

    def try_fetch(self, timeout):
        assert timeout > 0
        return self._buffers.pop(0)

    @property
    def data_streams(self):
        return [SimpleNamespace(module=SimpleNamespace(num_underrun=self.underruns))]

    def __getattr__(self, name):
        return lambda *_: self.calls.append(name)


def faked(nodes, buffers, tmp_path, **device):
    (tmp_path / "fake.cti").touch()
    told = {"producer": tmp_path / "fake.cti", "trigger_rate_hz": 1000} | device
    config = GenicamConfig.model_validate({"name": "front", "device": told})
    return GenicamCamera(config, FakeHarvesters(nodes, buffers))


class PlayedHarvesters(FakeHarvesters):
    """One camera that sends pairs of depth in counts and grey images, as if taken now."""

    def __init__(self, nodes, images, period_s) -> None:
        super().__init__(nodes, [])
        self._images, self._period_s = images, period_s
        self._number, self._next_s = 0, time.time()

    def try_fetch(self, timeout):
        assert timeout > 0
        self._next_s = max(self._next_s, time.time() - self._period_s) + self._period_s
        time.sleep(max(0.0, self._next_s - time.time()))
        buffer = Buffer(*self._images[self._number % len(self._images)], number=self._number)
        buffer.timestamp_ns = round(1e9 * self._next_s)
        self._number += 1
        return buffer
