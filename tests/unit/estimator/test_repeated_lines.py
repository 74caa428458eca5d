"""Frames of which a part is that of an earlier frame."""

import numpy as np
import pytest

from rpod_estimator.inputs.repeated_lines import RepeatedLines
from rpod_schemas.types import Camera, LidarScan, PmdFrame

CAMERA = Camera(width=80, height=60, fx=70.0, fy=70.0, cx=39.5, cy=29.5)


def seen(number, *, sigma_m=0.005, unit_m=0.0, wall=False):
    """Return the depth of a box that moves by a pixel a frame, before nothing or before a wall at rest."""
    depth_m = np.full((60, 80), 5.0 if wall else np.nan, np.float32)
    depth_m[15:45, 10 + number : 40 + number] = 3.0 - 0.01 * number
    depth_m += np.random.default_rng(number).normal(0.0, sigma_m, depth_m.shape).astype(np.float32)
    return np.float32(unit_m) * np.round(depth_m / np.float32(unit_m)) if unit_m else depth_m


def image(depth_m):
    return PmdFrame(stamp_ns=1, frame_id="c", depth_m=depth_m.astype(np.float32), camera=CAMERA)


@pytest.mark.parametrize("unit_m", [0.0, 0.001, 0.01], ids=["float", "1 mm", "10 mm"])
@pytest.mark.parametrize("back", [1, 2, 4])
def test_a_frame_whose_lower_half_is_of_an_earlier_frame_is_not_used(back, unit_m):
    lines = RepeatedLines()
    depths = [seen(number, unit_m=unit_m) for number in range(8)]
    assert [lines.found(image(each)) for each in depths[:7]] == [("", False)] * 7
    torn = depths[7].copy()
    torn[30:] = depths[7 - back][30:]
    text, is_refused = lines.found(image(torn))
    assert is_refused
    assert text.startswith(
        f"15 of its rows ({(torn[30:] > 0).sum() / (torn > 0).sum():.0%} of its values) are"
    )
    assert ("the frame before" if back == 1 else f"the frame {back} before it") in text


def test_a_scan_whose_last_columns_are_of_the_scan_before_is_not_used():
    lines, columns = RepeatedLines(), np.random.default_rng(3).normal(0.0, 0.02, (3, 16, 90))
    scans = [np.stack([0.0 * noise, 0.0 * noise, 20.0 + noise], -1).astype(np.float32) for noise in columns]
    scans[2][:, 60:] = scans[1][:, 60:]
    found = [lines.found(LidarScan(stamp_ns=1, frame_id="l", points_m=points_m)) for points_m in scans]
    assert found[:2] == [("", False)] * 2
    assert found[2][1]
    assert found[2][0].startswith("30 of its columns (33% of its values) are those of the frame before")


@pytest.mark.parametrize(
    ("sigma_m", "unit_m"), [(0.0, 0.0), (0.0002, 0.001), (0.001, 0.01), (0.005, 0.0)],
    ids=["no noise", "noise below the unit", "noise far below the unit", "noise"],
)  # fmt: skip
@pytest.mark.parametrize("wall", [False, True], ids=["free", "wall"])
def test_new_frames_with_coarse_units_or_little_noise_are_used(sigma_m, unit_m, wall):
    lines = RepeatedLines()
    for number in range(20):
        assert lines.found(image(seen(number, sigma_m=sigma_m, unit_m=unit_m, wall=wall))) == ("", False)


def test_a_dead_row_is_told_and_its_frames_are_used():
    lines, stuck = RepeatedLines(), seen(0, wall=True)[20]
    for number in range(4):
        depth_m = seen(number, wall=True)
        depth_m[20] = stuck
        text, is_refused = lines.found(image(depth_m))
        assert not is_refused
        assert text.startswith("1 of its rows (2% of its values)") == (number > 0)


def test_a_scene_at_rest_without_noise_is_no_part_of_an_earlier_frame():
    lines = RepeatedLines()
    assert [lines.found(image(seen(0, sigma_m=0.0))) for _ in range(3)] == [("", False)] * 3


def test_two_buffers_that_are_sent_in_turn_are_not_used():
    lines = RepeatedLines()
    first, second = image(seen(0)), image(seen(1))
    found = [lines.found(each) for each in (first, second, first, second)]
    assert [is_refused for _, is_refused in found] == [False, False, True, True]
    assert "(100% of its values) are those of the frame 2 before it" in found[-1][0]


def test_another_size_starts_anew():
    lines = RepeatedLines()
    lines.found(image(seen(0)))
    camera = CAMERA.model_copy(update={"height": 30})
    half = PmdFrame(stamp_ns=1, frame_id="c", depth_m=seen(0)[30:], camera=camera)
    assert lines.found(half) == ("", False)
