"""The target rendered at a pose on the coarse pixels, with additional rays between them on demand.

Coarse pixels lie several pixels apart. A few additional rays show whether a range, or a dark pixel, may
belong to a surface one or two pixels away. These rays are tested only against the triangles that the pixel
and its neighbours show.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.rays import NEAREST_M, RayGrid
from rpod_pose.registration.lie_group import PoseArrays
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

NINE = 9
"""Number of rays: a pixel and its eight neighbours. Physics: 3 x 3."""
SKY_PX = 12
"""Width of the sky around the target in a window, px. Numerics: beyond it no search for an edge meets the
target's smoothed image."""


class Window(NamedTuple):
    """The pixels of a rendering around the target; all other pixels show only sky."""

    row: int
    """First row."""
    column: int
    """First column."""
    rows: int
    """Number of rows."""
    columns: int
    """Number of columns."""


class FineRanges(NamedTuple):
    """Ranges of a rendering with several rays for each pixel, which shows thin parts."""

    range_m: Float32Array
    """Range along each ray, shape (rows, columns), inf if it hits nothing; shape (0, 0) without such a
    rendering."""
    per_px: int
    """Number of rays for each pixel, along rows and columns."""
    row: int
    """Row of the ray in the middle of the first coarse pixel; it may be outside the array."""
    column: int
    """Column of that ray."""


COARSE_ONLY = FineRanges(np.empty((0, 0), np.float32), 1, 0, 0)
"""Stands for no rendering with more rays than those of the coarse pixels."""


@dataclass(frozen=True, eq=False)
class Rendering:
    """The target rendered on the coarse pixels, with the data for additional rays between them."""

    range_m: NDArray[np.float32]
    """Range along the ray, inf on pixels that miss the target, shape (rows, columns)."""
    triangle: NDArray[np.int32]
    """Index of the visible triangle, -1 on pixels that miss the target, same shape."""
    grid: RayGrid
    """Rays of the coarse pixels."""
    stride: int
    """Distance from one coarse pixel to the next, px."""
    focal_px: float
    """Focal length of the camera."""
    triangles_m: FloatArray
    """Triangles of the target, target axes, shape (T, 3, 3), counter-clockwise from outside."""
    R: FloatArray
    """R_sensor_target, shape (3, 3)."""
    t: FloatArray
    """Position of the target, sensor axes, shape (3,), m."""

    @property
    def px_per_m(self) -> float:
        """Pixels per metre across the line of sight, at the distance of the target's origin."""
        return self.focal_px / max(float(np.linalg.norm(self.t)), NEAREST_M)

    @property
    def arrays(self) -> "RenderingArrays":
        """The rendering in the form that the kernels take."""
        rays, pose = self.grid.components, PoseArrays(self.R, self.t)
        return RenderingArrays(self.range_m, self.triangle, rays, self.stride, self.triangles_m, pose)


class RenderingArrays(NamedTuple):
    """``Rendering`` in the form that the kernels take."""

    range_m: Float32Array
    """Range along the ray, inf on pixels that miss the target, shape (rows, columns)."""
    triangle: NDArray[np.int32]
    """Index of the visible triangle, -1 on pixels that miss the target, same shape."""
    rays: FloatArray
    """Unit rays of the coarse pixels, shape (3, rows, columns), at least two rows and columns."""
    stride: int
    """Distance from one coarse pixel to the next, px, at least 1."""
    triangles_m: FloatArray
    """Triangles of the target, target axes, shape (T, 3, 3)."""
    pose: PoseArrays


class Around(NamedTuple):
    """Hits of nine rays in and around a coarse pixel."""

    low: float
    """Least range, m; inf if no ray hits."""
    high: float
    """Largest range, m; 0 if no ray hits."""
    hits: int
    """Number of rays that hit."""


