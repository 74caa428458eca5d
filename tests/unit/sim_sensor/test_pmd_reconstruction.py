"""Eqs. 1 to 3, and which pixels keep their depth."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import constants

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import MODULATION_FREQUENCIES_HZ, PmdConfig
from rpod_sim_sensor.pmd import Lost, amplitude, distance, phase, reconstruct
from rpod_sim_sensor.pmd.reconstruction import phase_turns

THETA = np.array([0.0, math.pi, math.pi / 2, 3 * math.pi / 2])
CONFIG = PmdConfig()
LEAST = CONFIG.reconstruction.least_amplitude_e / CONFIG.pixel.electrons_per_count


def samples_of(
    distance_m: FloatArray | float, strength: FloatArray | float, frequency_hz: float
) -> FloatArray:
    phi = 4 * math.pi * frequency_hz * np.asarray(distance_m) / constants.c
    return np.asarray(strength)[..., None] * np.cos(phi[..., None] - THETA)


def frame(distance_m: float, strength: float, changed: dict[int, float] | None = None) -> np.ndarray:
    """One pixel's samples as a camera sends them, some changed by an offset in counts."""
    counts = samples_of(distance_m, strength, CONFIG.modulation_frequency_hz)
    for index, offset in (changed or {}).items():
        counts[index] += offset
    return np.rint(counts + 32768).astype(np.uint16)[None, None]


def reconstructed(samples: np.ndarray, full: bool = False) -> tuple[float, int]:
    depth_m, strength, _ = reconstruct(
        samples, CONFIG, cosine=np.full((1, 1), 0.9), full=np.full((1, 1), True) if full else None
    )
    assert depth_m.dtype == np.float32
    assert strength.dtype == np.uint16
    return float(depth_m[0, 0]), int(strength[0, 0])


@given(
    share=st.floats(0.0, 1.0, exclude_max=True),
    strength=st.floats(1.0, 1e6),
    frequency_hz=st.sampled_from(MODULATION_FREQUENCIES_HZ),
)
def test_distance_and_amplitude_come_back_from_their_samples(
    share: float, strength: float, frequency_hz: float
) -> None:
    unambiguous_m = constants.c / (2 * frequency_hz)
    samples = samples_of(share * unambiguous_m, strength, frequency_hz)
    measured_m = float(distance(phase(samples), frequency_hz))
    off = abs(measured_m - share * unambiguous_m)
    assert min(off, unambiguous_m - off) < 1e-9  # 0 and c/2f are the same distance
    assert float(amplitude(samples)) == pytest.approx(strength)


def test_beyond_the_unambiguous_range_distances_wrap() -> None:
    f = CONFIG.modulation_frequency_hz
    measured_m = distance(phase(samples_of(9.0, 100.0, f)), f)
    assert measured_m == pytest.approx(9.0 - CONFIG.unambiguous_range_m)


@pytest.mark.parametrize("strength", [1e-3, 1.0, 1e5])
def test_the_phase_that_an_image_is_made_with_is_eq_1(strength: float) -> None:
    angle = np.linspace(0.0, 2 * math.pi, 20_001)
    samples = strength * np.cos(angle[:, None] - THETA)
    turns = np.array([phase_turns(*sample) for sample in samples])
    error = (turns - phase(samples) / (2 * math.pi) + 0.5) % 1.0 - 0.5
    assert np.abs(error).max() < 2e-8
    assert phase_turns(0.0, 0.0, 0.0, 0.0) == 0.0


def test_a_plain_arctangent_would_be_right_for_a_seventh_of_the_ranges() -> None:
    f = CONFIG.modulation_frequency_hz
    distance_m = np.linspace(1.0, 7.4, 1000)
    q1, q2, q3, q4 = samples_of(distance_m, 1.0, f).T
    plain_m = np.arctan((q3 - q4) / (q1 - q2)) * constants.c / (4 * math.pi * f)
    assert np.isclose(plain_m, distance_m).mean() == pytest.approx(0.14, abs=0.01)
    np.testing.assert_allclose(distance(phase(samples_of(distance_m, 1.0, f)), f), distance_m)


def test_samples_as_they_are_sent_give_what_signed_ones_give() -> None:
    sent = frame(5.0, 400.0)
    signed = sent.astype(float) - 32768
    np.testing.assert_allclose(phase(sent), phase(signed), rtol=1e-6)
    np.testing.assert_allclose(amplitude(sent), amplitude(signed), rtol=1e-6)


