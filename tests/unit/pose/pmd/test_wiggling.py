"""Share of a camera's wiggling that differs between the ranges of a frame."""

import numpy as np
import pytest
from scipy.constants import speed_of_light

from rpod_pose.pmd.joint.wiggling import uneven_share

PERIOD_M = 0.5 * speed_of_light / 20e6 / 4.0
"""A quarter of the unambiguous range: 1.9 m."""


def share(range_m: np.ndarray, *frequencies_hz: float) -> float:
    return uneven_share(range_m, np.ones(len(range_m)), np.array(frequencies_hz))


def test_a_short_target_shares_its_wiggling_and_a_long_one_does_not():
    for range_m in np.linspace(0.1, 7.0, 200):
        assert 0.0 <= share(np.full(7, range_m), 20e6) < 1e-12
    assert share(5.0 + np.linspace(0.0, PERIOD_M, 1000, endpoint=False), 20e6) == pytest.approx(1.0)
    assert share(5.0 + 0.05 * PERIOD_M * np.array([-1.0, 1.0]), 20e6) == pytest.approx(
        np.sin(0.1 * np.pi) ** 2
    )


def test_it_is_the_variance_of_waves_of_random_phase():
    random = np.random.default_rng(1)
    range_m, weights = random.uniform(4.0, 4.6, 300), random.uniform(0.0, 1.0, 300)
    waves = np.sin(2.0 * np.pi * range_m / PERIOD_M + random.uniform(0.0, 2.0 * np.pi, (4000, 1)))
    off = waves - (waves @ weights / weights.sum())[:, None]
    found = np.mean(off**2 @ weights / weights.sum()) / 0.5
    assert uneven_share(range_m, weights, np.array([20e6])) == pytest.approx(found, rel=0.03)


def test_nothing_is_known_without_a_frequency_or_a_point():
    assert share(np.linspace(4.0, 6.0, 10)) == 0.0
    assert uneven_share(np.zeros(0), np.zeros(0), np.array([20e6])) == 0.0
