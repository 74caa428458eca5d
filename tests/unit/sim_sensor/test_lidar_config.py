import numpy as np
import pytest
from pydantic import ValidationError

from rpod_schemas.config.lidar import LidarConfig, LidarDetectionConfig, ScanPatternConfig

SKEWED = LidarConfig(motion="skewed")


def test_the_defaults_scan_41_by_41_rays_at_one_degree():
    config = LidarConfig()
    for angles_rad in (config.azimuth_rad, config.elevation_rad):
        assert np.rad2deg(angles_rad) == pytest.approx(np.arange(-20, 21))


def test_the_pulse_rate_gives_the_scan_time_and_the_latency():
    config = LidarConfig(readout_s=0.02)
    assert config.scan_time_s == pytest.approx(0.1681)
    assert config.latency_s == pytest.approx(0.1681 / 2 + 0.02)


def test_an_instantaneous_scan_needs_one_pose():
    assert LidarConfig().pose_times_s() == (0.0,)
    assert not LidarConfig().ray_times_s().any()


def test_a_skewed_scan_needs_a_pose_for_each_row_evenly_around_the_stamp():
    times_s = np.array(SKEWED.pose_times_s())
    assert times_s == pytest.approx(-times_s[::-1])
    assert np.diff(times_s) == pytest.approx(41 / 10e3)


def test_rays_follow_each_other_by_the_pulse_rate_row_after_row():
    times_s = SKEWED.ray_times_s()
    assert times_s.shape == (41, 41)
    assert np.diff(times_s.ravel()) == pytest.approx(1e-4)
    assert times_s.mean() == pytest.approx(0.0)


def test_the_info_tells_the_pattern_and_the_range_noise():
    info = SKEWED.info()
    assert np.array_equal(info.azimuth_rad, SKEWED.azimuth_rad)
    assert (info.scan_time_s, info.sigma_range_m) == (SKEWED.scan_time_s, 0.025)
    assert LidarConfig().info().scan_time_s == 0.0


@pytest.mark.parametrize(
    ("build", "reason"),
    [
        (lambda: ScanPatternConfig(step_deg=0.7), "whole number of steps"),
        (lambda: ScanPatternConfig(step_deg=5e-324), "is inf times step_deg, needs to be a whole number"),
        (lambda: LidarConfig(rate_hz=6.0), "a scan takes 0.168 s"),
        (lambda: LidarDetectionConfig(excess_noise_factor=3.0), "only with gain_on_variance: squared"),
        (lambda: LidarConfig(wavelength_m=1e-6), "Extra inputs"),
    ],
)
def test_what_cannot_be_is_rejected_with_a_reason(build, reason):
    with pytest.raises(ValidationError, match=reason):
        build()
