"""Frames whose sky is as bright as the target."""

import numpy as np
import pytest
from tests.pmd_frames import CAMERA, frame_of

from rpod_pose.pmd.joint.check.bright_beyond import is_bright_beyond, or_by_depth

SHAPE = (CAMERA.height, CAMERA.width)
DEPTH_M = np.full(SHAPE, np.nan)
DEPTH_M[100:200, 100:200] = 4.0


def before(brightness: float, *, inside: float = 100.0):
    amplitude = np.full(SHAPE, brightness, np.float32)
    amplitude[100:200, 100:200] = inside
    return frame_of(DEPTH_M, amplitude=amplitude)


@pytest.mark.parametrize(("sky", "bright"), [(0.0, False), (20.0, False), (30.0, True), (500.0, True)])
def test_a_sky_from_a_quarter_of_the_targets_brightness_on_is_bright(sky, bright):
    assert is_bright_beyond(before(sky)) == bright


def test_frames_without_amplitude_or_with_a_range_in_every_or_no_pixel_have_no_bright_sky():
    shade = np.full(SHAPE, 100.0, np.float32)
    for frame in (frame_of(DEPTH_M), frame_of(4.0, amplitude=shade), frame_of(np.nan, amplitude=shade)):
        assert not is_bright_beyond(frame)


@pytest.mark.parametrize(
    ("sky", "good", "measured"),
    [
        (100.0, "depth", ["both", "depth"]),
        (100.0, "none", ["both", "depth"]),
        (100.0, "both", ["both"]),
        (0.0, "depth", ["both"]),
    ],
)
def test_the_depth_alone_counts_where_the_sky_is_bright_and_the_whole_frame_gives_nothing(
    sky, good, measured
):
    asked = []

    def measure(frame):
        asked.append("depth" if frame.amplitude is None else "both")
        return asked[-1]

    found, by_depth = or_by_depth(measure, before(sky), lambda each: each == good)
    assert asked == measured
    assert found == (good if good in measured else "both")
    assert by_depth == (found == "depth")
