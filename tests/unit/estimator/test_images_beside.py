"""An amplitude image that lies beside its depth is told with the shift, whatever shades the target has."""

import numpy as np
import pytest

from rpod_estimator.inputs.beside import ImagesBeside, shift_px
from rpod_schemas.types import Camera, PmdFrame

CAMERA = Camera(width=176, height=132, fx=220.0, fy=220.0, cx=88.0, cy=66.0)
SECOND_NS = 10**9


def frame(number, shift=(0, 0), *, flat=False):
    """Return a frame of a body with a bright and a dark half, which moves over the image."""
    rng = np.random.default_rng(number)
    depth_m = np.full((132, 176), np.nan, np.float32)
    body = slice(40, 90), slice(50 + 2 * number, 110 + 2 * number)
    depth_m[body] = 3.0 + 0.01 * rng.standard_normal((50, 60))
    if flat:
        depth_m[:] = 4.0
    amplitude = 5.0 * rng.random((132, 176))
    amplitude[body] = 400.0 * rng.normal(1.0, 0.1, (50, 60))
    amplitude[40:65, 50 + 2 * number : 80 + 2 * number] *= 0.3
    amplitude = np.roll(amplitude, (shift[1], shift[0]), (0, 1)).astype(np.uint16)
    return PmdFrame(
        stamp_ns=number * 2 * SECOND_NS, frame_id="pmd", depth_m=depth_m, amplitude=amplitude, camera=CAMERA
    )


@pytest.mark.parametrize("shift", [(0, 0), (3, 0), (0, -6), (-7, 4), (10, 0)])
def test_the_shift_is_found(shift):
    seen = frame(3, shift)
    assert shift_px(seen.depth_m, seen.amplitude) == shift


def test_images_with_a_shift_are_told_with_figures_and_remedy():
    beside = ImagesBeside()
    told = [beside.found(frame(number, (-6, 4))) for number in range(6)]
    assert told[:3] == ["", "", ""]
    assert all(
        "its amplitude lies -6 px (columns) and +4 px (rows) beside its depth" in each for each in told[3:]
    )
    assert "let its driver cut and scale both images alike" in told[-1]


def test_images_that_belong_together_are_not_told():
    beside = ImagesBeside()
    assert not any(beside.found(frame(number)) for number in range(20))


def test_shifts_that_differ_are_not_told():
    """A scene in which the correlation finds something else each time."""
    beside = ImagesBeside()
    assert not any(beside.found(frame(number, (3 * (-1) ** number, 0))) for number in range(20))


def test_a_shift_that_was_corrected_is_told_no_more():
    beside = ImagesBeside()
    told = [beside.found(frame(number, (5, 0) if number < 8 else (0, 0))) for number in range(16)]
    assert told[7]
    assert not told[-1]


def test_depth_that_fills_the_image_tells_nothing():
    seen = frame(0, flat=True)
    assert shift_px(seen.depth_m, seen.amplitude) is None
    assert shift_px(np.full_like(seen.depth_m, np.nan), seen.amplitude) is None
