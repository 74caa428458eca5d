"""The compiled correlation, against plain definitions of what it computes."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.lidar.paper_2015.correlation import BLOCK, cast_covariances, match_templates, packed
from rpod_target import load_target

ANGLES_RAD = np.deg2rad(np.linspace(-20.0, 20.0, 41))
GRID = RayGrid.azimuth_elevation(ANGLES_RAD, ANGLES_RAD)
TARGET = load_target("envisat-bulky")
ATTITUDES = Rotation.random(12, rng=np.random.default_rng(3))


def template_m(attitude, position_m):
    """Return the points of the ideal scan, shape (M, 3)."""
    pose = RigidTransform.from_components(position_m, attitude)
    hits = cast(GRID, TARGET.triangles_m, pose, cull_back_faces=True)
    met = hits.triangle >= 0
    return GRID.directions[met] * hits.range_m[met, None]


def spread_m(points_m):
    return float(np.mean(np.hypot(points_m[:, 0], points_m[:, 1])))


def matched(points_m, tau=np.inf, *, best_only=False):
    centroid_m = points_m.mean(axis=0)
    return match_templates(
        GRID.arrays,
        TARGET.triangles_m,
        ATTITUDES.as_matrix(),
        centroid_m,
        packed(points_m - centroid_m),
        len(points_m),
        spread_m(points_m),
        tau,
        best_only,
    )


def cloud(points=300, range_m=22.0):
    random = np.random.default_rng(points)
    return template_m(Rotation.random(rng=random), [0.5, -0.4, range_m])[:points] + random.normal(0, 0.02, 3)


@pytest.mark.parametrize("points", [6, BLOCK, BLOCK + 1, 300])
@pytest.mark.parametrize("range_m", [22.0, 50.0])
def test_cost_centroid_and_spread_are_those_of_all_pairs(points, range_m):
    points_m = cloud(points, range_m)
    centroid_m = points_m.mean(axis=0)
    costs_m2, centroids_m, spreads_m = matched(points_m)
    for k, attitude in enumerate(ATTITUDES):
        expected_m = template_m(attitude, centroid_m)
        tree = cKDTree(expected_m - expected_m.mean(axis=0))
        assert costs_m2[k] == pytest.approx(np.mean(tree.query(points_m - centroid_m)[0] ** 2), rel=1e-5)
        assert centroids_m[k] == pytest.approx(expected_m.mean(axis=0), abs=1e-9)
        assert spreads_m[k] == pytest.approx(spread_m(expected_m), abs=1e-9)


def test_templates_spread_unlike_the_scan_are_not_correlated_and_the_others_are_the_same():
    points_m = cloud()
    every, _, spreads_m = matched(points_m)
    some = matched(points_m, tau=0.1)[0]
    alike = np.abs(spreads_m - spread_m(points_m)) <= 0.1 * spread_m(points_m)
    assert 0 < alike.sum() < len(ATTITUDES)
    assert np.array_equal(some, np.where(alike, every, np.inf))


def test_for_the_best_alone_what_is_worse_is_given_up_and_the_best_is_the_same():
    points_m = cloud()
    every, _, spreads_m = matched(points_m)
    some, _, same_m = matched(points_m, best_only=True)
    falling = every == np.minimum.accumulate(every)
    assert 0 < falling.sum() < len(ATTITUDES)
    assert np.array_equal(some, np.where(falling, every, np.inf))
    assert np.array_equal(same_m, spreads_m)


def test_a_template_without_any_point_has_no_cost():
    costs_m2, _, spreads_m = matched(cloud() - [0.0, 0.0, 80.0])
    assert np.isinf(costs_m2).all()
    assert np.isnan(spreads_m).all()


def test_packed_points_are_all_there_and_the_last_fills_up():
    points_m = np.random.default_rng(1).normal(size=(3 * BLOCK + 5, 3))
    blocks = packed(points_m)
    assert blocks.shape == (4, 3, BLOCK)
    unpacked = blocks.swapaxes(1, 2).reshape(-1, 3)
    found = unpacked[: len(points_m)]
    assert np.array_equal(np.unique(found, axis=0), np.unique(points_m.astype(np.float32), axis=0))
    assert (unpacked[len(points_m) :] == found[-1]).all()


def test_covariances_are_those_of_the_templates_points():
    away_m = np.array([0.0, 0.0, 40.0])
    covariances = cast_covariances(GRID.arrays, TARGET.triangles_m, ATTITUDES.as_matrix(), away_m)
    for covariance, attitude in zip(covariances, ATTITUDES, strict=True):
        assert covariance == pytest.approx(np.cov(template_m(attitude, away_m).T, bias=True), abs=1e-9)
