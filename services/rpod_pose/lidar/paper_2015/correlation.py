"""The compiled loop over the templates of on-line template matching: cast, centre, compare, correlate.

The correlation needs each scan point's nearest template point, in single precision. Both sets are packed in
small blocks with bounding boxes; a pair of blocks is skipped if its boxes are farther apart than the nearest
points so far. Differences, squares and sums are rounded monotonically, so that the results are exactly those
of a comparison of all pairs.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel, reassociated_kernel
from rpod_geometry.rays import GridArrays, cast_pose
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

BLOCK = 32
"""Number of scan points in a block. Numerics: a few vector registers."""
SEGMENT = 8
"""Largest number of template points in a block; they are neighbours in one row of the scan pattern.
Numerics: one vector register of single precision."""


class PackedScan(NamedTuple):
    """A scan, as the kernels take it."""

    centroid_m: FloatArray
    """Centroid of the scan, sensor axes, shape (3,)."""
    blocks_m: Float32Array
    """``packed`` points about the centroid, shape (blocks, 3, BLOCK)."""
    points: int
    """Number of points."""
    spread_m: float
    """Mean distance D_BOR from the boresight (Eq. 2)."""


class Correlation(NamedTuple):
    """Comparison of a scan with each of K templates."""

    costs_m2: FloatArray
    """Costs C of Eq. 1, shape (K,); inf for a template that was not correlated or was abandoned."""
    centroids_m: FloatArray
    """Centroids of the templates' points, shape (K, 3)."""
    spreads_m: FloatArray
    """Mean distances D_BOR from the boresight, shape (K,), NaN for a template without any point."""


def packed(points_m: FloatArray) -> Float32Array:
    """Return points, shape (N, 3), as kernels take them: close ones together, shape (blocks, 3, BLOCK).

    The last point fills up the last block. They are sorted into strips by y, and in each strip by x.
    """
    count = len(points_m)
    strip = BLOCK * max(1, round(np.sqrt(count / BLOCK)))
    by_y = np.argsort(points_m[:, 1], kind="stable")
    strips = [by_y[start : start + strip] for start in range(0, count, strip)]
    order = np.concatenate([rows[np.argsort(points_m[rows, 0], kind="stable")] for rows in strips])
    order = np.append(order, np.full(-count % BLOCK, order[-1]))
    blocks = points_m[order].astype(np.float32).reshape(-1, BLOCK, 3)
    return np.ascontiguousarray(blocks.swapaxes(1, 2))


@kernel
def match_templates(  # noqa: PLR0917
    grid: GridArrays,
    triangles: FloatArray,
    rotations: FloatArray,
    scan: PackedScan,
    tau: float,
    best_only: bool,
) -> Correlation:
    """Return the mean squared distance, centroid and spread about the boresight of each template.

    Args:
        grid: ``RayGrid.arrays``.
        triangles: target axes, shape (T, 3, 3), closed.
        rotations: R_sensor_target of the templates, shape (K, 3, 3).
        scan: the scan; the target is placed at its centroid.
        tau: templates whose D_BOR differs by a larger share are not correlated (Eq. 3).
        best_only: whether to abandon a template as soon as it is worse than the best before it.
    """
    centroid, blocks, scan_count, spread = scan
    rows, columns = grid[0].shape[1:]
    range_m, triangle = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.int32)
    points, ends = np.empty((rows * columns, 3)), np.empty(rows * columns, np.int64)
    template, box = (
        np.empty((rows * columns, 3, SEGMENT), np.float32),
        np.empty((6, rows * columns), np.float32),
    )
    scan_box, gaps = _scan_boxes(blocks), np.empty(rows * columns, np.float32)
    nearest = np.empty(BLOCK, np.float32)
    count = rotations.shape[0]
    costs, centroids, spreads = np.full(count, np.inf), np.zeros((count, 3)), np.full(count, np.nan)
    limit = np.inf
    for k in range(count):
        cast_pose(grid, triangles, rotations[k], centroid, True, range_m, triangle)
        size, segments = _collect(grid[0], range_m, triangle, points, ends)
        if size == 0:
            continue
        spreads[k] = _spread(points, size, centroids[k])
        if abs(spread - spreads[k]) > tau * spread:
            continue
        _pack(points, centroids[k], ends[:segments], template, box)
        total = 0.0
        for block in range(blocks.shape[0]):
            if total > limit:
                break
            _gaps(scan_box[block], box, gaps[:segments])
            _nearest_squares(blocks[block], template, gaps[:segments], nearest)
            for n in range(min(BLOCK, scan_count - block * BLOCK)):
                total += nearest[n]
        if total <= limit:
            costs[k] = total / scan_count
            limit = total if best_only else limit
    return Correlation(costs, centroids, spreads)


