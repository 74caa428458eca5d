"""Returns of no surface are told from those of a surface that is not the target's."""

import numpy as np
import pytest
from lidar_scans import errors, load, off, random_pose, scan_at, scan_of, search, tracker
from scipy.spatial.transform import Rotation

from rpod_geometry.rays import cast
from rpod_pose.belief import BeliefLevel, worst_sigma
from rpod_pose.lidar.returns.false_returns import lone_returns
from rpod_schemas.poses import make_pose

TRUTH = random_pose(3, 50.0)


def with_false_returns(scan, count, seed=2):
    """Return a scan in which some rays beside the target return a range between 25 and 75 m."""
    random, rays = np.random.default_rng(seed), tracker().view.grid.directions
    points_m = scan.points_m.astype(np.float64)
    empty = np.argwhere(np.isnan(points_m[..., 0]))
    for row, column in random.choice(empty, count, replace=False):
        points_m[row, column] = random.uniform(25.0, 75.0) * rays[row, column]
    return scan_of(points_m)


def with_plate(scan):
    """Return a scan in which a plate of some metres stands beside the target."""
    rays, points_m = tracker().view.grid.directions, scan.points_m.astype(np.float64)
    points_m[4:7, 4:8] = 50.0 * rays[4:7, 4:8]
    return scan_of(points_m)


@pytest.mark.parametrize("count", [10, 20])
def test_a_scan_with_false_returns_is_tracked_and_the_evidence_tells_their_number(count):
    clean = scan_at(TRUTH)
    found = tracker().track(with_false_returns(clean, count), off(TRUTH, 1.0, 0.1, 4))
    assert found.belief.level is BeliefLevel.ACCEPTED
    assert 0.5 * count <= found.belief.evidence["false_returns"] <= count
    angle_deg, distance_m = errors(TRUTH, found.T_sensor_target)
    assert angle_deg < 4.0 * np.degrees(worst_sigma(found.covariance[3:, 3:]))
    assert distance_m < 4.0 * worst_sigma(found.covariance[:3, :3])
    assert "false_returns" not in tracker().track(clean, off(TRUTH, 1.0, 0.1, 4)).belief.evidence


def test_a_first_pose_is_found_in_a_scan_with_false_returns():
    found = search().acquire(with_false_returns(scan_at(TRUTH), 12))
    assert found.begins_track
    assert found.belief.evidence["false_returns"] >= 6
    assert errors(TRUTH, found.pose)[0] < 3.0


def test_a_plate_beside_the_target_and_a_wrong_attitude_stay_contradictions():
    turned = make_pose(
        rotation=TRUTH.rotation * Rotation.from_euler("Z", 90, degrees=True), translation_m=TRUTH.translation
    )
    tracked = tracker().track(with_plate(scan_at(TRUTH)), off(TRUTH, 1.0, 0.1, 4))
    wrong = tracker().track(with_false_returns(scan_at(TRUTH), 10), turned)
    for found in (tracked, wrong):
        assert found.belief.level is BeliefLevel.CONTRADICTED
        assert "does not explain the scan" in found.belief.reason


def test_where_the_targets_own_returns_stand_alone_none_is_false():
    seen = tracker().view.seen(with_false_returns(scan_of(np.full((*tracker().view.shape, 3), np.nan)), 25))
    agreeing = np.zeros(tracker().view.shape, np.bool_)
    agreeing[tuple(np.argwhere(seen.range_m > 0.0)[:12].T)] = True
    lone = lone_returns(seen, agreeing)
    assert len(lone.places) > 5
    assert lone.of_surfaces == len(lone.places)


def test_returns_of_a_steep_face_have_neighbours():
    target = load("mockup")
    hits = cast(tracker().view.grid, target.triangles_m, make_pose(translation_m=(0.0, 0.0, 6.0)))
    points_m = np.where(np.isfinite(hits.range_m)[..., None], tracker().view.grid.directions, np.nan)
    seen = tracker().view.seen(scan_of(points_m * hits.range_m[..., None]))
    lone = lone_returns(seen, np.zeros(seen.range_m.shape, np.bool_))
    assert seen.returns > 20
    assert len(lone.places) < 0.2 * seen.returns
