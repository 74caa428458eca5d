import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_pose.lidar.paper_2015.icp_nearest_neighbour import NearestNeighbourIcp
from rpod_pose.lidar.paper_2015.scan_check import ScanComparison
from rpod_pose.lidar.paper_2015.scan_lengths import ScanLengths, agreeing_m
from rpod_pose.lidar.scan_pattern import UNKNOWN_SIGMA_M, ScanPattern
from rpod_schemas.config.lidar import LidarConfig, LidarNoiseConfig
from rpod_schemas.config.lidar.methods import IcpNearestNeighbourConfig, ScanComparisonConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import LidarScan, Source
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import load_target

LIDAR = LidarConfig()
PATTERN = ScanPattern.of(LIDAR.info())
load = cache(load_target)
BULKY = "envisat-bulky"
MATCHERS = ["nearest_neighbour", "normal_shooting"]
METRICS = ["point_to_point", "point_to_plane"]
HALF_TURN = make_pose(rotation=Rotation.from_rotvec([np.pi, 0.0, 0.0]))


@cache
def icp(target=BULKY, **options):
    return NearestNeighbourIcp(IcpNearestNeighbourConfig(**options), load(target), PATTERN)


def scan_of(points_m):
    return LidarScan(stamp_ns=0, frame_id="lidar", points_m=np.asarray(points_m, np.float32))


def scan_at(T_lidar_target, frame=0, target=BULKY, **noise):
    config = LidarConfig(noise=LidarNoiseConfig(**noise))
    return scan_of(LidarEmulator(config, load(target), seed=4).scan([T_lidar_target], frame=frame).points_m)


def pose_and_guess(seed, range_m=20.0, angle_deg=5.0, offset_m=0.3):
    random = np.random.default_rng(seed)
    T = make_pose(rotation=Rotation.random(rng=random), translation_m=(0.0, 0.0, range_m))
    axis, way = random.normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * axis / np.linalg.norm(axis))
    return T, T * make_pose(rotation=turn, translation_m=offset_m * way / np.linalg.norm(way))


def errors(T_truth, registration):
    attitude_rad, position_m = pose_error(T_truth, registration.T_sensor_target)
    return np.rad2deg(np.linalg.norm(attitude_rad)), np.linalg.norm(position_m)