def test_a_third_harmonic_biases_distances_by_its_share_of_a_radian() -> None:
    f, h3 = CONFIG.modulation_frequency_hz, 0.03
    distance_m = np.linspace(1.0, 7.0, 500)
    phi = 4 * math.pi * f * distance_m / constants.c
    samples = np.cos(phi[:, None] - THETA) + h3 * np.cos(3 * (phi[:, None] - THETA))
    bias_m = distance(phase(samples), f) - distance_m
    assert np.abs(bias_m).max() == pytest.approx(h3 * constants.c / (4 * math.pi * f), rel=0.01)
    assert np.abs(bias_m).max() == pytest.approx(0.036, abs=0.0005)


def test_depth_is_the_distance_along_the_boresight() -> None:
    depth_m, strength = reconstructed(frame(5.0, 1000.0))
    assert depth_m == pytest.approx(0.9 * 5.0, abs=2e-3)
    assert strength == 1000


def test_a_weak_pixel_loses_its_depth_and_keeps_its_amplitude() -> None:
    assert math.isnan(reconstructed(frame(5.0, LEAST - 1))[0])
    assert reconstructed(frame(5.0, LEAST - 1))[1] == pytest.approx(LEAST - 1, abs=0.6)
    assert math.isfinite(reconstructed(frame(5.0, LEAST + 1))[0])


def test_a_sample_at_the_full_well_loses_the_depth_and_keeps_the_amplitude() -> None:
    full_m = CONFIG.unambiguous_range_m / 4  # all in Q3 and Q4
    depth_m, strength = reconstructed(frame(full_m, CONFIG.pixel.saturation_count))
    assert math.isnan(depth_m)
    assert strength == CONFIG.pixel.saturation_count
    assert math.isfinite(reconstructed(frame(full_m, CONFIG.pixel.saturation_count - 1))[0])


@pytest.mark.parametrize("index", range(4))
def test_samples_that_contradict_each_other_lose_the_depth(index: int) -> None:
    allowed = 2 * CONFIG.reconstruction.asymmetry_limit * 1000
    assert math.isfinite(reconstructed(frame(5.0, 1000.0, {index: 0.8 * allowed}))[0])
    depth_m, strength = reconstructed(frame(5.0, 1000.0, {index: 1.5 * allowed}))
    assert math.isnan(depth_m)
    assert strength > 500


def test_a_pixel_that_the_camera_flags_as_full_loses_its_depth() -> None:
    depth_m, strength = reconstructed(frame(5.0, 1000.0), full=True)
    assert math.isnan(depth_m)
    assert strength == 1000


def lost(samples: np.ndarray, full: bool = False) -> Lost:
    flags = np.full((1, 1), full)
    return Lost(int(reconstruct(samples, CONFIG, cosine=np.ones((1, 1)), full=flags).lost[0, 0]))


def test_a_pixel_says_why_it_has_no_depth() -> None:
    assert lost(frame(5.0, 1000.0)) == Lost(0)
    assert lost(frame(5.0, 10.0)) == Lost.TOO_DARK
    assert lost(frame(5.0, 1000.0), full=True) == Lost.SATURATED
    assert lost(frame(5.0, 1000.0, {1: 900.0})) == Lost.INCONSISTENT
    assert lost(frame(5.0, 10.0, {1: 9.0})) == Lost.TOO_DARK | Lost.INCONSISTENT


DUAL = PmdConfig(profile="dual")


def dual_frame(first_m: float, second_m: float, strengths: tuple[float, float]) -> np.ndarray:
    counts = [
        samples_of(distance_m, strength, frequency_hz)
        for distance_m, strength, frequency_hz in zip(
            (first_m, second_m), strengths, DUAL.frequencies_hz, strict=True
        )
    ]
    return np.rint(np.stack(counts) + 32768).astype(np.uint16)[:, None, None]


def test_two_frequencies_measure_beyond_what_either_can() -> None:
    samples = dual_frame(11.0, 11.0, (900.0, 1100.0))
    depth_m, strength, flags = reconstruct(samples, DUAL, cosine=np.full((1, 1), 0.9))
    assert depth_m[0, 0] == pytest.approx(0.9 * 11.0, abs=2e-3)
    assert strength[0, 0] == 1000
    assert flags[0, 0] == 0


@pytest.mark.parametrize(
    ("samples", "reason"),
    [
        (dual_frame(5.0, 5.0, (1000.0, 10.0)), Lost.TOO_DARK),
        (dual_frame(5.0, 5.0, (10.0, 1000.0)), Lost.TOO_DARK),
        (dual_frame(5.0, 6.0, (1000.0, 1000.0)), Lost.INCONSISTENT),
    ],
)
def test_both_frequencies_must_be_good_and_agree(samples: np.ndarray, reason: Lost) -> None:
    depth_m, strength, flags = reconstruct(samples, DUAL, cosine=np.ones((1, 1)))
    assert math.isnan(depth_m[0, 0])
    assert strength[0, 0] > 500
    assert flags[0, 0] == reason
