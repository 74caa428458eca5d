"""The contract of drivers: on the shipped example, on an emulated camera, and on drivers that break it."""

import time
from importlib.util import module_from_spec, spec_from_file_location
from itertools import islice
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from checked_sensors import INFO, ideal_frames, wall_frames

import rpod_driver
from rpod_driver.contract import DriverContract
from rpod_schemas.types import PmdFrame

EXAMPLE = Path(rpod_driver.__file__).parent / "examples" / "recorded_frames.py"
PERIOD_NS = 50_000_000


class Played:
    """A driver that plays frames as if taken now, 20 a second."""

    def __init__(self, frames: tuple[PmdFrame, ...], *, ahead_s: float = 0.0, quiet_s: float = 0.0) -> None:
        self._frames, self._ahead_ns, self._quiet_s = frames, round(ahead_s * 1e9), quiet_s

    def connect(self):
        return INFO

    def frames(self):
        pause, start_ns = Event(), time.time_ns()
        pause.wait(self._quiet_s)
        for number, frame in enumerate(self._frames):
            stamp_ns = start_ns + number * PERIOD_NS
            pause.wait(max(0.0, (stamp_ns - time.time_ns()) * 1e-9))
            yield frame.model_copy(update={"stamp_ns": stamp_ns + self._ahead_ns})

    def close(self) -> None:
        pass


WALLS = tuple(islice(wall_frames(5, 60.0), 60))


class TestExample(DriverContract):
    kind, duration_s = "pmd", 1.0

    @pytest.fixture
    def driver(self, tmp_path):
        spec = spec_from_file_location("recorded_frames", EXAMPLE)
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        camera = WALLS[0].camera
        np.savez(
            tmp_path / "frames.npz",
            stamp_ns=PERIOD_NS * np.arange(60),
            depth_m=[frame.depth_m for frame in WALLS],
            amplitude=[frame.amplitude for frame in WALLS],
            camera=[camera.fx, camera.fy, camera.cx, camera.cy],
        )
        return module.RecordedFrames(str(tmp_path / "frames.npz"))


class TestEmulatedCamera(DriverContract):
    kind, duration_s = "pmd", 1.0

    @pytest.fixture
    def driver(self):
        return Played(ideal_frames()[:40])


def contract() -> DriverContract:
    class OfWalls(DriverContract):
        kind, duration_s = "pmd", 0.6

    return OfWalls()


def test_a_driver_with_stamps_in_tai_breaks_it_and_the_remedy_is_told():
    with pytest.raises(AssertionError, match=r"clock: stamps are 3[67]\..* let the driver subtract 37 s"):
        contract().test_the_check_finds_nothing_wrong(Played(WALLS, ahead_s=37.0))


def test_a_driver_that_repeats_its_last_frame_breaks_it():
    with pytest.raises(AssertionError, match="frozen"):
        contract().test_the_check_finds_nothing_wrong(Played(WALLS[:1] * 30))


def test_a_driver_that_yields_nothing_for_long_breaks_it():
    with pytest.raises(AssertionError, match="yield None once a second"):
        contract().test_frames_come_and_no_item_takes_long(Played(WALLS, quiet_s=1.6))
