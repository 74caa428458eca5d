"""Whole scans: what comes back, with which errors, and that the same seed gives the same scan."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_schemas.config.lidar import LidarConfig, LidarDetectionConfig, LidarNoiseConfig
from rpod_schemas.poses import make_pose
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.lidar.noise import noisy_directions
from rpod_target import load_target

bulky = cache(lambda: load_target("envisat-bulky"))
EXACT = LidarNoiseConfig(sigma_range_m=0, sigma_pointing_rad=0, outlier_share=0)
AWAY = make_pose(translation_m=(0, 0, 20))


@cache
def wall():
    """A plate of 40 x 40 m that fills the field of view from 20 m, of the first material (steel)."""
    corners = 20.0 * np.array([[-1, -1, 0], [-1, 1, 0], [1, 1, 0], [1, -1, 0]])
    return replace(
        bulky(),
        triangles_m=corners[[[0, 1, 2], [0, 2, 3]]],
        normals=np.array([[0.0, 0.0, -1.0]] * 2),
        triangle_material=np.zeros(2, np.int32),
        triangle_part=np.zeros(2, np.int32),
    )


def errors_m(noise, frames=5):
    """Errors along the rays of scans of the wall."""
    config = LidarConfig(noise=noise)
    emulator = LidarEmulator(config, wall(), seed=3)
    true_m = np.linalg.norm(
        LidarEmulator(LidarConfig(noise=EXACT), wall(), seed=3).scan([AWAY], frame=0).points_m, axis=-1
    )
    scans = [emulator.scan([AWAY], frame=frame).points_m for frame in range(frames)]
    return np.ravel([np.linalg.norm(points_m, axis=-1) - true_m for points_m in scans])


def mean_returns(target, range_m, **detection):
    """Over Euler angles drawn evenly, as in the paper's second scenario."""
    random = np.random.default_rng(5)
    emulator = LidarEmulator(LidarConfig(detection=LidarDetectionConfig(**detection)), target, seed=1)
    counts = []
    for frame in range(300):
        angles_deg = random.uniform((-180, -90, -180), (180, 90, 180))
        rotation = Rotation.from_euler("ZYX", angles_deg, degrees=True)
        scan = emulator.scan([make_pose(rotation=rotation, translation_m=(0, 0, range_m))], frame=frame)
        counts.append(np.isfinite(scan.points_m[..., 0]).sum())
    return np.mean(counts)


def test_without_noise_the_points_lie_on_the_surface_in_the_rays_directions():
    config = LidarConfig(noise=EXACT)
    scan = LidarEmulator(config, wall(), seed=0).scan([AWAY], frame=0)
    assert scan.points_m.shape == (41, 41, 3)
    assert scan.points_m[..., 2] == pytest.approx(20.0, abs=1e-5)
    azimuth_rad = np.arctan2(scan.points_m[..., 0], scan.points_m[..., 2])
    assert azimuth_rad == pytest.approx(np.tile(config.azimuth_rad, (41, 1)), abs=1e-6)


def test_the_intensity_is_the_mean_signal_of_equation_5():
    scan = LidarEmulator(LidarConfig(noise=EXACT), wall(), seed=0).scan([AWAY], frame=0)
    assert scan.intensity[20, 20] == pytest.approx(3.42e7 * 0.733 / 20.0**2, rel=1e-3)
    assert scan.intensity[20, 0] == pytest.approx(
        scan.intensity[20, 20] * np.cos(np.deg2rad(20)) ** 3, rel=1e-3
    )


def test_the_papers_mean_reflectivity_replaces_the_materials():
    config = LidarConfig(noise=EXACT, detection=LidarDetectionConfig(reflectivity="mean"))
    scan = LidarEmulator(config, wall(), seed=0).scan([AWAY], frame=0)
    assert scan.intensity[20, 20] == pytest.approx(3.42e7 * 0.6 / 20.0**2, rel=1e-3)


def test_nothing_in_sight_gives_no_returns():
    scan = LidarEmulator(LidarConfig(), bulky(), seed=0).scan([make_pose(translation_m=(0, 0, -50))], frame=0)
    assert np.isnan(scan.points_m).all()
    assert not scan.intensity.any()


