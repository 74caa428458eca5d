"""The PMD camera's configuration: Table 1, timing, and what is refused."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from rpod_schemas.config.pmd import MODULATION_FREQUENCIES_HZ, PmdConfig


def test_the_default_camera_has_the_papers_field_of_view() -> None:
    camera = PmdConfig().camera
    assert (camera.width, camera.height) == (352, 287)
    assert 2 * math.degrees(math.atan(camera.width / 2 / camera.fx)) == pytest.approx(28.91, abs=0.01)
    assert 2 * math.degrees(math.atan(camera.height / 2 / camera.fy)) == pytest.approx(23.45, abs=0.01)


def test_the_default_frequency_is_unambiguous_to_seven_and_a_half_metres() -> None:
    assert PmdConfig().unambiguous_range_m == pytest.approx(7.49, abs=0.001)


def test_the_papers_profile_integrates_for_24_ms_at_40_hz() -> None:
    config = PmdConfig(profile="paper", rate_hz=40.0)
    assert config.integration_time_s == pytest.approx(0.024)
    assert config.latency_s == pytest.approx(0.025 / 2 + 0.00025 / 2)


@pytest.mark.parametrize("profile", ["fast", "paper", "dual"])
def test_sub_exposures_lie_evenly_about_the_stamp(profile: str) -> None:
    config = PmdConfig.model_validate({"profile": profile})
    times_s = np.array(config.pose_times_s())
    np.testing.assert_allclose(times_s, -times_s[::-1])
    np.testing.assert_allclose(np.diff(times_s), config.sub_exposure_s + config.readout_s)
    assert config.latency_s == pytest.approx(times_s[-1] + config.sub_exposure_s / 2 + config.readout_s)


def test_the_figures_of_the_radiometry_follow_by_hand() -> None:
    config = PmdConfig()
    solid_angle_sr = 4 * math.asin(math.sin(math.radians(28.91 / 2)) * math.sin(math.radians(23.45 / 2)))
    assert config.lamp_irradiance_W_m2 == pytest.approx(3.0 / solid_angle_sr, rel=1e-3)
    photon_J = 6.626e-34 * 2.998e8 / 850e-9
    electrons = math.pi / (4 * 1.8**2) * 0.8 * (17.5e-6) ** 2 * 0.45 / photon_J * 0.004
    assert config.electrons_per_radiance == pytest.approx(electrons, rel=1e-3)


def test_the_bus_learns_what_the_samples_mean() -> None:
    info = PmdConfig().info()
    assert info.modulation_frequency_hz.tolist() == [20.013e6]
    assert info.saturation_count * info.electrons_per_count == 150e3


def test_the_dual_profile_has_two_frequencies_and_eight_sub_exposures_at_30_hz() -> None:
    config = PmdConfig(profile="dual", rate_hz=30.0)
    assert len(config.pose_times_s()) == config.sub_exposures == 8
    assert config.integration_time_s == pytest.approx(0.024)
    assert config.info().modulation_frequency_hz.tolist() == [20.013e6, 30e6]
    swapped = PmdConfig(profile="dual", dual_frequencies_hz=(30e6, 20.013e6))
    assert swapped.info().modulation_frequency_hz.tolist() == [30e6, 20.013e6]


def test_the_info_tells_the_time_of_an_automatic_exposure() -> None:
    config = PmdConfig()
    assert config.info().integration_time_s == config.integration_time_s
    assert config.info(integration_time_s=1e-3).integration_time_s == 1e-3


@pytest.mark.parametrize("frequency_hz", MODULATION_FREQUENCIES_HZ)
def test_every_frequency_of_the_camera_is_taken(frequency_hz: float) -> None:
    assert PmdConfig(modulation_frequency_hz=frequency_hz).modulation_frequency_hz == frequency_hz


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ({"rate_hz": 46}, "rate_hz is 46, the profile 'fast' allows 45 at most"),
        ({"profile": "paper", "rate_hz": 41}, "rate_hz is 41, the profile 'paper' allows 40 at most"),
        ({"modulation_frequency_hz": 21e6}, "modulation_frequency_hz is 2.1e.07, needs one of 5.004e"),
        ({"profile": "dual", "rate_hz": 39}, "rate_hz is 39, the profile 'dual' allows 38.4615 at most"),
        ({"dual_frequencies_hz": (30e6, 30e6)}, "needs two different of"),
        ({"dual_frequencies_hz": (20e6, 30e6)}, r"dual_frequencies_hz is \(2e\+07, 3e\+07\), needs two"),
        ({"pixel": {"electrons_per_count": 1}}, "samples have 16 bits"),
        (
            {"camera": {"width": 4, "height": 4, "fx": 4, "fy": 4, "cx": 2, "cy": 2, "distortion": [0.1]}},
            "camera.distortion needs five numbers",
        ),
    ],
)
def test_what_no_camera_can_do_is_refused_in_a_sentence(document: dict, sentence: str) -> None:
    with pytest.raises(ValidationError, match=sentence):
        PmdConfig.model_validate(document)


def test_a_configuration_survives_its_own_json() -> None:
    config = PmdConfig(name="tof", rate_hz=45, profile="fast")
    again = PmdConfig.model_validate_json(config.model_dump_json())
    assert again.model_dump_json() == config.model_dump_json()
