"""How ``make soak`` and ``make kills`` assess what they measured."""

import numpy as np
import pytest

from endurance.soak import quantiles_ms, slope


def rows(memory_mib):
    time_s = np.arange(len(memory_mib), dtype=float)
    return np.column_stack([time_s, memory_mib])


def test_a_slope_is_that_of_the_settled_time_with_an_interval_that_holds_it():
    generator = np.random.default_rng(1)
    time_min = np.arange(3600) / 60.0
    start = 50.0 * np.exp(-time_min)
    found = slope(rows(100.0 + 0.4 * time_min - start + generator.normal(0.0, 1.0, 3600)), 1)
    assert found.per_minute == pytest.approx(0.4, abs=0.02)
    assert 0.0 < found.low < 0.4 < found.high < 0.5


def test_steps_have_a_wider_interval_than_noise():
    steps = np.repeat([100.0, 104.0], [2700, 900])
    noise = np.random.default_rng(2).permutation(np.linspace(100.0, 104.0, 3600))
    wide, narrow = slope(rows(steps), 1), slope(rows(noise), 1)
    assert wide.high - wide.low > 3.0 * (narrow.high - narrow.low)


def test_a_short_time_has_no_slope_and_nothing_has_no_quantiles():
    assert slope(rows(np.ones(120)), 1) is None
    assert quantiles_ms(np.zeros((0, 2))) == {}
    assert quantiles_ms(rows(np.full(10, 0.02)))["p99.9"] == 20.0
