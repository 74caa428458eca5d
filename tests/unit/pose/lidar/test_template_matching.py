from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_pose.lidar.paper_2015.template_matching import (
    OnlineTemplateMatching,
    boresight_distance_m,
    euler_grid,
)
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.lidar.methods import TemplateMatchingConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import load_target

LIDAR = LidarConfig()
PATTERN = ScanPattern.of(LIDAR.info())
bulky = cache(lambda: load_target("envisat-bulky"))


@cache
def matching(**options):
    return OnlineTemplateMatching(TemplateMatchingConfig(**options), bulky(), PATTERN)


def scan_of(points_m):
    return LidarScan(stamp_ns=0, frame_id="lidar", points_m=np.asarray(points_m, np.float32))


def scan_at(T_lidar_target, frame=0):
    return scan_of(LidarEmulator(LIDAR, bulky(), seed=2).scan([T_lidar_target], frame=frame).points_m)


def random_pose(seed, range_m=20.0):
    return make_pose(rotation=Rotation.random(rng=np.random.default_rng(seed)), translation_m=(0, 0, range_m))


def errors(T_truth, candidate):
    attitude_rad, position_m = pose_error(T_truth, candidate.T_sensor_target)
    return np.rad2deg(np.linalg.norm(attitude_rad)), np.linalg.norm(position_m)


@pytest.mark.parametrize(("step_deg", "count"), [(60, 196), (40, 500), (30, 1183), (10, 26011)])
def test_the_grid_has_the_papers_number_of_templates(step_deg, count):
    assert len(euler_grid(step_deg)) == count


def test_a_step_that_does_not_divide_the_pitch_centres_its_grid():
    pitch_deg = np.unique(np.round(euler_grid(40).as_euler("ZYX", degrees=True)[:, 1], 3))
    assert pitch_deg == pytest.approx([-80, -40, 0, 40, 80])


def test_the_spread_is_the_mean_distance_from_the_boresight():
    assert boresight_distance_m(np.array([[3.0, 4.0, 10.0], [0.0, 0.0, 30.0]])) == pytest.approx(2.5)


def test_an_attitude_of_the_grid_is_found_at_its_place():
    T = make_pose(rotation=euler_grid(30)[431], translation_m=(0.4, -0.3, 22.0))
    attitude_deg, position_m = errors(T, matching().search(scan_at(T)).poses[0])
    assert attitude_deg < 0.1
    assert position_m < 0.5


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_one_of_the_candidates_lies_within_a_step_of_any_attitude(seed):
    T = random_pose(seed)
    assert min(errors(T, candidate)[0] for candidate in matching().search(scan_at(T)).poses) < 25.0


def test_candidates_are_distinct_and_best_first():
    candidates = matching().search(scan_at(random_pose(1))).poses
    costs_m2 = [candidate.cost_m2 for candidate in candidates]
    assert len(candidates) == TemplateMatchingConfig().candidates
    assert costs_m2 == sorted(costs_m2)
    attitudes = [candidate.T_sensor_target.rotation for candidate in candidates]
    apart = [(one.inv() * other).magnitude() for k, one in enumerate(attitudes) for other in attitudes[:k]]
    assert np.rad2deg(min(apart)) >= TemplateMatchingConfig().distinct_deg


def test_without_the_offset_the_position_is_the_scans_centroid():
    scan = scan_at(random_pose(3))
    candidates = matching(centroid_offset=False).search(scan).poses
    centroid_m = scan.returns_m.astype(float).mean(axis=0)
    for candidate in candidates:
        assert candidate.T_sensor_target.translation == pytest.approx(centroid_m)


def test_the_fast_variant_correlates_only_templates_spread_like_the_scan():
    scan = scan_at(random_pose(0))
    every, fast = (
        matching(distinct_deg=0, candidates=2000),
        matching(distinct_deg=0, candidates=2000, variant="fast"),
    )
    kept, all_of_them = fast.search(scan).poses, every.search(scan).poses
    assert 0.05 < len(kept) / len(all_of_them) < 0.5
    costs_m2 = {candidate.cost_m2 for candidate in all_of_them}
    assert all(candidate.cost_m2 in costs_m2 for candidate in kept)