@inner_kernel
def around(rendered: RenderingArrays, i: int, j: int, reach: float) -> Around:
    """Return the least and largest range in and around a coarse pixel, and the number of hits of nine rays.

    Args:
        rendered: the target at a pose.
        i: row of the coarse pixel.
        j: column of the coarse pixel.
        reach: distance of the eight rays around it, along rows and columns, px.
    """
    owner, rays, stride, triangles = rendered.triangle, rendered.rays, rendered.stride, rendered.triangles_m
    if not _any_within(
        owner, i, j, max(int(reach / stride), 1)
    ):  # most pixels of a frame that shows other things
        return Around(np.inf, 0.0, 0)
    R, t = rendered.pose
    rows, columns = owner.shape
    below, beside = (i + 1 if i + 1 < rows else i - 1), (j + 1 if j + 1 < columns else j - 1)
    down, across = reach / stride * (below - i), reach / stride * (beside - j)
    inverse, corner, ray = np.zeros(NINE), np.empty((3, 3)), np.empty(3)
    tried, count = np.empty(NINE, np.int32), 0
    for v in range(max(i - 1, 0), min(i + 2, rows)):
        for u in range(max(j - 1, 0), min(j + 2, columns)):
            k = owner[v, u]
            if k < 0 or (tried[:count] == k).any():
                continue
            tried[count] = k
            count += 1
            _place(triangles[k], R, t, corner)
            for n in range(NINE):
                a, b = (n // 3 - 1) * down, (n % 3 - 1) * across
                for m in range(3):
                    here = rays[m, i, j]
                    ray[m] = here + a * (rays[m, below, j] - here) + b * (rays[m, i, beside] - here)
                inverse[n] = max(inverse[n], _per_range(corner, ray))
    low, high, hits = np.inf, 0.0, 0
    for n in range(NINE):
        if inverse[n] > 0.0:
            low, high, hits = min(low, 1.0 / inverse[n]), max(high, 1.0 / inverse[n]), hits + 1
    if hits == 0:  # triangles smaller than a pixel may lie between the nine rays
        return _around_coarsely(rendered, i, j, int(reach / stride))
    return Around(low, high, hits)


@inner_kernel
def _any_within(owner: NDArray[np.int32], i: int, j: int, width: int) -> bool:
    """Return whether ``owner``, shape (rows, columns), shows a triangle at most ``width`` pixels from one."""
    rows, columns = owner.shape
    for v in range(max(i - width, 0), min(i + width + 1, rows)):
        for u in range(max(j - width, 0), min(j + width + 1, columns)):
            if owner[v, u] >= 0:
                return True
    return False


@inner_kernel
def _around_coarsely(rendered: RenderingArrays, i: int, j: int, width: int) -> Around:
    """Return the least and largest range of the coarse pixels at most ``width`` from one; 1 hit if any."""
    low, high, hits = np.inf, 0.0, 0
    rows, columns = rendered.triangle.shape
    for v in range(max(i - width, 0), min(i + width + 1, rows)):
        for u in range(max(j - width, 0), min(j + width + 1, columns)):
            if rendered.triangle[v, u] >= 0:
                range_m = np.float64(rendered.range_m[v, u])
                low, high, hits = min(low, range_m), max(high, range_m), 1
    return Around(low, high, hits)


@inner_kernel
def around_finely(fine: FineRanges, stride: int, i: int, j: int, reach: float) -> Around:
    """Return the least and largest fine range within ``reach``, and the number of hits among nine rays.

    Args:
        fine: ranges of the fine rays.
        stride: distance from one coarse pixel to the next, px.
        i: row of the coarse pixel.
        j: column of the coarse pixel.
        reach: distance within which ranges are used, along rows and columns, px.
    """
    rows, columns = fine.range_m.shape
    row, column = fine.row + fine.per_px * stride * i, fine.column + fine.per_px * stride * j
    width = int(fine.per_px * reach)
    low, high, hits = np.inf, 0.0, 0
    for v in range(max(row - width, 0), min(row + width + 1, rows)):
        for u in range(max(column - width, 0), min(column + width + 1, columns)):
            range_m = fine.range_m[v, u]
            if range_m < np.inf:
                low, high = min(low, range_m), max(high, range_m)
                hits += (v - row) % max(width, 1) == 0 and (u - column) % max(width, 1) == 0
    if high > 0.0:
        hits = max(hits, 1)
    return Around(low, high, hits)


@inner_kernel
def facing(rendered: RenderingArrays, i: int, j: int) -> float:
    """Return the cosine of incidence at a coarse pixel that shows the target; arguments as for ``around``."""
    owner, rays, triangles, R = rendered.triangle, rendered.rays, rendered.triangles_m, rendered.pose.R
    a, b, c = triangles[owner[i, j]]
    squares, along = 0.0, 0.0
    for n in range(3):
        p, q = (n + 1) % 3, (n + 2) % 3
        normal = (b[p] - a[p]) * (c[q] - a[q]) - (b[q] - a[q]) * (c[p] - a[p])
        ray = R[0, n] * rays[0, i, j] + R[1, n] * rays[1, i, j] + R[2, n] * rays[2, i, j]
        squares += normal * normal
        along += normal * ray
    return float(-along / np.sqrt(squares))


@inner_kernel
def _place(triangle: FloatArray, R: FloatArray, t: FloatArray, corner: FloatArray) -> None:
    """Fill ``corner``, (3, 3), with a triangle's corners, (3, 3), moved to sensor axes by R and t; m."""
    for n in range(3):
        x, y, z = triangle[n]
        for m in range(3):
            corner[n, m] = t[m] + R[m, 0] * x + R[m, 1] * y + R[m, 2] * z


@inner_kernel
def _per_range(corner: FloatArray, ray: FloatArray) -> float:
    """Return the inverse of the range at which a ray meets a triangle seen from outside; 0 if it misses.

    The test is that of ``rpod_geometry.rays``; the ray is assumed to have unit length.

    Args:
        corner: corners of the triangle, sensor axes, shape (3, 3), m.
        ray: direction of the ray, sensor axes, shape (3,).
    """
    total = 0.0
    for n in range(3):
        side = _product(corner[n], corner[(n + 1) % 3], ray)
        if side > 0.0:
            return 0.0
        total += side
    return total / _product(corner[0], corner[1], corner[2])


@inner_kernel
def _product(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Return (a x b) . c of three vectors, shape (3,) each."""
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    return float(x * c[0] + y * c[1] + z * c[2])


@kernel
def window_of(triangle: NDArray[np.int32], per_px: int) -> Window:
    """Return the pixels at most ``SKY_PX`` from the target; those at a corner of the image if none shows it.

    Args:
        triangle: triangle that each ray meets, -1 for none, shape (per_px * rows, per_px * columns).
        per_px: number of rays for each pixel, along rows and columns.
    """
    rows, columns = triangle.shape
    top, bottom, left, right = rows, 0, columns, 0
    for v in range(rows):
        line, most = triangle[v], np.int32(-1)
        for u in range(columns):
            most = max(most, line[u])
        if most < 0:
            continue
        top, bottom, begin, end = min(top, v), v + 1, 0, columns
        while begin < left and line[begin] < 0:
            begin += 1
        while end > right and line[end - 1] < 0:
            end -= 1
        left, right = min(left, begin), max(right, end)
    if bottom == 0:
        top, left = 0, 0
    row, column = max(top // per_px - SKY_PX, 0), max(left // per_px - SKY_PX, 0)
    below = min((bottom - 1) // per_px + 1 + SKY_PX, rows // per_px)
    beside = min((right - 1) // per_px + 1 + SKY_PX, columns // per_px)
    return Window(row, column, below - row, beside - column)
