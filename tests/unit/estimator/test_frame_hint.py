"""What a frame measures is told where no pose is found in it."""

import re

import numpy as np
import pytest

from rpod_estimator.frame_hint import described
from rpod_schemas.types import Camera, LidarScan, PmdFrame

CAMERA = Camera(width=8, height=6, fx=190.0, fy=190.0, cx=3.5, cy=2.5)


def frame(middle_m: float) -> PmdFrame:
    depth_m = np.full((6, 8), middle_m, np.float32)
    depth_m[0] = np.nan
    return PmdFrame(stamp_ns=1, frame_id="c", depth_m=depth_m, amplitude=None, camera=CAMERA)


@pytest.mark.parametrize(
    ("middle_m", "told"),
    [
        (
            4000.0,
            "it measures 4,000 to 4,000 m, where the target is at most 0.1 pixels wide: .*0.001 for mill",
        ),
        (40.0, "it measures 40 to 40 m, where the target is at most 9.5 pixels wide"),
        (
            200.0,
            "it measures 200 to 200 m, where the target is at most 1.9 pixels wide: ",
        ),
        (
            0.004,
            "it measures 0.004 to 0.004 m, which is inside the target, whose radius is 1 m: .*depth_unit_m",
        ),
    ],
)
def test_depth_that_cannot_be_of_the_target_is_told_with_the_field_to_set(middle_m: float, told: str) -> None:
    assert re.match(told, described(frame(middle_m), radius_m=1.0))


def test_depths_below_zero_are_told() -> None:
    told = "all 40 depths are below zero, -3 m in the median: let the driver send the depth along "
    assert described(frame(-3.0), radius_m=1.0).startswith(told)


def disc(scale: float, *, lens: bool, turned_deg: float = 30.0) -> PmdFrame | LidarScan:
    """Return a frame of a disc of 1 m radius at 4 m, with its distances in another unit."""
    camera = Camera(width=120, height=90, fx=190.0, fy=190.0, cx=59.5, cy=44.5)
    u, v = np.meshgrid((np.arange(120) - 59.5) / 190.0, (np.arange(90) - 44.5) / 190.0)
    depth_m = 4.0 / (1.0 + np.tan(np.radians(turned_deg)) * u)
    off = np.hypot(u * depth_m / np.cos(np.radians(turned_deg)), v * depth_m) > 1.0
    depth_m = np.where(off, np.nan, scale * depth_m).astype(np.float32)
    if lens:
        return PmdFrame(stamp_ns=1, frame_id="c", depth_m=depth_m, amplitude=None, camera=camera)
    points_m = np.stack((u * depth_m, v * depth_m, depth_m), axis=-1).astype(np.float32)
    return LidarScan(stamp_ns=1, frame_id="l", points_m=points_m)


@pytest.mark.parametrize("lens", [True, False], ids=["camera", "LIDAR"])
@pytest.mark.parametrize("turned_deg", [0.0, 30.0, 60.0])
def test_a_target_in_its_own_unit_gets_no_hint(lens: bool, turned_deg: float) -> None:
    hint = described(disc(1.0, lens=lens, turned_deg=turned_deg), radius_m=1.0, side_m=2.0)
    assert re.fullmatch("it measures [0-9.]+ to [0-9.]+ m", hint)


@pytest.mark.parametrize("lens", [True, False], ids=["camera", "LIDAR"])
@pytest.mark.parametrize(
    ("scale", "told"),
    [
        (4.0, "the target is 2 m wide at most: if nothing else is in view, distances are in another unit"),
        (3.0, "the target is 2 m wide at most: if nothing else is in view, distances are in another unit"),
        (6.0, "the target is 2 m wide at most: if nothing else is in view, distances are in another unit"),
        (0.25, "the target is 2 m wide or more: if all of it is in view, distances are in another unit"),
    ],
)
def test_a_unit_that_is_off_by_a_factor_of_four_is_told_by_the_width_of_what_is_seen(scale, told, lens):
    hint = described(disc(scale, lens=lens), radius_m=1.0, side_m=2.0)
    assert f"m wide, while {told}" in hint
    assert ("source.depth_unit_m" if lens else "the unit of its points") in hint
    assert ("camera_info" in hint) == lens


def test_a_frame_without_a_range_tells_nothing() -> None:
    assert not described(frame(np.nan), radius_m=1.0)


@pytest.mark.parametrize(
    ("distance_m", "told"),
    [(1e30, "it measures 1e+30 to 1e+30 m"), (1e-30, "it measures 1e-30 to 1e-30 m, which is inside")],
)
def test_distances_whose_squares_have_no_32_bits_are_told(distance_m: float, told: str) -> None:
    points_m = np.full((9, 3), [0.0, 0.0, distance_m], np.float32)
    scan = LidarScan(stamp_ns=1, frame_id="l", points_m=points_m)
    assert described(scan, radius_m=1.0, side_m=1.0).startswith(told)
