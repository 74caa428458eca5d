"""Casting of rays at a detailed mesh: triangles between the rays are passed over in a few nanoseconds.

Seen by a scanning LIDAR, most triangles of a detailed mesh lie between the rays. ``rays`` looks up the rows
and columns of each triangle from its three corners. But a corner belongs to about six triangles. Here each
corner is looked up once, in a fine table of the rows and columns. Triangles that lie between two rows or two
columns by this table are left out; all others are drawn as ``rays`` does. The results are the same to the
bit.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.drawing import TOGETHER, Face, draw, fill_half_planes, fill_sides, fill_spans, volume_of
from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.lines import Lines, end_line, finer_lines_of, first_line, slopes_of
from rpod_geometry.rays import GridArrays
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

PER_LINE = 16
"""Number of entries of a table of rows or columns for each of them. Numerics: measured times; with more
entries, fewer triangles are kept in vain, and the table takes longer to fill."""


class SharedCorners(NamedTuple):
    """Corners of a mesh, each listed once."""

    corners_m: FloatArray
    """Corners, target axes, shape (3, V)."""
    of_triangle: NDArray[np.int32]
    """Indices of each triangle's corners, shape (T, 3)."""


def shared_corners(triangles_m: FloatArray) -> SharedCorners:
    """Return the corners of triangles, shape (T, 3, 3); equal ones, to the bit, are one."""
    corners_m, index = np.unique(triangles_m.reshape(-1, 3), axis=0, return_inverse=True)
    return SharedCorners(np.ascontiguousarray(corners_m.T), index.reshape(-1, 3).astype(np.int32))


@kernel
def cast_shared(  # noqa: PLR0917
    grid: GridArrays,
    shared: SharedCorners,
    R: FloatArray,
    t: FloatArray,
    range_m: Float32Array,
    triangle: NDArray[np.int32],
) -> None:
    """Fill ``range_m`` and ``triangle`` like ``rays.cast_pose`` with back faces culled.

    Args:
        grid: ``RayGrid.arrays``.
        shared: corners of the target.
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        range_m: output, shape (rows, columns), m.
        triangle: output, shape (rows, columns).
    """
    columns = finer_lines_of(grid.column_lower, grid.column_upper, PER_LINE)
    rows = finer_lines_of(grid.row_lower, grid.row_upper, PER_LINE)
    range_m[:], triangle[:] = 0.0, -1
    rays, spans = grid.components, np.empty((triangle.shape[0], 2), np.uint64)
    few = TOGETHER if max(columns.reach, rows.reach) < np.inf else rays.shape[2]
    corner, side, half_planes = np.empty((3, 3)), np.empty((3, 3), rays.dtype), np.empty((3, 4))
    of_triangle, place_m = shared.of_triangle, _places(shared.corners_m, R, t)
    across, down = _entries(place_m[0], place_m[2], columns), _entries(place_m[1], place_m[2], rows)
    for n in range(of_triangle.shape[0]):
        a, b, c = of_triangle[n, 0], of_triangle[n, 1], of_triangle[n, 2]
        least, most = min(down[a], down[b], down[c]), max(down[a], down[b], down[c])
        if least >= 0 and rows.first[least] >= rows.last[most]:
            continue
        least, most = min(across[a], across[b], across[c]), max(across[a], across[b], across[c])
        if least >= 0 and columns.first[least] >= columns.last[most]:
            continue
        for k in range(3):
            corner[0, k], corner[1, k], corner[2, k] = place_m[k, a], place_m[k, b], place_m[k, c]
        volume = volume_of(corner)
        if not volume < 0.0:  # seen from behind, or edge-on
            continue
        lowest, highest = slopes_of(corner, 1)
        first, end = first_line(rows, lowest), end_line(rows, highest)
        lowest, highest = slopes_of(corner, 0)
        begin, stop = first_line(columns, lowest), end_line(columns, highest)
        if first < end and begin < stop:
            fill_sides(corner, -1.0, side)
            face = Face(n, -1.0 / volume, first, end, begin, stop)
            if stop - begin > few:
                fill_half_planes(side, columns.reach, rows.reach, half_planes)
                fill_spans(rows, columns, half_planes, face, spans)
            else:
                spans[first:end, 0], spans[first:end, 1] = begin, stop
            draw(rays, side, face, spans, range_m, triangle)
    range_m[:] = 1.0 / range_m


@inner_kernel
def _places(corners_m: FloatArray, R: FloatArray, t: FloatArray) -> FloatArray:
    """Return corners in sensor axes, shape (3, V), m.

    Args:
        corners_m: target axes, shape (3, V).
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
    """
    place_m = np.empty(corners_m.shape)
    for n in range(corners_m.shape[1]):
        x, y, z = corners_m[0, n], corners_m[1, n], corners_m[2, n]
        for k in range(3):
            place_m[k, n] = t[k] + R[k, 0] * x + R[k, 1] * y + R[k, 2] * z
    return place_m


@inner_kernel
def _entries(along_m: FloatArray, ahead_m: FloatArray, lines: Lines) -> NDArray[np.int32]:
    """Return the entries of a table of lines that hold the slopes of corners, -1 behind the sensor, (V,).

    Args:
        along_m: x or y of the corners, sensor axes, shape (V,).
        ahead_m: their z, shape (V,).
        lines: the table.
    """
    entries, most = np.empty(along_m.size, np.int32), lines.first.size - 3.0
    for n in range(along_m.size):
        place = (along_m[n] / ahead_m[n] - lines.start) * lines.per_slope
        entries[n] = np.int32(min(max(0.0, place), most) if ahead_m[n] > 0.0 else -1.0)
    return entries
