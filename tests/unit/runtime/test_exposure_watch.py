"""An amplitude that is of another exposure than the depth shows where outlines move."""

from itertools import pairwise

import numpy as np
import pytest
from checked_sensors import facility_frames, wall_frames

from rpod_runtime.sensor_data.exposure_watch import ExposureWatch, Votes, summed, votes


def mockup_frames():
    return facility_frames("pmd")[1][:30]


def walls():
    return list(wall_frames(3, 12.0))


def behind(frames):
    """Return frames with the amplitude of the frame before."""
    return [later.model_copy(update={"amplitude": earlier.amplitude}) for earlier, later in pairwise(frames)]


def told(frames):
    watch = ExposureWatch()
    for frame in frames:
        watch.take(frame)
    return watch.text


@pytest.mark.parametrize("taken", [mockup_frames, walls])
def test_an_amplitude_of_the_exposure_before_is_told_with_the_remedy_and_one_of_the_same_is_not(taken):
    frames = taken()
    assert told(frames) == ""
    text = told(behind(frames))
    assert text.startswith("its amplitude is of the exposure before: so say ")
    assert text.endswith("let its driver send images of one exposure, or leave that topic out")


def test_an_outline_that_noise_alone_changes_tells_nothing():
    generator = np.random.default_rng(8)
    frames = []
    for number, frame in enumerate(mockup_frames()[:1] * 30):
        lost = generator.random(frame.depth_m.shape) < 0.3
        depth_m = np.where(lost, np.float32(np.nan), frame.depth_m)
        update = {"stamp_ns": frame.stamp_ns + number * 200_000_000, "depth_m": depth_m}
        frames.append(frame.model_copy(update=update))
    found = summed([votes(*pair) for pair in pairwise(frames)])
    assert found.suffice
    assert not found.is_behind
    assert told(frames) == ""


@pytest.mark.parametrize(
    ("before", "now", "is_behind"), [(40, 9, False), (41, 19, False), (44, 16, True), (640, 360, False)]
)
def test_a_majority_counts_if_it_is_no_chance(before, now, is_behind):
    assert Votes(before, now).is_behind is is_behind


def one_by_one(before, after):
    """Return the votes of few changed pixels, pixel by pixel as the module describes them."""
    ranges_m = np.stack([frame.depth_m.astype(float) for frame in (before, after)])
    ranges_m[~(np.isfinite(ranges_m) & (ranges_m > 0.0))] = np.inf
    both = np.isfinite(ranges_m).all(axis=0)
    moved_m = np.where(both, np.abs(np.subtract(*np.where(both, ranges_m, 0.0))), 0.0)
    nearest_m = ranges_m.min(axis=0)
    step_m = np.maximum(
        0.03 * np.where(np.isfinite(nearest_m), nearest_m, 0.0), 6.0 * np.median(moved_m[both])
    )
    changed = (np.isfinite(ranges_m[0]) != np.isfinite(ranges_m[1])) | (moved_m > step_m)
    rows, columns = np.nonzero(changed)
    counts = [0, 0]
    for place in np.random.default_rng(0).permutation(rows.size)[:120]:
        row, column = rows[place], columns[place]
        own_m = ranges_m[:, row, column]
        middle_m = own_m.mean() if both[row, column] else own_m.min() + step_m[row, column]
        around = np.s_[max(row - 4, 0) : row + 5, max(column - 4, 0) : column + 5]
        near, shade = ranges_m[1][around] <= middle_m, after.amplitude[around].astype(float)
        sides = [shade[~changed[around] & side] for side in (near, ~near)]
        if min(map(len, sides)) < 4:
            continue
        middles = [np.median(side) for side in sides]
        spread = sum(np.median(np.abs(side - middle)) for side, middle in zip(sides, middles, strict=True))
        if abs(middles[0] - middles[1]) > 3.0 * spread:
            light = float(after.amplitude[row, column])
            is_near = abs(light - middles[0]) < abs(light - middles[1])
            counts[int(is_near != (own_m[0] <= middle_m))] += 1
    return tuple(counts)


@pytest.mark.parametrize("taken", [mockup_frames, walls])
def test_all_pixels_at_once_vote_as_they_do_one_by_one(taken):
    frames = taken()[:8]
    pairs = [*pairwise(frames), *pairwise(behind(frames))]
    found = [votes(*pair) for pair in pairs]
    assert sum(map(sum, found)) > 50
    assert found == [one_by_one(*pair) for pair in pairs]


def test_where_nothing_moves_nothing_is_told():
    first = mockup_frames()[0]
    still = [
        first.model_copy(update={"stamp_ns": first.stamp_ns + number * 200_000_000}) for number in range(30)
    ]
    assert told(still) == ""
    assert sum(votes(still[0], still[1])) == 0


def test_frames_between_which_others_are_missing_are_not_compared():
    frames = behind(walls())
    watch = ExposureWatch()
    for number, frame in enumerate(frames):
        if number in (0, 1) or number % 3 == 0:
            watch.take(frame)
    assert watch.text == ""


def test_frames_without_an_amplitude_or_of_another_size_are_left_out():
    frames = mockup_frames()[:4]
    small = frames[1].model_copy(
        update={"depth_m": frames[1].depth_m[:40], "amplitude": frames[1].amplitude[:40]}
    )
    assert told([frames[0], small, frames[2], frames[3].model_copy(update={"amplitude": None})]) == ""


def test_a_frame_without_any_range_has_no_outline():
    frame = mockup_frames()[0]
    dark = frame.model_copy(update={"depth_m": np.full_like(frame.depth_m, np.nan)})
    assert summed([votes(dark, dark)]) == (0, 0)
