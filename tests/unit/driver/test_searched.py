"""The search of the target in frames under the mistakes of a first day, without truth."""

from dataclasses import dataclass
from functools import cache
from itertools import count

import numpy as np
import open3d as o3d
import pytest
from checked_sensors import facility_frames
from scipy.spatial.transform import Rotation

from rpod_driver.check import Level, Observations, Options
from rpod_driver.check.kinds import KindChecks
from rpod_driver.check.observations import Kept
from rpod_driver.mistakes import MIRRORED_IMAGE, mirrored_image, mirrored_scan, refocused
from rpod_driver.searched import _compared, searched
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera, PmdFrame
from rpod_target import load_target

CAMERA = Camera(width=120, height=96, fx=230.0, fy=230.0, cx=60.5, cy=46.0)


@cache
def frames():
    """Return eight views of the mock-up by Open3D, of sides that tell it from its mirror image.

    The depth has noise, and the light is at the camera.
    """
    target, scene = load_target("mockup"), o3d.t.geometry.RaycastingScene()
    corners = target.triangles_m.reshape(-1, 3).astype(np.float32)
    scene.add_triangles(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
    u, v = np.meshgrid(np.arange(120) - CAMERA.cx, np.arange(96) - CAMERA.cy)
    ways = np.stack((u / CAMERA.fx, v / CAMERA.fy, np.ones_like(u)), axis=-1)
    taken, rng = [], np.random.default_rng(7)
    for number in (4, 5, 6, 7, 12, 13, 14, 15):
        turn = Rotation.from_euler("ZYX", np.array([40, 30, 20]) * number, degrees=True)
        view = make_pose(rotation=turn, translation_m=(0.1, -0.05, 3.4)).inv()
        origin = np.broadcast_to(view.translation, ways.shape)
        rays = np.concatenate((origin, view.rotation.apply(ways.reshape(-1, 3)).reshape(ways.shape)), axis=-1)
        hits = scene.cast_rays(rays.astype(np.float32))
        depth_m, normals = hits["t_hit"].numpy(), hits["primitive_normals"].numpy()
        seen = np.isfinite(depth_m)
        depth_m = np.where(seen, depth_m + rng.normal(0.0, 0.005, depth_m.shape), np.nan)
        cosine = np.abs((normals * rays[..., 3:]).sum(axis=-1))
        bright = np.where(seen, 3600.0 * cosine / np.where(seen, depth_m, 1.0) ** 2, 0.0)
        bright += np.abs(rng.normal(8.0, 4.0, depth_m.shape))
        images = {"depth_m": depth_m.astype(np.float32), "amplitude": np.rint(bright).astype(np.uint16)}
        taken.append(PmdFrame(stamp_ns=number + 1, frame_id="c", camera=CAMERA, **images))
    return tuple(taken)


def scaled(factor):
    """Return what multiplies all distances of a frame, as another unit does."""

    def changed(frame):
        name = "depth_m" if isinstance(frame, PmdFrame) else "points_m"
        return frame.model_copy(update={name: getattr(frame, name) * np.float32(factor)})

    return changed


def seen(kept, kind="pmd", newest_info=None):
    kept = [Kept(number, frame, np.zeros(0), "") for number, frame in enumerate(kept)]
    return Observations(kind, "front", Options(), kept=kept, newest_info=newest_info)


@pytest.mark.parametrize(
    ("mistake", "level", "faults"),
    [
        (lambda frame: frame, Level.OK, ()),
        (mirrored_image, Level.FAIL, ("mirrored",)),
        (refocused(2.0), Level.FAIL, ("lens_unscaled",)),
        (scaled(0.25), Level.FAIL, ("millimetres",)),
    ],
    ids=["none", "mirrored", "focal length", "a quarter"],
)
def test_a_camera_is_searched_as_it_is_and_under_the_mistakes_of_a_first_day(
    mistake, level, faults, monkeypatch
):
    for name, number in {"_FRAMES": 3, "_NEEDED": 3, "_ENOUGH": 1}.items():  # a search takes seconds
        monkeypatch.setattr(f"rpod_driver.searched.{name}", number)
    observed = seen([mistake(frame) for frame in frames()])
    result = searched(observed, load_target("mockup"), now_s=lambda: 0.0)  # a loaded machine may take minutes
    assert (result.level, result.faults) == (level, faults), result.text
    assert bool(result.remedy) == bool(faults)


def test_points_in_millimetres_are_found_without_truth():
    sensor, scans = facility_frames("lidar")
    observed = seen([scaled(1000.0)(scan) for scan in scans], "lidar", sensor.info())
    result = searched(observed, load_target("mockup"), now_s=lambda: 0.0)
    assert result.faults == ("millimetres",), result.text
    assert "in 8 with distances divided by 1000" in result.text


@dataclass
class Found:
    """What a search gives."""

    begins_track: bool


@dataclass
class Acquirer:
    """A search that finds the target where it is told to."""

    where: object

    def acquire(self, frame):
        return Found(self.where(frame))


def judged(where, *, step_s=0.0):
    """Return the result of a search that finds the target in some frames; a look at the clock takes time."""
    looks = count(1)
    return _compared(frames(), Acquirer(where), [MIRRORED_IMAGE], 180.0, lambda: step_s * next(looks))


def is_mirrored(frame):
    return frame.camera.cx != CAMERA.cx


def test_a_body_that_is_its_own_mirror_image_is_not_judged():
    result = judged(lambda _: True)
    assert result.level is Level.UNCHECKED
    assert "found in 8 of 8 frames as they are, in 8 mirrored" in result.text
    assert "let it show other sides" in result.text


def test_a_target_that_is_found_under_no_mistake_is_not_judged():
    result = judged(lambda _: False)
    assert result.level is Level.UNCHECKED
    assert "found in 0 of 3 frames as they are, and under no usual mistake" in result.text


def test_what_is_not_tried_in_time_is_told():
    assert "not all mistakes were tried in 180 s" in judged(lambda _: False, step_s=200.0).text


def test_three_frames_more_under_a_mistake_are_no_proof():
    first = {id(frame) for frame in frames()[:5]}
    result = judged(lambda frame: is_mirrored(frame) or id(frame) in first)
    assert result.level is Level.UNCHECKED


def test_mirroring_twice_gives_the_frame_back():
    for frame, mirrored in ((frames()[0], mirrored_image), (facility_frames("lidar")[1][0], mirrored_scan)):
        again = mirrored(mirrored(frame))
        for name in ("depth_m", "points_m", "amplitude", "time_s"):
            if hasattr(frame, name):
                np.testing.assert_array_equal(getattr(again, name), getattr(frame, name))


def test_too_few_frames_are_told():
    assert searched(seen(frames()[:3]), load_target("mockup")).text == ("3 frames were read, 8 are needed")


def test_a_kind_without_mistakes_of_its_own_is_not_searched(monkeypatch):
    monkeypatch.setattr("rpod_driver.searched.checks_of", lambda _: KindChecks())
    assert searched(seen(frames()), load_target("mockup")).text == "no search for sensors of kind pmd"
