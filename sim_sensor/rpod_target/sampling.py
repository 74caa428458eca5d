"""Even samples of a surface: centroidal Voronoi cells (Lloyd, IEEE Trans. Inf. Theory 28, 1982)."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rpod_schemas.arrays import FloatArray
from rpod_target.topology import areas_m2, unit_normals

_SEED = 2018
_CANDIDATES_A_POINT = 16
_ROUNDS = 12


def sample_evenly(
    triangles_m: FloatArray, count: int, *, hidden: Callable[[FloatArray, FloatArray], NDArray[np.bool_]]
) -> tuple[FloatArray, FloatArray]:
    """Return about ``count`` points on the surface and their normals, shapes (N, 3), always the same ones.

    Each point stands for an equal share of the area that ``hidden(points, normals)`` leaves. Cells are
    formed in position and normal, so that the two faces of a thin panel do not share one.
    """
    rng = np.random.default_rng(_SEED)
    points_m, normals = _scatter(triangles_m, _CANDIDATES_A_POINT * count, rng)
    seen = ~hidden(points_m, normals)
    points_m, normals = points_m[seen], normals[seen]
    pitch_m = np.sqrt(areas_m2(triangles_m).sum() / count)
    candidates = np.hstack([points_m, pitch_m * normals])
    count = min(count, len(candidates))
    centres = candidates[rng.choice(len(candidates), count, replace=False)]
    for _ in range(_ROUNDS):
        _, cell = cKDTree(centres).query(candidates)
        size = np.bincount(cell, minlength=count)[:, None]
        sums = np.stack(
            [np.bincount(cell, weights=column, minlength=count) for column in candidates.T], axis=1
        )
        centres = np.where(size > 0, sums / np.maximum(size, 1), centres)
    _, chosen = cKDTree(candidates).query(centres)
    chosen = np.unique(chosen)
    return points_m[chosen], normals[chosen]


def _scatter(triangles_m: FloatArray, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Points of uniform density: systematic over the triangles, random within each (shapes (count, 3))."""
    cumulative = np.cumsum(areas_m2(triangles_m))
    position = (np.arange(count) + rng.random(count)) / count * cumulative[-1]
    triangle = np.minimum(np.searchsorted(cumulative, position), len(triangles_m) - 1)
    root, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1.0 - root, root * (1.0 - v), root * v], axis=1)
    points_m = np.einsum("nc,ncd->nd", weights, triangles_m[triangle])
    return points_m, unit_normals(triangles_m)[triangle]
