"""Lines of a grid are found as by a binary search, and no ray within a triangle is left out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.unit.geometry.test_rays import GRIDS

from rpod_geometry.kernels import kernel
from rpod_geometry.lines import end_line, first_line, lines_of
from rpod_geometry.rays import RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import make_pose


@kernel
def found(lower: FloatArray, upper: FloatArray, slopes: FloatArray) -> FloatArray:
    """Return the first line and the last + 1 for slopes, shape (N,), by bounds of shape (lines,) each."""
    lines, both = lines_of(lower, upper), np.empty((slopes.size, 2))
    for n in range(slopes.size):
        both[n, 0], both[n, 1] = first_line(lines, slopes[n]), end_line(lines, slopes[n])
    return both


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_lines_are_those_of_a_binary_search(grid: RayGrid) -> None:
    arrays = grid.arrays
    for lower, upper in (
        (arrays.column_lower, arrays.column_upper),
        (arrays.row_lower, arrays.row_upper),
    ):
        near = np.concatenate((lower, upper))
        slopes = np.concatenate(
            (near, np.nextafter(near, np.inf), np.nextafter(near, -np.inf), np.linspace(-9.0, 9.0, 500))
        )
        slopes = np.append(slopes, (np.inf, -np.inf, 1e300, -1e300))
        both = found(lower, upper, slopes)
        np.testing.assert_array_equal(both[:, 0], np.searchsorted(upper, slopes, side="left"))
        np.testing.assert_array_equal(both[:, 1], np.searchsorted(lower, slopes, side="right"))


@pytest.mark.parametrize("name", ["pinhole", "distorted pinhole", "narrow LIDAR", "wide LIDAR"])
@pytest.mark.parametrize("single", [False, True], ids=["double", "single"])
def test_rays_in_thin_and_slanted_triangles_are_all_met(name: str, single: bool) -> None:
    grid = GRIDS[name].in_single_precision() if single else GRIDS[name]
    random = np.random.default_rng(11)
    for _ in range(60):
        ends = random.normal(scale=1.0, size=(3, 3))
        ends[2] = ends[0] + random.normal(scale=0.05, size=3)  # a sliver across many columns
        pose = make_pose(rotation=Rotation.random(rng=random), translation_m=(0.1, -0.1, 4.0))
        R, t = pose.rotation.as_matrix(), pose.translation
        corner = np.empty((3, 3))
        for i in range(3):
            for k in range(3):
                corner[i, k] = t[k] + R[k, 0] * ends[i, 0] + R[k, 1] * ends[i, 1] + R[k, 2] * ends[i, 2]
        sign = np.sign(np.linalg.det(corner))
        sides = np.array([sign * np.cross(corner[i], corner[(i + 1) % 3]) for i in range(3)])
        sides = sides.astype(grid.components.dtype)
        x, y, z = grid.components
        within = np.all([a * x + b * y + c * z >= 0.0 for a, b, c in sides], axis=0)
        met = cast(grid, ends[None], pose).triangle == 0
        assert (met == within).mean() > 1.0 - 2.0 / met.size  # rounding at a side
