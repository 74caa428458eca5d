"""Casting through shared corners gives the same as casting each triangle, to the bit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_geometry.rays import Hits, RayGrid, cast_pose
from rpod_geometry.shared_corners import cast_shared, shared_corners

SPAN = 30
NARROW = RayGrid.azimuth_elevation(np.radians(np.linspace(-9, 9, 21)), np.radians(np.linspace(-6, 6, 17)))
WIDE = RayGrid.azimuth_elevation(np.radians(np.linspace(-120, 120, 31)), np.radians(np.linspace(-50, 50, 9)))


def rough_sheet():
    """A sheet of 2 m with 1,682 triangles, each with another slope."""
    x, y = np.meshgrid(np.linspace(-1, 1, SPAN), np.linspace(-1, 1, SPAN))
    corners_m = np.stack((x, y, np.random.default_rng(3).normal(0.0, 0.05, x.shape)), axis=-1).reshape(-1, 3)
    first = (np.arange(SPAN - 1)[:, None] * SPAN + np.arange(SPAN - 1)).ravel()
    upper = np.stack((first, first + SPAN, first + 1), axis=-1)
    lower = np.stack((first + 1, first + SPAN, first + SPAN + 1), axis=-1)
    return np.ascontiguousarray(corners_m[np.concatenate((upper, lower))])


@pytest.mark.parametrize("grid", [NARROW, WIDE])
@pytest.mark.parametrize("place_m", [(0.1, 0.0, 12.0), (0.0, 0.2, 3.0), (0.0, 0.0, 0.3)])
def test_the_hits_are_those_of_each_triangle(grid, place_m):
    triangles_m, R = rough_sheet(), Rotation.from_rotvec((0.2, 0.9, 0.1)).as_matrix()
    t, one, other = np.array(place_m), Hits.of(grid), Hits.of(grid)
    cast_pose(grid.arrays, triangles_m, R, t, True, one.range_m, one.triangle)
    cast_shared(grid.arrays, shared_corners(triangles_m), R, t, other.range_m, other.triangle)
    np.testing.assert_array_equal(one.triangle, other.triangle)
    np.testing.assert_array_equal(one.range_m, other.range_m)
    assert (one.triangle >= 0).any()


def test_corners_that_are_equal_are_one():
    shared = shared_corners(rough_sheet())
    assert shared.corners_m.shape == (3, SPAN**2)
    np.testing.assert_array_equal(shared.corners_m.T[shared.of_triangle], rough_sheet())
