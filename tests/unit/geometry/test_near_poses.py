"""Lists of triangles for poses near one another: an image by them is that of the whole tree."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_geometry.near_poses import NearPoses, apart, cast_near, is_near, near_triangles, no_triangles
from rpod_geometry.ray_tree import cast_tree, ray_tree
from rpod_geometry.rays import Hits, RayGrid
from rpod_target import load_target

ANGLES_RAD = np.deg2rad(np.linspace(-15.0, 15.0, 61))
GRID = RayGrid.azimuth_elevation(ANGLES_RAD, ANGLES_RAD)


def on_the_bound(poses, rng):
    """Return R and t at the greatest turn and shift, in random directions."""
    axis, way = (vector / np.linalg.norm(vector) for vector in rng.standard_normal((2, 3)))
    turn = Rotation.from_rotvec(0.999 * poses.turn_rad * axis).as_matrix()
    return turn @ poses.R, poses.t + 0.999 * poses.apart_m * way


@pytest.mark.parametrize("name", ["envisat-mesh", "envisat-detailed", "mockup"])
@pytest.mark.parametrize(("apart_share", "turn_deg"), [(0.002, 0.1), (0.02, 1.0), (0.05, 8.0), (0.0, 0.0)])
def test_an_image_by_the_lists_is_that_of_the_tree_to_the_last_bit(name, apart_share, turn_deg):
    target, rng = load_target(name), np.random.default_rng(5)
    tree, listed, wanted, seen = ray_tree(target.triangles_m), Hits.of(GRID), Hits.of(GRID), 0
    for _ in range(4):
        t = target.radius_m * (np.array([0.0, 0.0, 4.0]) + rng.uniform(-0.5, 0.5, 3))
        R = Rotation.random(rng=rng).as_matrix()
        poses = NearPoses(R, t, apart_share * target.radius_m, np.radians(turn_deg))
        near = near_triangles(GRID.arrays, tree, poses)
        for _ in range(5):
            R, t = on_the_bound(poses, rng)
            assert is_near(poses, R, t)
            cast_near(GRID.arrays, tree, near, R, t, listed.range_m, listed.triangle)
            cast_tree(GRID.arrays, tree, R, t, wanted.range_m, wanted.triangle)
            np.testing.assert_array_equal(listed.triangle, wanted.triangle)
            np.testing.assert_array_equal(listed.range_m, wanted.range_m)
            seen += np.count_nonzero(wanted.triangle >= 0)
    assert seen > 1000


def test_the_shift_and_the_turn_between_two_poses():
    R, other = Rotation.random(rng=np.random.default_rng(2)), Rotation.from_rotvec([0.0, 0.3, 0.4])
    shift_m, turn_rad = apart(R.as_matrix(), np.zeros(3), (other * R).as_matrix(), np.array([0.0, 3.0, 4.0]))
    assert (shift_m, turn_rad) == pytest.approx((5.0, 0.5))


def test_a_pose_beyond_the_turn_or_the_shift_is_not_near():
    poses = NearPoses(np.eye(3), np.array([0.0, 0.0, 5.0]), 0.1, 0.1)
    turned = Rotation.from_rotvec([0.11, 0.0, 0.0]).as_matrix()
    assert not is_near(poses, turned, poses.t)
    assert not is_near(poses, np.eye(3), np.array([0.0, 0.11, 5.0]))
    assert not is_near(no_triangles(poses.R, poses.t).poses, poses.R, poses.t)
