"""The detection equations against figures worked out by hand from Table 1 of the 2015 paper."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rpod_schemas.config.lidar import LidarConfig, LidarDetectionConfig
from rpod_sim_sensor.lidar.detection import (
    background_electrons,
    background_power_W,
    detection_probability,
    echo,
    echo_power_W,
    electrons,
    signal_to_noise,
    thermal_variance,
)

CONFIG = LidarConfig()
LASER, RECEIVER = CONFIG.transmitter, CONFIG.receiver


def snr(range_m, reflectivity=0.6, cos_incidence=1.0, **options):
    one = np.ones(1)
    power_W = echo_power_W(reflectivity * one, cos_incidence * one, range_m * one, LASER, RECEIVER)
    signal_e = electrons(power_W, LASER, RECEIVER)
    background_e = background_electrons(reflectivity * one, LASER, RECEIVER)
    return signal_to_noise(signal_e, background_e, LidarDetectionConfig(**options), RECEIVER).item()


def test_the_echo_of_a_white_plate_at_one_metre_is_six_milliwatts():
    # Peak power 1 mW / (10 kHz 1 ns) = 100 W; (0.025 m)^2 / 4; 0.3898.
    one = np.ones(1)
    assert echo_power_W(one, one, one, LASER, RECEIVER).item() == pytest.approx(6.0906e-3, rel=1e-4)


def test_the_echo_falls_with_the_square_of_the_range_and_the_cosine_of_incidence():
    assert snr(20.0) / snr(40.0) == pytest.approx(4.0, rel=1e-4)
    assert snr(20.0) / snr(20.0, cos_incidence=0.5) == pytest.approx(2.0, rel=1e-4)


def test_noise_electrons_are_those_of_table_1():
    reflectivity = np.array([0.6])
    background_e = background_electrons(reflectivity, LASER, RECEIVER)
    dark_e = 150e-9 * 1e-9 / 1.602176634e-19
    assert thermal_variance(RECEIVER) == pytest.approx(2.204e5, rel=1e-3)
    assert dark_e == pytest.approx(936.2, abs=0.1)
    assert background_e.item() - dark_e == pytest.approx(0.127, abs=0.002)
    assert background_power_W(reflectivity, LASER, RECEIVER).item() == pytest.approx(5.81e-11, rel=1e-2)


@pytest.mark.parametrize(("range_m", "expected"), [(20.0, 1071.0), (50.0, 171.0)])
def test_signal_to_noise_at_normal_incidence(range_m, expected):
    assert snr(range_m) == pytest.approx(expected, abs=0.5)  # quoted as whole numbers


def test_the_avalanches_own_noise_lowers_the_constant():
    def constant(**options):
        return snr(1.0, reflectivity=1.0, **options)

    squared = {"gain_on_variance": "squared"}
    assert constant() == pytest.approx(7.14e5, rel=2e-3)
    assert constant(**squared) == pytest.approx(6.1e5, rel=2e-3)
    assert constant(**squared, excess_noise_factor=3.0) == pytest.approx(4.83e5, rel=2e-3)


def test_shot_noise_of_the_signal_dominates_where_it_is_counted():
    options = {"shot_noise": True, "gain_on_variance": "squared", "excess_noise_factor": 3.0}
    assert snr(50.0, **options) == pytest.approx(47.7, abs=0.1)


@pytest.mark.parametrize(("threshold", "incidence_deg"), [("printed", 65.5), ("usual", 80.0)])
def test_the_array_at_50_m_is_lost_beyond_an_incidence(threshold, incidence_deg):
    cosine = np.cos(np.deg2rad(incidence_deg))
    edge = detection_probability(np.array([snr(50.0, 0.175, cosine)]), 1e-4, threshold).item()
    assert edge == pytest.approx(0.5, abs=0.02)


def test_without_a_signal_the_printed_threshold_falls_below_the_false_alarm_rate():
    dark = np.zeros(1)
    assert detection_probability(dark, 1e-4, "printed").item() == pytest.approx(1.8e-8, rel=0.05)
    assert 1e-4 < detection_probability(dark, 1e-4, "usual").item() < 1e-3


@settings(deadline=None)
@given(st.floats(0.0, 1e4), st.floats(0.0, 1e4), st.sampled_from(("usual", "printed")))
def test_detection_never_falls_with_a_better_signal(one, other, threshold):
    low, high = sorted((one, other))
    worse, better = detection_probability(np.array([low, high]), 1e-4, threshold)
    assert 0.0 <= worse <= better <= 1.0


def test_an_echo_is_the_chain_of_the_equations():
    inputs = {"reflectivity": 0.6, "cos_incidence": 1.0, "range_m": 50.0}
    signal_e, probability = echo(CONFIG, **{name: np.array([value]) for name, value in inputs.items()})
    assert signal_e.item() == pytest.approx(8208, rel=1e-3)
    assert probability.item() == pytest.approx(1.0)
