"""Dead channels of a scanner that are declared say nothing: neither a return nor a miss."""

from dataclasses import replace

import numpy as np
import pytest
from lidar_scans import BULKY, LIDAR, errors, load, off, random_pose, scan_at, scan_of, tracker

from rpod_pose.lidar.methods import ScanFrames
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import methods_of
from rpod_pose.surroundings.known import KnownParts, KnownSurroundingsError
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.config.surroundings import SensorSurroundings
from rpod_schemas.types import BeliefLevel

EACH_FOURTH = tuple(range(1, LIDAR.info().elevation_rad.size, 4))


def known(tmp_path, **changes):
    frames = ScanFrames(ScanPattern.of(LIDAR.info()))
    return KnownParts.of(SensorSurroundings(**changes), frames, tmp_path, sensor="lidar")


def scan_with_dead_rows(T, seed):
    points_m = scan_at(T, BULKY, seed).points_m.copy()
    points_m[list(EACH_FOURTH)] = np.nan
    return scan_of(points_m)


def test_scans_with_dead_rows_are_used_where_these_are_declared(tmp_path):
    parts, undeclared = known(tmp_path, dead_rows=EACH_FOURTH), 0
    for seed in range(6):
        T = random_pose(seed)
        scan, guess = scan_with_dead_rows(T, seed), off(T, 1.0, 0.05, seed)
        undeclared += tracker().track(scan, guess).belief.level == BeliefLevel.ACCEPTED
        found = tracker().track(parts.without(scan), guess)
        assert found.belief.level == BeliefLevel.ACCEPTED
        angle_deg, distance_m = errors(T, found.T_sensor_target)
        assert angle_deg < 0.3
        assert distance_m < 0.02
    assert undeclared < 3


def test_a_first_pose_is_found_beside_declared_rows(tmp_path):
    T = random_pose(3)
    methods = methods_of(LidarInput(), load(BULKY), ScanPattern.of(LIDAR.info()))
    found = methods.acquirer.acquire(
        known(tmp_path, dead_rows=EACH_FOURTH).without(scan_with_dead_rows(T, 3))
    )
    assert found.belief.level == BeliefLevel.ACCEPTED  # also beside a search among other things
    angle_deg, distance_m = errors(T, found.hypotheses[0].pose)
    assert angle_deg < 0.3
    assert distance_m < 0.02


def test_returns_in_a_declared_column_are_not_used(tmp_path):
    scan = scan_at(random_pose(1))
    left = known(tmp_path, dead_columns=(20,)).without(scan)
    assert np.isfinite(scan.points_m[:, 20]).any()
    assert not np.isfinite(left.points_m[:, 20]).any()
    assert np.isinf(left.points_m[:, 20]).all()
    np.testing.assert_array_equal(left.points_m[:, :20], scan.points_m[:, :20])


def test_a_mask_makes_rays_without_a_return_say_nothing(tmp_path):
    unused = np.zeros((41, 41), np.bool_)
    unused[list(EACH_FOURTH)] = True
    T = random_pose(0)
    left = replace(known(tmp_path), unused=unused).without(scan_with_dead_rows(T, 0))
    assert tracker().track(left, off(T, 1.0, 0.05, 0)).belief.level == BeliefLevel.ACCEPTED


@pytest.mark.parametrize(
    ("changes", "scan", "says"),
    [
        ({"dead_rows": (41,)}, scan_of(np.ones((41, 41, 3))), "dead_rows names 41, the frame has 41"),
        ({"dead_columns": (0, 99)}, scan_of(np.ones((41, 41, 3))), "dead_columns names 99"),
        ({"dead_rows": (1,)}, scan_of(np.ones((60, 3))), "let the driver publish organised scans"),
    ],
)
def test_lines_that_the_scan_does_not_have_are_refused_by_name(tmp_path, changes, scan, says):
    with pytest.raises(KnownSurroundingsError, match=says):
        known(tmp_path, **changes).without(scan)
