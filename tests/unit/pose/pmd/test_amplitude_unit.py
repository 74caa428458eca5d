"""Amplitudes in any unit: methods get counts."""

import numpy as np
import pytest

from rpod_pose.pmd.amplitude_unit import in_counts, least_count
from rpod_pose.pmd.depth_preparation import DepthPreparation
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera, PmdFrame
from rpod_target import load_target

CAMERA = Camera(width=30, height=20, fx=30.0, fy=30.0, cx=14.5, cy=9.5)
SHADES = np.random.default_rng(1).uniform(0.55, 0.8, (20, 30)).astype(np.float32)


def frame(amplitude: np.ndarray | None, depth_m: float = 3.0) -> PmdFrame:
    return PmdFrame(
        stamp_ns=0,
        frame_id="",
        depth_m=np.full((20, 30), depth_m, np.float32),
        amplitude=amplitude,
        camera=CAMERA,
    )


@pytest.mark.parametrize("unit", [1e-6, 1.0, 3e5])
def test_floats_of_any_unit_become_counts_by_a_power_of_two(unit: float):
    counts = in_counts(frame(SHADES * np.float32(unit))).amplitude
    assert counts is not None
    assert 512 <= np.median(counts) < 1024
    factor = counts / (SHADES * np.float32(unit))
    np.testing.assert_array_equal(factor, factor[0, 0])
    assert np.frexp(factor[0, 0])[0] == 0.5


def test_integers_whole_numbers_and_frames_that_tell_no_unit_stay_as_they_are():
    counts = (SHADES * 50).astype(np.uint16)
    dark = np.zeros((20, 30), np.float32)
    for amplitude in (counts, counts.astype(np.float32), dark, None):
        assert in_counts(same := frame(amplitude)) is same
    assert in_counts(same := frame(SHADES, depth_m=np.nan)) is same


def test_one_count_is_one_of_integers_and_a_thousandth_of_the_typical_amplitude_of_floats():
    assert least_count(np.ones(3, np.uint8), 0.3) == 1.0
    assert least_count(SHADES, 0.5) == pytest.approx(0.5 / 1024)


def test_methods_get_counts_with_a_prediction_and_without():
    preparation, seen = DepthPreparation(PmdInput(), load_target("mockup")), frame(SHADES)
    predicted = preparation.predicted(seen, make_pose(translation_m=[0.0, 0.0, 3.0]))
    for prepared in (predicted, *preparation.possible(seen)):
        np.testing.assert_array_equal(prepared.amplitude, in_counts(seen).amplitude)
