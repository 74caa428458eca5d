"""Scans whose ranges are noisier than the sensor states."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from lidar_scans import BULKY, LIDAR, load, nees, off, random_pose, scan_at, tracker

from rpod_pose.belief import NOISE_M, STATED_NOISE_M
from rpod_pose.lidar.global_search import GlobalSearch
from rpod_pose.lidar.neighbour_residuals import noise_over
from rpod_pose.lidar.noisy_ranges import NoisyScanSearch, NoisyScanTracker
from rpod_pose.lidar.projective_icp import ProjectiveIcp
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_schemas.config.lidar.search import GlobalSearchConfig, ProjectiveIcpConfig

TRUE_M = LIDAR.noise.sigma_range_m
SEEDS = range(3)


def stating(factor):
    pattern = ScanPattern.of(LIDAR.info())
    return replace(pattern, sigma_range_m=factor * pattern.sigma_range_m)


def noisy_tracker(factor):
    return NoisyScanTracker(partial(ProjectiveIcp, ProjectiveIcpConfig(), load(BULKY)), stating(factor))


@pytest.mark.parametrize("factor", [0.1, 0.3])
def test_scans_of_a_sensor_that_states_too_little_noise_are_tracked_with_the_noise_that_they_show(factor):
    icp = noisy_tracker(factor)
    for seed in SEEDS:
        truth = random_pose(seed)
        found = icp.track(scan_at(truth, frame=seed), off(truth, 1.0, 0.1, seed))
        assert found.begins_track
        assert 0.6 * TRUE_M < found.belief.evidence[NOISE_M] < 1.6 * TRUE_M
        assert found.belief.evidence[STATED_NOISE_M] == pytest.approx(factor * TRUE_M)
        assert nees(truth, found) < 20.0


def test_without_this_such_scans_contradict_their_right_poses():
    icp = ProjectiveIcp(ProjectiveIcpConfig(), load(BULKY), stating(0.1))
    truths = [random_pose(seed) for seed in SEEDS]
    found = [icp.track(scan_at(T, frame=n), off(T, 1.0, 0.1, n)) for n, T in enumerate(truths)]
    assert not any(each.continues_track for each in found)


def test_a_sensor_that_states_its_noise_rightly_or_too_large_is_taken_at_its_word():
    for factor in (1.0, 3.0):
        icp = noisy_tracker(factor)
        for seed in SEEDS:
            found = icp.track(scan_at(random_pose(seed), frame=seed), random_pose(seed))
            assert found.begins_track
            assert NOISE_M not in found.belief.evidence


def test_a_small_noise_is_told_but_not_assumed_where_the_sensor_states_none():
    truth, pattern = random_pose(1), replace(ScanPattern.of(LIDAR.info()), sigma_range_m=0.0)
    icp = ProjectiveIcp(ProjectiveIcpConfig(), load(BULKY), pattern)
    quiet = LIDAR.model_copy(update={"noise": LIDAR.noise.model_copy(update={"sigma_range_m": 0.01})})
    scan = scan_at(truth, lidar=quiet)
    found = NoisyScanTracker(partial(ProjectiveIcp, ProjectiveIcpConfig(), load(BULKY)), pattern).track(
        scan, truth
    )
    assert found.belief.evidence[NOISE_M] == pytest.approx(0.01, rel=0.2)
    assert found.belief.evidence[STATED_NOISE_M] == pattern.assumed_sigma_m
    assert np.array_equal(found.covariance, icp.track(scan, truth).covariance)


def test_a_wrong_pose_is_not_taken_for_noise():
    icp = noisy_tracker(1.0)
    for seed in range(8):
        truth = random_pose(seed)
        found = icp.track(scan_at(truth, frame=seed), off(truth, 50.0, 0.5, seed))
        assert NOISE_M not in found.belief.evidence
        assert not found.continues_track or nees(truth, found) < 50.0


def test_a_first_pose_is_found_with_the_noise_that_the_scan_shows():
    search = NoisyScanSearch(partial(GlobalSearch, GlobalSearchConfig(), load(BULKY)), stating(0.1))
    truth = random_pose(4)
    scan = scan_at(truth)
    found = search.acquire(scan)
    assert found.begins_track
    assert nees(truth, found.registration) < 20.0
    near = search.near(scan, off(truth, 5.0, 0.2, 1))
    assert near.belief.evidence[NOISE_M] == found.belief.evidence[NOISE_M]
    turned = tracker().track(scan, off(truth, 50.0, 0.5, 1))
    of_found, of_turned = search.log_likelihoods(scan, [found.registration, turned])
    assert of_found > of_turned + 20.0


@pytest.mark.parametrize(("shared", "expected"), [(0.0, 3.0), (0.8, 1.0)])
def test_what_neighbours_share_is_no_noise(shared, expected):
    random = np.random.default_rng(3)
    wave = np.sqrt(2.0) * np.sin(np.linspace(0.0, 9.0, 20))[:, None]
    residual_m = 0.06 * (np.sqrt(1.0 - shared) * random.normal(size=(20, 20)) + np.sqrt(shared) * wave)
    shown_m = np.full((20, 20), 10.0, np.float32)
    found = noise_over(10.0 + residual_m, shown_m, np.zeros((20, 20), np.int32), 0.02)
    assert found == pytest.approx(expected, rel=0.2)


def test_few_returns_show_no_noise():
    shown_m, triangle = np.full((2, 2), 10.0, np.float32), np.full((2, 2), -1, np.int32)
    assert noise_over(shown_m + 0.1, shown_m, triangle, 0.02) == 1.0
    assert noise_over(shown_m + 0.1, shown_m, triangle + 1, 0.02) == 1.0
