"""What a frame measures is told where no pose is found in it."""

import re

import numpy as np
import pytest

from rpod_estimator.frame_hint import described
from rpod_schemas.types import Camera, PmdFrame

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
        (4.0, "it measures 4 to 4 m$"),
        (0.004, "it measures 0.004 to 0.004 m, inside the target, whose radius is 1 m: .*depth_unit_m"),
    ],
)
def test_depth_that_cannot_be_of_the_target_is_told_with_the_field_to_set(middle_m: float, told: str) -> None:
    assert re.match(told, described(frame(middle_m), radius_m=1.0))


def test_a_frame_without_a_range_tells_nothing() -> None:
    assert not described(frame(np.nan), radius_m=1.0)
