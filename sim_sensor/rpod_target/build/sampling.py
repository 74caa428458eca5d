"""Even samples of a surface: cells of equal area, rounded by Lloyd's algorithm.

Source: S. P. Lloyd, Least squares quantization in PCM, IEEE Trans. Inf. Theory 28 (1982).
The candidates are a low-discrepancy sequence, not random, so that the cells are equal.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh.topology import Indices, areas_m2, unit_normals

_CANDIDATES_A_POINT = 32
_ROUNDS = 6
_APART = 3.0
"""Weight of the normals, in pitches, while cells are halved, so that opposite faces are separated early."""
_PLASTIC = 1.32471795724474602596
"""Root of x^3 = x + 1: its powers give the most even additive sequence known in the plane (Roberts, 2018)."""


def sample_evenly(
    triangles_m: FloatArray, count: int, *, hidden: Callable[[FloatArray, FloatArray], NDArray[np.bool_]]
) -> tuple[FloatArray, FloatArray]:
    """Return about ``count`` points on the surface and their normals, shapes (N, 3); deterministic.

    Each point represents an equal share of the area where ``hidden(points, normals)`` is false. Cells are
    formed in position and normal, so that no cell covers both faces of a thin panel.
    """
    points_m, triangle = spread_over(triangles_m, _CANDIDATES_A_POINT * count)
    normals = unit_normals(triangles_m)[triangle]
    seen = ~hidden(points_m, normals)
    points_m, normals = points_m[seen], normals[seen]
    pitch_m = np.sqrt(areas_m2(triangles_m).sum() / count)
    lifted = np.hstack([points_m, pitch_m * normals])
    apart = np.hstack([points_m, _APART * pitch_m * normals])
    cells = _equal_cells(apart, np.arange(len(apart)), min(count, len(apart)))
    chosen = np.unique(_lloyd(np.stack([lifted[cell].mean(axis=0) for cell in cells]), lifted))
    return points_m[chosen], normals[chosen]


def spread_over(triangles_m: FloatArray, count: int) -> tuple[FloatArray, Indices]:
    """Return points of uniform density, shape (count, 3), and the triangle of each, shape (count,)."""
    cumulative = np.cumsum(areas_m2(triangles_m))
    number = np.arange(count) + 0.5
    triangle = np.searchsorted(cumulative, number / count * cumulative[-1])
    u, v = np.mod(number / _PLASTIC, 1.0), np.mod(number / _PLASTIC**2, 1.0)
    folded = u + v > 1.0  # points in the half of the unit square outside the triangle
    u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
    weights = np.stack([1.0 - u - v, u, v], axis=1)
    return np.einsum("nc,ncd->nd", weights, triangles_m[triangle]), triangle


def _equal_cells(points: FloatArray, members: Indices, count: int) -> list[Indices]:
    """Split members of points, shape (M, D), into compact cells of equal size by halving the longest side."""
    if count == 1:
        return [members]
    longest = np.argmax(np.ptp(points[members], axis=0))
    members = members[np.argsort(points[members, longest], kind="stable")]
    cut = round(len(members) * (count // 2) / count)
    halves = (members[:cut], count // 2), (members[cut:], count - count // 2)
    return [cell for half, share in halves for cell in _equal_cells(points, half, share)]


def _lloyd(means: FloatArray, points: FloatArray) -> Indices:
    """Return the points, among (M, D), nearest to the centres of their cells, from first centres, (N, D).

    The centres are points of the surface in every round, so that a cell across an edge moves to one side.
    """
    tree = cKDTree(points)
    for _ in range(_ROUNDS):
        centres = points[tree.query(means)[1]]
        _, cell = cKDTree(centres).query(points)
        size = np.bincount(cell, minlength=len(centres))[:, None]
        sums = [np.bincount(cell, weights=column, minlength=len(centres)) for column in points.T]
        means = np.where(size > 0, np.stack(sums, axis=1) / np.maximum(size, 1), centres)
    return np.asarray(tree.query(means)[1], np.int64)
