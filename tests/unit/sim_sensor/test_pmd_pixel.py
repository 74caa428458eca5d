"""The taps: conversion, suppression, full well and noise."""

import numpy as np
import pytest

from rpod_schemas.config.pmd import PmdConfig
from rpod_sim_sensor.pmd.pixel import Electronics, Light, Noise, convert

CHIP = Electronics.of(PmdConfig())
NO_SUPPRESSION = CHIP._replace(suppression_e=0.0)


def counts(
    modulated_e: float,
    charge_e: float,
    chip: Electronics = CHIP,
    noise: float = 0.0,
    time_share: float = 1.0,
) -> tuple[np.ndarray, bool]:
    """One pixel's samples without their offset; the modulated light falls into Q1 and Q2."""
    modulated = np.array([modulated_e, -modulated_e, 0.0, 0.0], np.float32)[:, None, None]
    light = Light(modulated, np.array([[charge_e]], np.float32), np.zeros(5), time_share)
    samples, full = np.empty((1, 1, 1, 4), np.uint16), np.empty((1, 1), np.bool_)
    pool = Noise(np.full(4, noise, np.float32), np.zeros(1, np.int64))
    convert(light, pool, chip, samples=samples, full=full)
    return samples[0, 0, 0].astype(int) - 32768, bool(full[0, 0])


def test_the_difference_of_the_taps_is_the_modulated_light_times_the_contrast() -> None:
    samples, full = counts(100e3, 100e3)
    assert samples.tolist() == [round(0.75 * 100e3 / 40), -round(0.75 * 100e3 / 40), 0, 0]
    assert not full


def test_suppression_takes_the_background_off_and_leaves_the_signal() -> None:
    in_sun, full = counts(20e3, 20e3 + 2e6)
    assert in_sun.tolist() == counts(20e3, 20e3)[0].tolist()
    assert not full


def test_without_suppression_the_same_background_destroys_the_signal() -> None:
    samples, full = counts(20e3, 20e3 + 2e6, NO_SUPPRESSION)
    assert samples.tolist() == [0, 0, 0, 0]
    assert full


def test_a_background_beyond_suppression_and_full_well_destroys_the_signal() -> None:
    enough_e = 2 * (CHIP.suppression_e + CHIP.full_well_e)
    assert counts(20e3, 1.1 * enough_e) == (pytest.approx(np.zeros(4)), True)
    assert counts(20e3, 0.9 * enough_e)[0][0] == 375


def test_a_tap_that_is_clipped_alone_shrinks_the_signal_and_says_so() -> None:
    clean, _ = counts(40e3, 280e3, CHIP)
    clipped, full = counts(40e3, 280e3, NO_SUPPRESSION)
    assert 0 < clipped[0] < clean[0]
    assert clipped[1] == -clipped[0]
    assert full


def test_a_strong_signal_is_clipped_at_the_full_well() -> None:
    samples, full = counts(1e6, 1e6)
    assert samples.tolist() == [3750, -3750, 0, 0]
    assert full


@pytest.mark.parametrize("charge_e", [0.0, 5e3, 2e6])
def test_noise_is_shot_noise_of_all_charge_and_read_noise(charge_e: float) -> None:
    sigma_e = np.sqrt(charge_e + 60.0**2)
    samples, _ = counts(0.0, charge_e, CHIP._replace(electrons_per_count=10.0), noise=1.0)
    assert samples.tolist() == [round(sigma_e / 10)] * 4


def test_a_shorter_exposure_collects_less_of_everything() -> None:
    assert counts(100e3, 100e3, time_share=0.5)[0].tolist() == counts(50e3, 50e3)[0].tolist()
    beyond_e = 2.2 * (CHIP.suppression_e + CHIP.full_well_e)
    assert counts(0.0, beyond_e)[1]
    assert counts(0.0, beyond_e, time_share=0.5)[1], "the suppression has less time too"
    assert not counts(0.0, beyond_e, time_share=0.05)[1]
