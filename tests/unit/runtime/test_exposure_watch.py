"""An amplitude that is of another exposure than the depth shows where outlines move."""

from itertools import pairwise

import numpy as np
import pytest
from checked_sensors import facility_frames, wall_frames

from rpod_runtime.sensor_data.exposure_watch import ExposureWatch, summed, votes


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
