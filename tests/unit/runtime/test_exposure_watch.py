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
