"""Single rays through a tree of boxes: what the caster of whole images finds, they find."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_geometry.ray_tree import cast_tree, first_hit, no_nodes, ray, ray_tree, silhouette_m2
from rpod_geometry.rays import Hits, RayGrid, cast
from rpod_schemas.poses import make_pose
from rpod_target import load_target

ANGLES_RAD = np.deg2rad(np.linspace(-20.0, 20.0, 41))
GRID = RayGrid.azimuth_elevation(ANGLES_RAD, ANGLES_RAD)


def test_an_image_through_the_tree_is_that_of_all_triangles():
    target = load_target("envisat-mesh")
    tree, hits = ray_tree(target.triangles_m), Hits.of(GRID)
    for seed in range(12):
        R = Rotation.random(rng=np.random.default_rng(seed))
        pose = make_pose(rotation=R, translation_m=(1.0, -2.0, 25.0 + 3.0 * seed))
        wanted = cast(GRID, target.triangles_m, pose, cull_back_faces=True)
        cast_tree(GRID.arrays, tree, R.as_matrix(), pose.translation.copy(), hits.range_m, hits.triangle)
        met = wanted.triangle >= 0
        assert met.any()
        np.testing.assert_array_equal(hits.triangle >= 0, met)
        np.testing.assert_allclose(hits.range_m[met], wanted.range_m[met], rtol=1e-5)


def test_a_ray_from_within_the_bounds_meets_what_lies_ahead_of_it():
    target = load_target("envisat-bulky")
    tree, hits = ray_tree(target.triangles_m), Hits.of(GRID)
    pose = make_pose(translation_m=(0.0, 6.0, 4.0))
    R, t = pose.rotation.as_matrix(), pose.translation.copy()
    cast_tree(GRID.arrays, tree, R, t, hits.range_m, hits.triangle)
    wanted = cast(GRID, target.triangles_m, pose, cull_back_faces=True)
    np.testing.assert_array_equal(hits.triangle >= 0, wanted.triangle >= 0)


@pytest.mark.parametrize(("from_z", "seen"), [(-5.0, True), (5.0, False)])
def test_a_triangle_is_met_from_its_outer_side_only(from_z, seen):
    corners = np.array([[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]])
    down = ray(np.array((0.2, 0.2, from_z)), np.float64(0.0), np.float64(0.0), -np.sign(from_z))
    with np.errstate(divide="ignore"):
        hit = first_hit(ray_tree(corners), down, no_nodes())
    assert (hit.triangle == 0) == seen
    assert hit.range_m == (pytest.approx(5.0) if seen else np.inf)


def test_the_mean_silhouette_of_a_convex_body_is_a_quarter_of_its_surface():
    triangles_m = load_target("hexagonal-body").triangles_m
    sides = triangles_m[:, 1:] - triangles_m[:, :1]
    surface_m2 = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
    lines = np.random.default_rng(1).random((20_000, 4))
    assert silhouette_m2(ray_tree(triangles_m), lines) == pytest.approx(0.25 * surface_m2, rel=0.02)
