"""The loop over the templates of on-line template matching, compiled: cast, centre, compare, correlate.

The correlation needs each scan point's nearest template point, in single precision. Both are packed in small
blocks with bounding boxes; pairs of blocks are passed over where the boxes are farther apart than what was
found. Differences, squares and sums are rounded monotonically, so the squares are those of all pairs exactly.
"""

import numpy as np
from numba import njit

from rpod_geometry.rays import cast_pose
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

BLOCK = 32
"""Scan points in a block: a few vector registers."""
SEGMENT = 8
"""Most template points in a block, neighbours in one row of the scan pattern."""


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


@njit(cache=True, nogil=True, error_model="numpy")
def match_templates(grid, triangles, rotations, centroid, scan, scan_count, spread, tau, best_only):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return what each template is like: mean squared distance, centroid and spread about the boresight.

    Args:
        grid: ``RayGrid.arrays``.
        triangles: target axes, shape (T, 3, 3), closed.
        rotations: of the target in the sensor, shape (K, 3, 3).
        centroid: of the scan, where the target is put, shape (3,), m.
        scan: ``packed`` points of the scan about its centroid.
        scan_count: number of points.
        spread: D_BOR of the scan, m (Eq. 2).
        tau: templates whose D_BOR differs by a larger share are not correlated (Eq. 3).
        best_only: give a template up as soon as it is worse than the best before it.

    Returns:
        C of Eq. 1, m2, shape (K,), inf where not correlated or given up; centroids, shape (K, 3), m;
        D_BOR, shape (K,), m, NaN for a template without any point.
    """
    rows, columns = grid[0].shape[1:]
    range_m, triangle = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.int32)
    points, ends = np.empty((rows * columns, 3)), np.empty(rows * columns, np.int64)
    template, box = (
        np.empty((rows * columns, 3, SEGMENT), np.float32),
        np.empty((6, rows * columns), np.float32),
    )
    scan_box, gaps = _scan_boxes(scan), np.empty(rows * columns, np.float32)
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
        for block in range(scan.shape[0]):
            if total > limit:
                break
            _gaps(scan_box[block], box, gaps[:segments])
            _nearest_squares(scan[block], template, gaps[:segments], nearest)
            for n in range(min(BLOCK, scan_count - block * BLOCK)):
                total += nearest[n]
        if total <= limit:
            costs[k] = total / scan_count
            limit = total if best_only else limit
    return costs, centroids, spreads


@njit(cache=True, nogil=True, error_model="numpy")
def cast_covariances(grid, triangles, rotations, position):  # type: ignore[no-untyped-def]
    """Return the covariances of the templates' points, shape (K, 3, 3), m2; zero where there is none.

    Arguments as those of ``match_templates``, the target at ``position``.
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


@njit(cache=True, nogil=True)
def _collect(rays, range_m, triangle, points, ends):  # type: ignore[no-untyped-def]
    """Fill in the hits' points, row by row, and the ends of the segments; return the numbers of both."""
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


@njit(cache=True, nogil=True)
def _spread(points, size, centroid):  # type: ignore[no-untyped-def]
    """Fill in the centroid of a template's points; return D_BOR (Eq. 2)."""
    spread = 0.0
    centroid[:] = 0.0
    for m in range(size):
        spread += np.sqrt(points[m, 0] ** 2 + points[m, 1] ** 2)
        for axis in range(3):
            centroid[axis] += points[m, axis]
    centroid /= size
    return spread / size


@njit(cache=True, nogil=True)
def _scan_boxes(scan):  # type: ignore[no-untyped-def]
    """Return least and greatest coordinates of each block of a packed scan, shape (blocks, 6)."""
    boxes = np.empty((scan.shape[0], 6), np.float32)
    for block in range(scan.shape[0]):
        for axis in range(3):
            boxes[block, axis] = scan[block, axis].min()
            boxes[block, 3 + axis] = scan[block, axis].max()
    return boxes


@njit(cache=True, nogil=True)
def _pack(points, centroid, ends, template, box):  # type: ignore[no-untyped-def]
    """Fill in the segments about the centroid, their last points repeated, and their boxes, (6, segments)."""
    for segment in range(ends.size):
        start, end = ends[segment - 1] if segment else 0, ends[segment]
        for axis in range(3):
            least, greatest = np.float32(np.inf), np.float32(-np.inf)
            for m in range(SEGMENT):
                value = np.float32(points[min(start + m, end - 1), axis] - centroid[axis])
                template[segment, axis, m] = value
                least, greatest = min(least, value), max(greatest, value)
            box[axis, segment], box[3 + axis, segment] = least, greatest


@njit(cache=True, nogil=True)
def _gaps(scan_box, box, gaps):  # type: ignore[no-untyped-def]
    """Fill in the squared distances from a block's box to those of the segments."""
    zero = np.float32(0.0)
    for segment in range(gaps.size):
        gap = zero
        for axis in range(3):
            above, below = box[axis, segment] - scan_box[3 + axis], scan_box[axis] - box[3 + axis, segment]
            apart = above if above > below else below
            apart = apart if apart > zero else zero
            gap += apart * apart
        gaps[segment] = gap


@njit(cache=True, nogil=True)
def _nearest_squares(points, template, gaps, nearest):  # type: ignore[no-untyped-def]
    """Fill in the squared distances of points, shape (3, BLOCK), to their nearest in the template."""
    closest = 0
    for segment in range(1, gaps.size):
        if gaps[segment] < gaps[closest]:
            closest = segment
    nearest[:] = np.inf
    farthest = _add_segment(points, template[closest], nearest)
    for segment in range(gaps.size):
        if gaps[segment] < farthest and segment != closest:
            farthest = _add_segment(points, template[segment], nearest)


@njit(cache=True, nogil=True, fastmath={"nnan", "nsz"})  # so that the largest is found by vectors
def _add_segment(points, segment, nearest):  # type: ignore[no-untyped-def]
    """Lower the squared distances where a segment, shape (3, SEGMENT), is nearer; return the largest."""
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
    return farthest
