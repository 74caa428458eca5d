"""Scans of a target that has another size than its model."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from lidar_scans import BULKY, load, random_pose, scan_at, tracker

from rpod_pose.lidar.projective_icp import ProjectiveIcp
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.registration.lie_group import PoseArrays, moved
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.lidar.search import ProjectiveIcpConfig
from rpod_schemas.poses import pose_error

T = random_pose(3)


@pytest.fixture(scope="module")
def scan():
    return scan_at(T)


def by_share(found):
    return {round(100.0 * size.share): size for size in found.other_sizes()}


def test_the_right_model_is_likelier_than_a_target_of_another_size(scan):
    sizes = by_share(tracker().track(scan, T))
    assert set(sizes) == {-3, -1, 1, 3}
    assert all(sizes[share].log_odds < -20.0 for share in (-3, 3))
    assert all(sizes[share].log_odds < 0.0 for share in (-1, 1))
    assert {share for share, size in sizes.items() if size.tests} == {-3, 3}


def test_another_process_gets_the_poses_of_other_sizes_without_the_scan_and_the_target(scan):
    found = tracker().track(scan, T)
    sent = pickle.dumps(found)
    assert len(sent) < 10_000
    here, there = by_share(found), by_share(pickle.loads(sent))  # noqa: S301 - of this test
    assert {share: size.log_odds for share, size in there.items()} == {
        share: size.log_odds for share, size in here.items()
    }


def test_other_sizes_are_the_same_while_another_scan_is_tracked(scan):
    own, other = tracker(), random_pose(4)
    expected, found, between = own.track(scan, T).other_sizes(), own.track(scan, T), scan_at(other)
    with ThreadPoolExecutor(1) as pool:
        for _ in range(5):
            sizes = pool.submit(found.other_sizes)
            while not sizes.done():
                own.track(between, other)
            for size, same in zip(sizes.result(), expected, strict=True):
                assert (size.log_odds, size.step.tolist()) == (same.log_odds, same.step.tolist())


@pytest.mark.parametrize("percent", [-3, 3])
def test_the_odds_of_another_size_are_those_of_a_model_of_this_size(scan, percent):
    own, pattern = tracker(), ScanPattern.of(LidarConfig().info())
    other = ProjectiveIcp(ProjectiveIcpConfig(), load(f"{BULKY}@scale={percent}%"), pattern)
    other.model.assumed = own.model.assumed
    seen, found = own.view.seen(scan), own.track(scan, T)
    size = by_share(found)[percent]
    fits = [
        (own.model, found.T_sensor_target),
        (other.model, moved(found.T_sensor_target, size.step)),
    ]
    logs = [model.fit(seen, *PoseArrays.of(pose)).log_likelihood for model, pose in fits]
    assert size.log_odds == pytest.approx(logs[1] - logs[0], abs=0.5)


def test_a_model_that_is_too_large_is_less_likely_than_a_smaller_target_whose_pose_is_nearer(scan):
    pattern = ScanPattern.of(LidarConfig().info())
    found = ProjectiveIcp(ProjectiveIcpConfig(), load(f"{BULKY}@scale=3%"), pattern).track(scan, T)
    smaller, larger = by_share(found)[-3], by_share(found)[3]
    assert smaller.log_odds > 20.0
    assert larger.log_odds < 0.0
    _, off_m = pose_error(T, found.T_sensor_target)
    left_m = found.T_sensor_target.rotation.inv().apply(off_m) + smaller.step[:3]
    assert np.linalg.norm(left_m) < 0.5 * np.linalg.norm(off_m)


def test_wide_beams_may_make_a_small_target_look_larger_and_a_large_one_hardly(scan):
    sizes = by_share(tracker().track(scan, T))
    beam_m = 1.5e-3 * np.linalg.norm(T.translation)
    sigmas = 0.03 * load(BULKY).radius_m / beam_m
    assert sizes[3].most_log_odds == pytest.approx(0.5 * sigmas**2, rel=0.01)
    assert sizes[3].most_log_odds > 20.0
    assert sizes[-3].most_log_odds == np.inf