@pytest.mark.parametrize("target", [BULKY, "envisat-mesh"])
@pytest.mark.parametrize("range_m", [20.0, 50.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_scan_is_registered_from_five_degrees_and_thirty_centimetres(target, range_m, seed):
    T, guess = pose_and_guess(seed, range_m)
    registration = icp(target).track(scan_at(T, target=target), guess)
    attitude_deg, position_m = errors(T, registration)
    assert attitude_deg < 0.6
    assert position_m < 0.15
    assert registration.source == Source.LIDAR
    assert registration.cost_m2 < 0.003
    assert registration.explained_share >= 0.97


@pytest.mark.parametrize("matcher", MATCHERS)
@pytest.mark.parametrize("metric", METRICS)
def test_without_noise_every_matcher_and_metric_ends_at_the_truth(matcher, metric):
    T, guess = pose_and_guess(7, angle_deg=2.0, offset_m=0.1)
    scan = scan_at(T, sigma_range_m=0.0, sigma_pointing_rad=0.0, outlier_share=0.0)
    attitude_deg, position_m = errors(T, icp(matcher=matcher, metric=metric).track(scan, guess))
    assert attitude_deg < 0.02
    assert position_m < 0.02


def test_normals_shot_from_a_rough_start_fail_where_nearest_neighbours_do_not():
    lost = dict.fromkeys(MATCHERS, 0)
    for seed in range(12):
        T, guess = pose_and_guess(seed, angle_deg=18.0, offset_m=0.5)
        for matcher in MATCHERS:
            registration = icp(matcher=matcher, metric="point_to_point").track(scan_at(T), guess)
            lost[matcher] += registration.T_sensor_target is None or errors(T, registration)[0] > 3.0
    assert lost["nearest_neighbour"] < lost["normal_shooting"]


def test_points_beside_all_faces_are_no_registration():
    beside = scan_of(np.random.default_rng(1).uniform((40, 40, 40), (50, 50, 50), (30, 3)))
    registration = icp(matcher="normal_shooting").track(beside, make_pose(translation_m=(0, 0, 20)))
    assert registration.T_sensor_target is None
    assert registration.belief.reason.startswith("0 inliers")


def test_sliding_faces_converge_in_far_fewer_steps_than_sticking_points():
    T, guess = pose_and_guess(7)
    scan = scan_at(T)
    slide, stick = (icp(metric=metric).track(scan, guess) for metric in ("point_to_plane", "point_to_point"))
    assert 3 * slide.iterations < stick.iterations


def test_gross_outliers_are_left_out_and_do_not_pull():
    T, guess = pose_and_guess(11)
    registration = icp().track(scan_at(T, gross_outlier_share=0.1), guess)
    attitude_deg, position_m = errors(T, registration)
    assert attitude_deg < 0.5
    assert position_m < 0.05
    assert 0.87 < registration.inlier_share < 0.96
    assert registration.cost_m2 < 0.003


def test_half_a_turn_fits_the_points_but_not_the_rays():
    T, _ = pose_and_guess(3)
    wrong = icp().track(scan_at(T), T * HALF_TURN)
    assert errors(T, wrong)[0] > 170.0
    assert wrong.explained_share < 0.95


def test_the_covariance_holds_the_errors():
    nees = []
    for seed in range(60):
        T, guess = pose_and_guess(seed, range_m=25.0, angle_deg=3.0, offset_m=0.2)
        registration = icp().track(scan_at(T, frame=seed), guess)
        estimate = registration.T_sensor_target
        turn_rad = (estimate.rotation * T.rotation.inv()).as_rotvec()
        error = np.concatenate((estimate.translation - T.translation, turn_rad))
        nees.append(error @ np.linalg.solve(registration.covariance, error))
    assert np.mean(np.array(nees) < 12.59) > 0.85
    assert 1.5 < np.median(nees) < 6.0


def test_a_motion_that_no_face_determines_stays_where_it_was_and_is_uncertain():
    flat = np.stack(
        (*np.meshgrid(np.arange(-2.0, 2.0, 0.4), np.arange(-1.5, 1.5, 0.4)), np.full((8, 10), 18.0)), -1
    )
    broadside = make_pose(rotation=Rotation.from_rotvec([0.0, 0.0, 0.1]), translation_m=(0.3, 0.2, 20.1))
    registration = icp().track(scan_of(flat.reshape(-1, 3)), broadside)
    assert registration.T_sensor_target.translation == pytest.approx((0.3, 0.2, 20.0), abs=0.01)
    sigma = np.sqrt(np.diag(registration.covariance))
    assert sigma[:2].min() > 0.5
    assert sigma[2] < 0.02
    assert np.linalg.eigvalsh(registration.covariance).min() > 0.0


def test_an_unorganised_scan_gives_the_same_pose_without_a_self_check():
    T, guess = pose_and_guess(5)
    organised = icp().track(scan_at(T), guess)
    flat = icp().track(scan_of(scan_at(T).returns_m), guess)
    assert flat.T_sensor_target.as_matrix() == pytest.approx(organised.T_sensor_target.as_matrix())
    assert np.isnan(flat.explained_share)


def test_too_few_returns_are_a_reason():
    for points_m in (np.full((41, 41, 3), np.nan), np.zeros((0, 3)), np.eye(3) + 20.0):
        registration = icp().track(scan_of(points_m), make_pose(translation_m=(0, 0, 20)))
        assert registration.T_sensor_target is None
        assert "6 needed" in registration.belief.reason


@pytest.mark.parametrize("matcher", MATCHERS)
@pytest.mark.parametrize("metric", METRICS)
def test_strange_scans_and_predictions_never_raise(matcher, metric):
    T, guess = pose_and_guess(1)
    inside, behind = make_pose(), make_pose(translation_m=(0.0, 0.0, -30.0))
    line = np.linspace((-3, 0, 20), (3, 0, 20), 40)
    for scan in (scan_at(T), scan_of(line), scan_of(np.full((12, 3), 20.0)), scan_of(1e4 * np.ones((9, 3)))):
        for pose in (guess, inside, behind):
            registration = icp(matcher=matcher, metric=metric, iterations=20).track(scan, pose)
            assert bool(registration.belief.reason) != registration.continues_track


@pytest.mark.parametrize("range_m", [20.0, 50.0])
def test_the_true_pose_explains_nearly_every_ray_and_a_shifted_one_does_not(range_m):
    comparison = ScanComparison(ScanComparisonConfig(), load(BULKY), PATTERN)
    for seed in range(8):
        T, _ = pose_and_guess(seed, range_m)
        shift = make_pose(translation_m=(0.0, 0.0, 0.6))
        assert comparison.explained_share(scan_at(T, frame=seed), T) > 0.96
        assert comparison.explained_share(scan_at(T, frame=seed), shift * T) < 0.6


def test_the_lengths_follow_from_the_sensor_and_the_target_unless_they_are_given():
    paper = ScanLengths.of(IcpNearestNeighbourConfig(), load(BULKY), PATTERN)
    lengths = (0.025, 0.3, 1e-4, load(BULKY).radius_m, 0.003)
    assert dataclasses.astuple(paper) == pytest.approx(lengths)
    assert agreeing_m(ScanComparisonConfig(), PATTERN) == 0.25
    fine = dataclasses.replace(PATTERN, sigma_range_m=0.005)
    assert dataclasses.astuple(ScanLengths.of(IcpNearestNeighbourConfig(), load("mockup"), fine)) == (
        pytest.approx((0.005, 0.06, 2e-5, load("mockup").radius_m, 1.2e-4))
    )
    given = IcpNearestNeighbourConfig(gate_m=0.3, unobserved_m=1.0, sigma_range_m=0.02, step_m=1e-3)
    assert dataclasses.astuple(ScanLengths.of(given, load("mockup"), fine))[:4] == (0.02, 0.3, 1e-3, 1.0)
    unknown = dataclasses.replace(PATTERN, sigma_range_m=0.0)
    assert ScanLengths.of(IcpNearestNeighbourConfig(), load(BULKY), unknown).sigma_range_m == UNKNOWN_SIGMA_M


def test_an_accurate_sensor_tells_a_pose_that_is_a_decimetre_off():
    """A tolerance of 0.25 m for every sensor explained nearly all rays of it."""
    config = LidarConfig(noise=LidarNoiseConfig(sigma_range_m=0.005))
    comparison = ScanComparison(ScanComparisonConfig(), load(BULKY), ScanPattern.of(config.info()))
    T, _ = pose_and_guess(0)
    scan = scan_at(T, sigma_range_m=0.005)
    assert comparison.explained_share(scan, T) > 0.95
    assert comparison.explained_share(scan, make_pose(translation_m=(0.0, 0.0, 0.12)) * T) < 0.5


def test_returns_that_should_be_there_and_are_not_count_against_a_pose():
    comparison = ScanComparison(ScanComparisonConfig(), load(BULKY), PATTERN)
    T, _ = pose_and_guess(0)
    points_m = scan_at(T).points_m.copy()
    for missing in (np.nan, 0.0):
        points_m[::2] = missing
        assert comparison.explained_share(scan_of(points_m), T) == pytest.approx(0.5, abs=0.1)


def test_the_same_scan_gives_the_same_registration():
    T, guess = pose_and_guess(9)
    one, other = (icp().track(scan_at(T), guess) for _ in range(2))
    assert np.array_equal(one.T_sensor_target.as_matrix(), other.T_sensor_target.as_matrix())
