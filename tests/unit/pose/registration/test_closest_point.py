import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rpod_pose.registration.closest_point import Surface, on_triangle

SEEDS = st.integers(0, 2**32 - 1)


def random_surface(random, triangles=30):
    triangles_m = random.normal(size=(triangles, 1, 3)) + random.normal(scale=0.6, size=(triangles, 3, 3))
    normals = np.cross(triangles_m[:, 1] - triangles_m[:, 0], triangles_m[:, 2] - triangles_m[:, 0])
    return Surface.of(triangles_m, normals / np.linalg.norm(normals, axis=1, keepdims=True))


@settings(deadline=None)
@given(SEEDS)
def test_no_point_of_a_triangle_is_closer_than_the_one_found(seed):
    random = np.random.default_rng(seed)
    triangle, p = random.normal(size=(3, 3)), random.normal(scale=2.0, size=3)
    found = np.array(on_triangle(p, triangle))
    others = random.dirichlet((0.5, 0.5, 0.5), size=300) @ triangle
    assert np.linalg.norm(found - p) <= np.linalg.norm(others - p, axis=1).min() + 1e-12
    weights = np.linalg.lstsq(np.vstack((triangle.T, np.ones(3))), np.append(found, 1.0), rcond=None)[0]
    assert weights @ triangle == pytest.approx(found, abs=1e-6)
    assert weights.min() > -1e-6


@pytest.mark.parametrize(
    ("point", "closest"),
    [
        ((0.2, 0.2, 1.0), (0.2, 0.2, 0.0)),
        ((0.5, -2.0, 0.0), (0.5, 0.0, 0.0)),
        ((-1.0, 0.5, 0.0), (0.0, 0.5, 0.0)),
        ((1.0, 1.0, 0.0), (0.5, 0.5, 0.0)),
        ((-1.0, -1.0, 0.0), (0.0, 0.0, 0.0)),
        ((3.0, -1.0, 0.0), (1.0, 0.0, 0.0)),
        ((-1.0, 3.0, 0.0), (0.0, 1.0, 0.0)),
    ],
)
def test_inside_edges_and_corners_are_told_apart(point, closest):
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    assert on_triangle(np.array(point), triangle) == pytest.approx(closest)


@settings(deadline=None)
@given(SEEDS)
def test_pruning_and_a_wrong_first_guess_change_nothing(seed):
    random = np.random.default_rng(seed)
    surface, points_m = random_surface(random), random.normal(scale=2.0, size=(20, 3))
    usable = random.random(30) < 0.7
    usable[3] = True
    nearest = random.integers(0, 30, size=20).astype(np.int32)
    closest_m = surface.closest(points_m, usable, nearest)
    every = [[on_triangle(p, triangle) for triangle in surface.triangles_m[usable]] for p in points_m]
    expected_m = np.linalg.norm(np.array(every) - points_m[:, None], axis=2).min(axis=1)
    assert np.linalg.norm(closest_m - points_m, axis=1) == pytest.approx(expected_m)
    assert usable[nearest].all()
    own = [on_triangle(p, surface.triangles_m[k]) for p, k in zip(points_m, nearest, strict=True)]
    assert closest_m == pytest.approx(np.array(own))


@settings(deadline=None)
@given(SEEDS)
def test_a_projected_point_is_the_closest_foot_of_a_normal_within_a_usable_triangle(seed):
    random = np.random.default_rng(seed)
    surface, points_m = random_surface(random), random.normal(scale=2.0, size=(20, 3))
    usable, nearest = random.random(30) < 0.7, np.zeros(20, np.int32)
    projected_m = surface.projected(points_m, usable, nearest)
    height_m = ((points_m[:, None] - surface.triangles_m[:, 0]) * surface.normals).sum(axis=2)
    feet_m = points_m[:, None] - height_m[..., None] * surface.normals
    own_m = [
        [on_triangle(foot, triangle) for foot, triangle in zip(feet, surface.triangles_m, strict=True)]
        for feet in feet_m
    ]
    within = (np.linalg.norm(feet_m - own_m, axis=2) < 1e-12) & usable
    expected_m = np.where(within, np.abs(height_m), np.inf).min(axis=1)
    met = np.isfinite(expected_m)
    assert np.array_equal(nearest >= 0, met)
    assert np.linalg.norm(projected_m - points_m, axis=1)[met] == pytest.approx(expected_m[met])
    assert within[np.flatnonzero(met), nearest[met]].all()


def test_a_foot_on_the_edge_between_two_faces_is_on_the_surface():
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float)
    square = Rotation.from_rotvec([0.3, 0.8, -0.4]).apply(square.reshape(-1, 3)).reshape(2, 3, 3)
    normal = np.cross(square[0, 1], square[0, 2])
    points_m = np.linspace(0.0, 1.0, 101)[:, None] * square[0, 2] + 0.7 * normal
    nearest = np.zeros(101, np.int32)
    Surface.of(square, np.stack((normal, normal))).projected(points_m, np.ones(2, bool), nearest)
    assert (nearest >= 0).all()


def test_a_face_is_seen_from_its_outer_side_only():
    triangles_m = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    surface = Surface.of(triangles_m, np.array([[0.0, 0.0, 1.0]]))
    assert surface.facing(np.array([5.0, 5.0, 1.0])).tolist() == [True]
    assert surface.facing(np.array([0.2, 0.2, -1.0])).tolist() == [False]