@kernel
def cast_covariances(
    grid: GridArrays, triangles: FloatArray, rotations: FloatArray, position: FloatArray
) -> FloatArray:
    """Return the covariances of the templates' points, shape (K, 3, 3), m2; zero for one without points.

    The arguments are as in ``match_templates``; the target is at ``position``, shape (3,), m.
    """
    rows, columns = grid[0].shape[1:]
    range_m, triangle = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.int32)
    points, ends, centroid = np.empty((rows * columns, 3)), np.empty(rows * columns, np.int64), np.empty(3)
    covariances = np.zeros((rotations.shape[0], 3, 3))
    for k in range(rotations.shape[0]):
        cast_pose(grid, triangles, rotations[k], position, True, range_m, triangle)
        size, _ = _collect(grid[0], range_m, triangle, points, ends)
        if size:
            _spread(points, size, centroid)
            about = points[:size] - centroid
            covariances[k] = about.T @ about / size
    return covariances


@inner_kernel
def _collect(
    rays: FloatArray,
    range_m: Float32Array,
    triangle: NDArray[np.int32],
    points: FloatArray,
    ends: NDArray[np.int64],
) -> tuple[int, int]:
    """Fill the points of the hits, row by row, and the ends of the segments; return the numbers of both.

    Args:
        rays: unit rays, shape (3, rows, columns).
        range_m: ranges of the hits, shape (rows, columns).
        triangle: triangles of the hits, -1 for none, same shape.
        points: output, shape (rows columns, 3), m.
        ends: output, index after the last point of each segment, shape (rows columns,).
    """
    size, segments = 0, 0
    for row in range(range_m.shape[0]):
        start = size
        for column in range(range_m.shape[1]):
            if triangle[row, column] < 0:
                continue
            if size - start == SEGMENT:
                ends[segments] = start = size
                segments += 1
            for axis in range(3):
                points[size, axis] = rays[axis, row, column] * range_m[row, column]
            size += 1
        if size > start:
            ends[segments] = size
            segments += 1
    return size, segments


@inner_kernel
def _spread(points: FloatArray, size: int, centroid: FloatArray) -> float:
    """Fill the centroid, shape (3,), of the first points, shape (N, 3); return D_BOR (Eq. 2); m."""
    spread = 0.0
    centroid[:] = 0.0
    for m in range(size):
        spread += np.sqrt(points[m, 0] ** 2 + points[m, 1] ** 2)
        for axis in range(3):
            centroid[axis] += points[m, axis]
    centroid /= size
    return spread / size


@inner_kernel
def _scan_boxes(scan: Float32Array) -> Float32Array:
    """Return least and greatest coordinates of each block of a packed scan, shape (blocks, 6)."""
    boxes = np.empty((scan.shape[0], 6), np.float32)
    for block in range(scan.shape[0]):
        for axis in range(3):
            boxes[block, axis] = scan[block, axis].min()
            boxes[block, 3 + axis] = scan[block, axis].max()
    return boxes