def test_the_cued_variant_casts_its_share_of_the_templates_and_still_finds_an_attitude_of_the_grid():
    T = make_pose(rotation=euler_grid(30)[431], translation_m=(0.4, -0.3, 22.0))
    found = matching(variant="cued").search(scan_at(T))
    attitude_deg, position_m = errors(T, found.poses[0])
    assert attitude_deg < 0.1
    assert position_m < 0.5
    assert found.templates == 1183
    assert found.excluded_share == pytest.approx(1.0 - TemplateMatchingConfig().cued_share, abs=1e-3)


def test_a_cue_that_keeps_every_template_changes_nothing():
    scan = scan_at(random_pose(4))
    plain, cued = matching().search(scan), matching(variant="cued", cued_share=1.0).search(scan)
    assert [c.cost_m2 for c in cued.poses] == [c.cost_m2 for c in plain.poses]


def test_a_search_near_a_rough_attitude_stays_near_and_finds_the_truth():
    T = random_pose(2)
    rough = T * make_pose(rotation=Rotation.from_rotvec([0.0, 0.4, 0.2]))
    candidates = matching().near(scan_at(T), rough).poses
    turns_deg = [
        np.rad2deg((rough.rotation.inv() * c.T_sensor_target.rotation).magnitude()) for c in candidates
    ]
    assert max(turns_deg) <= TemplateMatchingConfig().near_deg
    assert min(errors(T, candidate)[0] for candidate in candidates) < 25.0


@pytest.mark.parametrize("variant", ["plain", "fast", "cued"])
def test_a_single_candidate_is_the_best_of_many_and_as_many_templates_are_left_out(variant):
    scan = scan_at(random_pose(5))
    many = matching(variant=variant).search(scan)
    one = matching(variant=variant, candidates=1).search(scan)
    assert [candidate.cost_m2 for candidate in one.poses] == [many.poses[0].cost_m2]
    assert np.array_equal(one.poses[0].T_sensor_target.as_matrix(), many.poses[0].T_sensor_target.as_matrix())
    assert one.excluded_share == many.excluded_share


def test_an_unorganised_scan_gives_the_same_candidates():
    scan = scan_at(random_pose(1))
    organised, flat = matching().search(scan).poses, matching().search(scan_of(scan.returns_m)).poses
    assert [candidate.cost_m2 for candidate in organised] == [candidate.cost_m2 for candidate in flat]


STRANGE = {
    "no return": np.full((41, 41, 3), np.nan),
    "no point": np.zeros((0, 3)),
    "three points": np.array([[0, 0, 20], [1, 0, 20], [0, 1, 20]]),
}


@pytest.mark.parametrize("points_m", STRANGE.values(), ids=STRANGE)
def test_too_few_returns_give_no_candidate(points_m):
    assert matching().search(scan_of(points_m)).poses == ()
    assert matching().near(scan_of(points_m), random_pose(0)).poses == ()


@pytest.mark.parametrize("variant", ["plain", "fast", "cued"])
def test_points_on_a_plane_or_all_in_one_place_are_searched_without_fuss(variant):
    plane = np.stack(
        (*np.meshgrid(np.arange(-3.0, 3.0), np.arange(-3.0, 3.0)), np.full((6, 6), 20.0)), axis=-1
    )
    ahead = np.tile([0.0, 0.0, 15.0], (10, 1))
    for points_m in (plane, np.full((10, 3), 15.0), np.full((10, 3), -15.0), ahead, np.zeros((10, 3))):
        assert all(
            np.isfinite(candidate.cost_m2)
            for candidate in matching(step_deg=60, variant=variant).search(scan_of(points_m)).poses
        )
