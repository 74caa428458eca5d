"""Two frequencies tell distances that one cannot."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import constants

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import MODULATION_FREQUENCIES_HZ, PmdConfig
from rpod_sim_sensor.pmd import distance, phase, unwrap

THETA = np.array([0.0, np.pi, np.pi / 2, 3 * np.pi / 2])
DUAL = PmdConfig(profile="dual")


def dual(first_hz: float, second_hz: float) -> PmdConfig:
    return PmdConfig.model_validate({"profile": "dual", "dual_frequencies_hz": (first_hz, second_hz)})


def wrapped(distance_m: FloatArray | float, config: PmdConfig) -> list[FloatArray]:
    return [np.asarray(distance_m) % (constants.c / (2 * hz)) for hz in config.frequencies_hz]


@pytest.mark.parametrize("pair_hz", list(permutations(MODULATION_FREQUENCIES_HZ, 2)))
def test_every_pair_measures_all_of_its_unambiguous_range(pair_hz: tuple[float, float]) -> None:
    config = dual(*pair_hz)
    truth_m = np.linspace(0.0, 0.999 * config.unambiguous_range_m, 2000)
    distance_m, disagreement = unwrap(*wrapped(truth_m, config), config)
    np.testing.assert_allclose(distance_m, truth_m, atol=1e-9)
    assert disagreement.max() < 1e-6


def test_the_default_pair_reaches_beyond_ten_metres() -> None:
    assert DUAL.frequencies_hz == (20.013e6, 30e6)
    assert DUAL.unambiguous_range_m == pytest.approx(14.98, abs=0.001)


@settings(deadline=None)  # the first call compiles
@given(truth_m=st.floats(15.1, 20.0))
def test_beyond_the_unambiguous_range_distances_wrap(truth_m: float) -> None:
    distance_m, disagreement = unwrap(*wrapped(truth_m, DUAL), DUAL)
    assert float(distance_m) == pytest.approx(truth_m - DUAL.unambiguous_range_m, abs=0.01)
    assert float(disagreement) < 0.01, "nothing gives it away: the light falls off, and that is all"


def test_noise_where_both_frequencies_begin_a_turn_gives_no_negative_distance() -> None:
    rng = np.random.default_rng(2)
    truth_m = DUAL.unambiguous_range_m + rng.uniform(-0.1, 0.1, 2000)
    noisy_m = truth_m + rng.normal(0.0, 0.1, (2, truth_m.size))
    distance_m, _ = unwrap(*(wrapped(each, DUAL)[index] for index, each in enumerate(noisy_m)), DUAL)
    assert ((distance_m >= 0.0) & (distance_m < DUAL.unambiguous_range_m)).all()


def shares(signal_e: float, background_e: float) -> tuple[float, float, float]:
    """Return how many distances are right, how many are kept, and how many of these are right."""
    rng = np.random.default_rng(4)
    truth_m = rng.uniform(1.0, 10.0, 40_000)
    sigma_e = np.sqrt(signal_e + background_e + DUAL.pixel.read_noise_e**2)
    measured_m = []
    for frequency_hz in DUAL.frequencies_hz:
        x = 4 * np.pi * frequency_hz * truth_m[:, None] / constants.c - THETA
        wave = np.cos(x) + DUAL.pixel.wiggling_share * np.cos(3 * x)
        samples = DUAL.pixel.contrast * signal_e * wave + sigma_e * rng.standard_normal(x.shape)
        measured_m.append(distance(phase(samples), frequency_hz))
    distance_m, disagreement = unwrap(*measured_m, DUAL)
    right = np.abs(distance_m - truth_m) < 1.2
    kept = disagreement < DUAL.reconstruction.wrap_limit
    return right.mean(), kept.mean(), right[kept].mean()


def test_a_bright_surface_is_unwrapped_in_darkness_and_in_sun() -> None:
    for background_e in (0.0, 2e6):
        assert shares(25_000, background_e) == (1.0, 1.0, 1.0)


def test_a_dim_surface_is_unwrapped_and_in_sun_what_is_doubtful_is_left_out() -> None:
    assert shares(5_000, 0.0) == (1.0, 1.0, 1.0)
    right, kept, right_of_kept = shares(5_000, 2e6)
    assert right > 0.995
    assert kept > 0.96
    assert right_of_kept > 0.999


def test_distances_that_fit_no_turns_disagree() -> None:
    first_m, second_m = wrapped(3.0, DUAL)
    _, disagreement = unwrap(first_m, second_m + 1.2, DUAL)
    assert float(disagreement) == pytest.approx(1.2 / 1.247, abs=0.01)
