"""Every adapter keeps to the contract of drivers, with its recording, its SDK's software device, or a fake.

A recording of one frame gives the same each time, so that ``frozen`` is expected of it.
"""

import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from checked_sensors import CAMERA, EPOCH_NS, INFO, wall_frames
from genicam_fakes import SCAN, Nodes, PlayedHarvesters
from ifm_recording import PlayedSdk as PlayedIfm
from ifm_recording import configuration
from rosbags.rosbag2 import StoragePlugin, Writer

from rpod_driver.adapters.genicam.config import GenicamConfig
from rpod_driver.adapters.genicam.driver import GenicamCamera
from rpod_driver.adapters.ifm.driver import LiveIfm, RecordedIfm, open_driver
from rpod_driver.adapters.process import ProcessConfig
from rpod_driver.adapters.process import open_driver as open_process
from rpod_driver.adapters.realsense import RealsenseConfig
from rpod_driver.adapters.realsense.driver import RealsenseCamera
from rpod_driver.adapters.replay.config import ReplayConfig
from rpod_driver.adapters.replay.driver import open_driver as open_replay
from rpod_driver.check import Options
from rpod_driver.contract import DriverContract
from rpod_schemas.messages import write_camera, write_image, write_pmd_info
from rpod_schemas.rmw.cdr import encode, typestore

TESTS = Path(__file__).parents[2]
OUSTER = TESTS / "recordings" / "ouster" / "os1-32.frames"
WALLS = list(islice(wall_frames(5, 60.0), 40))


class Adapters(DriverContract):
    duration_s = 0.6
    options = Options(rate_hz=20.0)


class TestRecordedIfm(Adapters):
    kind = "pmd"
    expected = frozenset({"frozen"})  # one buffer

    @pytest.fixture
    def driver(self):
        return open_driver(configuration(rate_hz=20.0, repeat=100))


class TestLiveIfm(Adapters):
    kind = "pmd"

    @pytest.fixture
    def driver(self):
        told = configuration(recording=None, calibration=None, ip="192.168.0.69", port="port3")
        return LiveIfm(told, PlayedIfm())


class TestReplay(Adapters):
    kind = "pmd"

    @pytest.fixture
    def driver(self, tmp_path):
        with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {}

            def put(topic, message, stamp_ns):
                if topic not in connections:
                    kind = message.__msgtype__
                    connections[topic] = writer.add_connection(topic, kind, typestore=typestore())
                writer.write(connections[topic], stamp_ns, bytes(encode(message)))

            put("/front/info", write_pmd_info(EPOCH_NS, "front_optical", INFO), EPOCH_NS)
            for number, frame in enumerate(WALLS):
                stamp_ns = EPOCH_NS + 50_000_000 * number
                put("/front/camera_info", write_camera(stamp_ns, "front_optical", CAMERA), stamp_ns)
                depth = write_image(stamp_ns, "front_optical", frame.depth_m, "32FC1")
                put("/front/depth/image_raw", depth, stamp_ns)
        return open_replay(ReplayConfig(name="front", kind="pmd", device={"bag": tmp_path / "bag"}))


class TestGenicam(Adapters):
    kind = "pmd"

    @pytest.fixture
    def driver(self, tmp_path):
        (tmp_path / "fake.cti").touch()
        told = {"producer": tmp_path / "fake.cti", "calibration": CAMERA, "settings": {"ExposureTime": 500.0}}
        counts = [(np.nan_to_num(frame.depth_m * 1e3).astype(np.uint16), frame.amplitude) for frame in WALLS]
        scan = SCAN | {"Scan3dCoordinateScale": 1.0, "Scan3dCoordinateOffset": 0.0, "ExposureTime": 1.0}
        config = GenicamConfig.model_validate({"name": "front", "device": told})
        return GenicamCamera(config, PlayedHarvesters(Nodes(**scan), counts, 0.05))


class TestRealsense(Adapters):
    kind = "pmd"

    @pytest.fixture
    def driver(self):
        fakes = pytest.importorskip("realsense_fakes")
        random = np.random.default_rng(1)
        plane = np.add.outer(np.linspace(2500, 2000, fakes.SHAPE[0]), np.linspace(0, 300, fakes.SHAPE[1]))
        images = [
            (
                (plane + 5.0 * random.standard_normal(plane.shape)).astype(np.uint16),
                random.integers(90, 110, plane.shape).astype(np.uint8),
            )
            for _ in range(20)
        ]
        return RealsenseCamera(RealsenseConfig(name="front"), fakes.PlayedSdk(images, 0.05))


class TestProcess(Adapters):
    kind = "pmd"

    @pytest.fixture
    def driver(self):
        return process("pmd", "paced")


class TestRecordedOuster(Adapters):
    kind = "lidar"
    expected = frozenset({"frozen"})  # one scan

    @pytest.fixture
    def driver(self):
        return process("lidar", "repeated", str(OUSTER))


def process(kind, *arguments):
    device = {"python": sys.executable, "script": TESTS / "driver_script.py", "arguments": arguments}
    return open_process(ProcessConfig.model_validate({"name": "front", "kind": kind, "device": device}))


def test_a_recording_of_a_head_is_what_its_configuration_opens():
    assert isinstance(open_driver(configuration()), RecordedIfm)
