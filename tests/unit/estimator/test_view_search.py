from functools import cache

import numpy as np
import pytest
from pmd_frames import depth_frame, frame_of, strange_frames
from scipy.spatial.transform import Rotation

from rpod_estimator.acquisition.view_search import ViewSearch, even_directions, visible_centroids
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd_methods import PmdAcquisitionConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_target import load_target

FRONTAL = make_pose(rotation=FACING, translation_m=(0.1, -0.1, 4.5))
mockup = cache(lambda: load_target("mockup"))
search = cache(lambda: ViewSearch(PmdAcquisitionConfig(), mockup()))
frontal = cache(lambda: depth_frame(mockup(), FRONTAL, noise_m=0.01))
found = cache(lambda: search().search(frontal()).poses)


def attitude_error_deg(T_truth, T):
    return np.rad2deg(np.linalg.norm(pose_error(T_truth, T)[0]))


@pytest.mark.parametrize("seed", range(3))
def test_any_attitude_is_found_without_a_guess(seed):
    T = make_pose(rotation=Rotation.random(random_state=seed), translation_m=(0.2, 0.1, 3.5 + 0.5 * seed))
    best = search().search(depth_frame(mockup(), T, noise_m=0.01, seed=seed)).poses[0]
    assert attitude_error_deg(T, best.T_sensor_target) < 3.0
    assert np.linalg.norm(best.T_sensor_target.translation - T.translation) < 0.03


def test_the_details_tell_the_target_from_its_turns_by_60_degrees():
    candidates = found()
    angles_deg = [attitude_error_deg(FRONTAL, candidate.T_sensor_target) for candidate in candidates]
    assert angles_deg[0] < 2.0
    assert any(abs(angle - 60.0) < 5.0 or abs(angle - 120.0) < 5.0 for angle in angles_deg[1:])
    assert candidates[1].cost_m2 > 1.3 * candidates[0].cost_m2


def test_candidates_are_distinct_and_best_first():
    candidates = found()
    costs = [candidate.cost_m2 for candidate in candidates]
    assert len(candidates) == PmdAcquisitionConfig().candidates
    assert costs == sorted(costs)
    for k, one in enumerate(candidates):
        for other in candidates[:k]:
            assert attitude_error_deg(one.T_sensor_target, other.T_sensor_target) > np.rad2deg(0.2) - 1e-6


def test_a_background_within_range_is_left_out():
    depth_m = frontal().depth_m.copy()
    depth_m[::9, ::9] = np.where(np.isfinite(depth_m[::9, ::9]), depth_m[::9, ::9], 7.2)
    best = search().search(frame_of(depth_m)).poses[0]
    assert attitude_error_deg(FRONTAL, best.T_sensor_target) < 3.0


def test_the_same_frame_gives_the_same_candidates():
    again = search().search(frontal()).poses
    assert [candidate.cost_m2 for candidate in again] == [candidate.cost_m2 for candidate in found()]


@pytest.mark.parametrize("frame", strange_frames().values(), ids=strange_frames().keys())
def test_no_frame_raises(frame):
    for candidate in search().search(frame).poses:
        assert np.isfinite(candidate.cost_m2)


def test_nothing_in_sight_is_no_candidate():
    assert search().search(frame_of(np.nan)).poses == ()


def test_directions_are_even():
    directions = even_directions(150)
    cosines = directions @ directions.T - 2.0 * np.eye(150)
    nearest_deg = np.rad2deg(np.arccos(cosines.max(axis=1)))
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert nearest_deg.min() > 10.0
    assert nearest_deg.max() < 20.0


def test_the_centroid_of_a_view_is_that_of_the_pixels_that_show_the_target():
    T = make_pose(rotation=FACING, translation_m=(0.0, 0.0, 40.0))
    camera = frame_of(np.nan).camera.model_copy(update={"fx": 6000.0, "fy": 6000.0})
    frame = depth_frame(mockup(), T, camera=camera)
    depth_m = float(np.nanmean(frame.depth_m))
    centroid_m = visible_centroids(mockup(), np.array([[1.0, 0.0, 0.0]]))[0]
    assert T.apply(centroid_m)[2] == pytest.approx(depth_m, abs=0.03)
