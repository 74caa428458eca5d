"""The target's few points, and the energies that they give to attitudes."""

from functools import cache

import numpy as np
import pytest
from lidar_scans import BULKY, load, random_pose, scan_at, scan_of, tracker
from scipy.spatial.transform import Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.lidar.returns.distances import ReturnDistances
from rpod_pose.search.attitude_grid import even_directions, super_fibonacci
from rpod_pose.search.energy import CELLS, NOTHING_IN_VIEW, energies
from rpod_pose.search.view_model import AREA, VIEWS, ViewModel, centroids_in_view, spread, view_of
from rpod_schemas.config.lidar.search import GlobalSearchConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera

TARGETS = [BULKY, "envisat-mesh"]
WHOLE = [(20.0, 3), (35.0, 1), (50.0, 0), (50.0, 3), (50.0, 4), (50.0, 5)]
"""Ranges and seeds of poses that the field of view does not cut off."""


@cache
def views(target=BULKY):
    coarse_field = tracker(target).surface.coarse_field
    return ViewModel.of(load(target), coarse_field, count=240, truncation_m=1.5)


def angles_deg(attitudes, others):
    """Return how far each attitude is from the nearest of others."""
    cosines = np.abs(attitudes.as_quat() @ others.as_quat().T).max(axis=1)
    return np.rad2deg(2.0 * np.arccos(np.minimum(cosines, 1.0)))


@pytest.mark.parametrize(("count", "worst_deg"), [(900, 25.0), (2000, 19.0), (12000, 10.0)])
def test_the_grid_of_attitudes_covers_all_of_them_better_than_chance(count, worst_deg):
    asked = Rotation.random(600, rng=np.random.default_rng(0))
    off_deg = angles_deg(asked, super_fibonacci(count))
    by_chance_deg = angles_deg(asked, Rotation.random(count, rng=np.random.default_rng(1)))
    assert off_deg.max() < worst_deg
    assert off_deg.max() < 0.8 * by_chance_deg.max()
    assert off_deg.mean() < 0.95 * by_chance_deg.mean()


def test_the_default_levels_of_the_search_are_dense_enough_for_its_alignment():
    asked = Rotation.random(500, rng=np.random.default_rng(2))
    for level in GlobalSearchConfig().tuning.levels:
        assert angles_deg(asked, super_fibonacci(level.attitudes)).mean() < 15.0


def test_the_direction_of_a_viewpoint_is_found_in_the_table():
    directions, cube = even_directions(VIEWS), views().cube
    asked = np.random.default_rng(4).normal(size=(600, 3))
    asked /= np.linalg.norm(asked, axis=1, keepdims=True)
    found = directions[[view_of(*one, cube) for one in asked]]
    off_deg = np.rad2deg(np.arccos(np.minimum((found * asked).sum(axis=1), 1.0)))
    assert off_deg.max() < 10.0
    assert off_deg.mean() < 4.0


@pytest.mark.parametrize("target", TARGETS)
def test_the_table_says_which_points_a_cast_meets(target):
    rows, seen_from, cube = views(target).points
    agreeing = []
    for seed in range(12):
        T = random_pose(seed, 3.0 * load(target).radius_m)
        places_m = T.apply(rows[:3].T.astype(float))
        range_m = np.linalg.norm(places_m, axis=1)
        rays = RayGrid(np.ascontiguousarray((places_m / range_m[:, None]).T[:, None]))
        first_m = cast(rays, load(target).triangles_m, T).range_m[0]
        facing = (T.rotation.apply(rows[3:6].T) * places_m).sum(axis=1) < 0.0
        met = facing & (first_m > range_m - 0.05)
        agreeing.append((seen_from[view_of(*T.inv().translation, cube)] & facing) == met)
    assert np.mean(agreeing) > 0.95
    assert np.mean(agreeing, axis=1).min() > 0.8


@pytest.mark.parametrize("target", TARGETS)
def test_the_centroid_in_view_is_that_of_the_pixels_of_an_image(target):
    grid = RayGrid.pinhole(Camera(width=128, height=128, fx=600.0, fy=600.0, cx=63.5, cy=63.5))
    off_m = []
    for seed in range(12):
        T = make_pose(
            rotation=Rotation.random(rng=np.random.default_rng(seed)), translation_m=(0.0, 0.0, 200.0)
        )
        hits = cast(grid, load(target).triangles_m, T)
        met = hits.triangle >= 0
        expected_m = (grid.directions[met] * hits.range_m[met][:, None]).mean(axis=0)
        R = T.rotation.as_matrix()[None].astype(np.float32)
        model = views(target)
        (centroid_m,) = centroids_in_view(R, T.translation, model.centroids_m, model.cube)
        off_m.append(np.linalg.norm(T.apply(centroid_m) - expected_m))
    assert np.max(off_m) < 2.0
    assert np.mean(off_m) < 0.8