def test_the_same_seed_and_frame_give_the_same_scan_and_others_do_not():
    def points_m(seed=1, frame=4, name="lidar"):
        return LidarEmulator(LidarConfig(name=name), bulky(), seed=seed).scan([AWAY], frame=frame).points_m

    assert np.array_equal(points_m(), points_m(), equal_nan=True)
    for other in (points_m(seed=2), points_m(frame=5), points_m(name="lidar2")):
        assert not np.array_equal(points_m(), other, equal_nan=True)


def test_ranges_have_white_noise_of_25_mm():
    errors = errors_m(LidarNoiseConfig(outlier_share=0))
    assert errors.std() == pytest.approx(0.025, rel=0.03)
    assert abs(errors.mean()) < 4 * 0.025 / np.sqrt(errors.size)


def test_six_per_cent_of_the_points_have_four_times_the_noise():
    errors = errors_m(LidarNoiseConfig())
    assert (errors**2).mean() == pytest.approx(0.025**2 * (0.94 + 0.06 * 16), rel=0.06)
    assert np.mean(np.abs(errors) > 4 * 0.025) == pytest.approx(0.06 * 0.317, rel=0.25)


def test_gross_outliers_are_spread_over_metres_by_their_share():
    errors = errors_m(LidarNoiseConfig(gross_outlier_share=0.1, gross_outlier_m=5.0))
    assert np.mean(np.abs(errors) > 0.5) == pytest.approx(0.1 * 0.9, rel=0.1)
    assert np.abs(errors).max() <= 5.0 + 1e-5


def test_rays_err_by_a_normal_angle_evenly_all_around():
    directions = np.tile(np.array([0.1, -0.2, 1.0]) / np.sqrt(1.05), (20_000, 1))
    noisy = noisy_directions(directions, 1e-3, np.random.default_rng(0))
    offset = noisy - directions
    assert np.linalg.norm(noisy, axis=1) == pytest.approx(1.0)
    assert np.sqrt((offset**2).sum(axis=1).mean()) == pytest.approx(1e-3, rel=0.02)
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(offset.T)))
    assert spread[1:] == pytest.approx(1e-3 / np.sqrt(2), rel=0.03)
    assert spread[0] < 1e-5


def test_a_skewed_scan_sees_each_row_at_its_own_time():
    config = LidarConfig(noise=EXACT, motion="skewed")
    speed_m_s = 3.0
    times_s = config.pose_times_s()
    poses = [make_pose(translation_m=(0, 0, 20 + speed_m_s * time_s)) for time_s in times_s]
    scan = LidarEmulator(config, wall(), seed=0).scan(poses, frame=0)
    depths_m = scan.points_m[..., 2].mean(axis=1)
    assert depths_m == pytest.approx(20 + speed_m_s * np.array(times_s), abs=1e-5)
    assert scan.time_s.mean(axis=1) == pytest.approx(times_s, abs=1e-7)


def test_a_skewed_scan_of_a_target_at_rest_is_an_instantaneous_one():
    skewed = LidarEmulator(LidarConfig(motion="skewed"), bulky(), seed=9)
    at_once = LidarEmulator(LidarConfig(), bulky(), seed=9).scan([AWAY], frame=1)
    assert np.array_equal(skewed.scan([AWAY] * 41, frame=1).points_m, at_once.points_m, equal_nan=True)


def test_mean_returns_of_bulky_envisat_are_those_measured_before():
    assert mean_returns(bulky(), 20.0) == pytest.approx(490, rel=0.04)
    usual, printed = mean_returns(bulky(), 50.0), mean_returns(bulky(), 50.0, threshold="printed")
    assert 86 < printed < usual < 120


def test_without_the_detection_model_every_ray_that_meets_the_target_comes_back():
    far = make_pose(translation_m=(0, 0, 200))
    config = LidarConfig(detection=LidarDetectionConfig(returned="all"))
    everything = LidarEmulator(config, bulky(), seed=3).scan([far], frame=0)
    detected = LidarEmulator(LidarConfig(), bulky(), seed=3).scan([far], frame=0)
    returned, seen = (np.isfinite(scan.points_m[..., 2]) for scan in (everything, detected))
    assert 0 < np.count_nonzero(seen) < np.count_nonzero(returned) < returned.size
    assert not (seen & ~returned).any()