@inner_kernel
def _pack(
    points: FloatArray,
    centroid: FloatArray,
    ends: NDArray[np.int64],
    template: Float32Array,
    box: Float32Array,
) -> None:
    """Fill the segments about the centroid, padded with their last points, and their boxes.

    Args:
        points: points of the template, shape (N, 3), m.
        centroid: centroid of the points, shape (3,), m.
        ends: index after the last point of each segment, shape (segments,).
        template: output, shape (segments, 3, SEGMENT), m.
        box: output, least and greatest coordinates, shape (6, segments), m.
    """
    for segment in range(ends.size):
        start, end = ends[segment - 1] if segment else 0, ends[segment]
        for axis in range(3):
            least, greatest = np.float32(np.inf), np.float32(-np.inf)
            for m in range(SEGMENT):
                value = np.float32(points[min(start + m, end - 1), axis] - centroid[axis])
                template[segment, axis, m] = value
                least, greatest = min(least, value), max(greatest, value)
            box[axis, segment], box[3 + axis, segment] = least, greatest


@inner_kernel
def _gaps(scan_box: Float32Array, box: Float32Array, gaps: Float32Array) -> None:
    """Fill the squared distances, (segments,), m2, from a box, (6,), to the segments', (6, segments)."""
    zero = np.float32(0.0)
    for segment in range(gaps.size):
        gap = zero
        for axis in range(3):
            above, below = box[axis, segment] - scan_box[3 + axis], scan_box[axis] - box[3 + axis, segment]
            apart = above if above > below else below
            apart = apart if apart > zero else zero
            gap += apart * apart
        gaps[segment] = gap


@inner_kernel
def _nearest_squares(
    points: Float32Array, template: Float32Array, gaps: Float32Array, nearest: Float32Array
) -> None:
    """Fill the squared distances of points to their nearest points in the template.

    Args:
        points: points of the scan, shape (3, BLOCK), m.
        template: points of the template, shape (segments, 3, SEGMENT), m.
        gaps: squared distances of the segments' boxes from that of the points, shape (segments,), m2.
        nearest: output, shape (BLOCK,), m2.
    """
    closest = 0
    for segment in range(1, gaps.size):
        if gaps[segment] < gaps[closest]:
            closest = segment
    nearest[:] = np.inf
    farthest = _add_segment(points, template[closest], nearest)
    for segment in range(gaps.size):
        if gaps[segment] < farthest and segment != closest:
            farthest = _add_segment(points, template[segment], nearest)


@reassociated_kernel
def _add_segment(points: Float32Array, segment: Float32Array, nearest: Float32Array) -> float:
    """Reduce the squared distances to those of a nearer segment, shape (3, SEGMENT); return the largest."""
    x, y, z = points[0], points[1], points[2]
    for m in range(0, SEGMENT, 4):  # four at a time, for as few loads and stores
        a0, b0, c0, d0 = segment[0, m], segment[0, m + 1], segment[0, m + 2], segment[0, m + 3]
        a1, b1, c1, d1 = segment[1, m], segment[1, m + 1], segment[1, m + 2], segment[1, m + 3]
        a2, b2, c2, d2 = segment[2, m], segment[2, m + 1], segment[2, m + 2], segment[2, m + 3]
        for n in range(BLOCK):
            a = (x[n] - a0) ** 2 + (y[n] - a1) ** 2 + (z[n] - a2) ** 2
            b = (x[n] - b0) ** 2 + (y[n] - b1) ** 2 + (z[n] - b2) ** 2
            c = (x[n] - c0) ** 2 + (y[n] - c1) ** 2 + (z[n] - c2) ** 2
            d = (x[n] - d0) ** 2 + (y[n] - d1) ** 2 + (z[n] - d2) ** 2
            a, c = a if a < b else b, c if c < d else d
            a = a if a < c else c
            nearest[n] = a if a < nearest[n] else nearest[n]
    farthest = nearest[0]
    for n in range(1, BLOCK):
        farthest = nearest[n] if nearest[n] > farthest else farthest
    return farthest  # type: ignore[no-any-return]