@pytest.mark.parametrize("target", TARGETS)
def test_the_points_stand_for_the_whole_surface(target):
    for rows, seen_from, _ in (views(target).points, views(target).few_points):
        assert rows[AREA].sum() == pytest.approx(1.0)
        assert (rows[AREA] > 0.0).all()
        np.testing.assert_allclose(np.linalg.norm(rows[3:6], axis=0), 1.0, rtol=1e-5)
        np.testing.assert_allclose(rows[6], (rows[:3] * rows[3:6]).sum(axis=0), atol=1e-4)
        assert seen_from.shape == (VIEWS, rows.shape[1])
        assert seen_from.any(axis=1).all()


def test_spread_points_are_farther_from_each_other_than_any_point_is_from_them():
    points = np.random.default_rng(5).normal(size=(500, 3))
    chosen = points[spread(points, 40)]
    apart = np.linalg.norm(chosen[:, None] - chosen, axis=2) + 1e9 * np.eye(40)
    uncovered = np.linalg.norm(points[:, None] - chosen, axis=2).min(axis=1).max()
    assert apart.min() >= uncovered
    assert sorted(spread(points[:10], 40)) == list(range(10))


def energies_of(attitudes, places_m, scan, *, rounds):
    view, model = tracker().view, views()
    seen = view.seen(scan)
    places_m = np.array(places_m, np.float32)
    energy = energies(
        np.array(attitudes, np.float32),
        places_m,
        seen=seen,
        points=model.points,
        squares=model.squares,
        image=ReturnDistances.of(view).image(seen),
        detection=tracker().model.expected_shares,
        returns=256,
        rounds=rounds,
        truncation_m=1.5,
    )
    return energy, places_m


@pytest.mark.parametrize(("range_m", "seed"), WHOLE)
def test_the_true_attitude_costs_far_less_than_any_wrong_one_and_lies_near_its_place(range_m, seed):
    T = random_pose(seed, range_m)
    scan = scan_at(T, frame=seed)
    centroid_m = tracker().view.seen(scan).points_m.mean(axis=0)
    attitudes = Rotation.concatenate([T.rotation, Rotation.random(300, rng=np.random.default_rng(seed))])
    R = attitudes.as_matrix().astype(np.float32)
    offsets_m = centroids_in_view(R, centroid_m, views().centroids_m, views().cube)
    guesses_m = centroid_m - (R @ offsets_m[..., None])[..., 0]
    energy, places_m = energies_of(R, guesses_m, scan, rounds=2)
    wrong = np.rad2deg((T.rotation.inv() * attitudes).magnitude()) > 30.0
    assert energy[0] < energy[wrong].min()
    assert energy[0] < 0.2 * np.median(energy[wrong])
    assert np.linalg.norm(places_m[0] - T.translation) < 1.0


def test_without_rounds_a_place_stays_and_the_true_one_costs_least():
    T = random_pose(3)
    shifts_m = np.vstack((np.zeros(3), np.eye(3), -np.eye(3)))
    given_m = (T.translation + shifts_m).astype(np.float32)
    energy, places_m = energies_of(
        np.tile(T.rotation.as_matrix(), (7, 1, 1)), given_m, scan_at(T, frame=3), rounds=0
    )
    np.testing.assert_array_equal(places_m, given_m)
    assert energy.argmin() == 0


@pytest.mark.parametrize("place_m", [(0.0, 0.0, -30.0), (300.0, 0.0, 20.0)])
def test_an_attitude_that_shows_nothing_is_marked(place_m):
    energy, _ = energies_of(np.eye(3)[None], [place_m], scan_at(random_pose(3)), rounds=1)
    assert energy[0] == NOTHING_IN_VIEW


def test_the_image_tells_the_angle_to_the_nearest_return():
    view = tracker().view
    points_m = np.full((41, 41, 3), np.nan)
    points_m[20, 20] = (0.0, 0.0, 20.0)
    squares, u0, du, v0, dv = ReturnDistances.of(view).image(view.seen(scan_of(points_m)))
    assert squares.shape == (CELLS, CELLS)
    for column_deg, row_deg in [(0, 0), (5, 0), (0, -7), (3, 4), (-20, 20)]:
        column = int((np.tan(np.deg2rad(column_deg)) - u0) / du)
        row = int((np.tan(np.deg2rad(row_deg)) - v0) / dv)
        off_deg = np.rad2deg(np.sqrt(squares[row, column]))
        assert off_deg == pytest.approx(np.hypot(column_deg, row_deg), abs=1.0)
