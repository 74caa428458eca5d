"""Fewer triangles for a large mesh, within a bound on the error that is measured afterwards.

Edges are collapsed by quadrics (M. Garland, P. Heckbert, Surface simplification using quadric error metrics,
SIGGRAPH 1997; by meshoptimizer). The method's own error is no bound, so the result is measured against the
file's surface, in both directions, and more triangles are kept until it is within the limit.
"""

from collections.abc import Sequence

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh.topology import Indices, welded
from rpod_target.visibility import as_tensor, scene_of

ENOUGH = 20_000
"""Number of triangles above which a mesh is simplified: an emulated sensor examines all of them in each
frame."""
_STEPS = (ENOUGH, 50_000, 120_000, 300_000)
_PLACES = 200_000
"""Number of places of each surface whose distance from the other one is measured."""


def simplified(
    triangles: FloatArray, *, largest_error: float, steps: Sequence[int] = _STEPS
) -> tuple[FloatArray, Indices, tuple[int, int, float] | None]:
    """Return fewer triangles in place of others, within an error.

    Args:
        triangles: corners, shape (T, 3, 3).
        largest_error: largest distance between the two surfaces, in the triangles' unit.
        steps: numbers of triangles that are tried, smallest first. A mesh of no more than the first stays.

    Returns:
        Triangles, shape (S, 3, 3); for each, the index of the triangle that it replaces, shape (S,); and,
        if they are not the same, their number, T and the measured distance.
    """
    same = np.arange(len(triangles))
    if len(triangles) <= steps[0]:
        return triangles, same, None
    for count in steps:
        if count >= len(triangles):
            break
        result = _collapsed(triangles, count=count, error=1.0)
        error, nearest = _compare(triangles, result)
        if error <= largest_error:
            return result, nearest, (len(result), len(triangles), error)
    return triangles, same, None


def coarser(triangles: FloatArray, *, error: float) -> tuple[FloatArray, Indices]:
    """Return as few triangles as possible in place of others, with about a given error, in their unit.

    Returns:
        Triangles, shape (S, 3, 3), and for each the index of the triangle that it replaces, shape (S,).
    """
    size = float(np.ptp(triangles, axis=(0, 1)).max())
    result = _collapsed(triangles, count=4, error=error / size)
    return result, _compare(triangles, result)[1]


def _collapsed(triangles: FloatArray, *, count: int, error: float) -> FloatArray:
    """Return triangles after the collapse of edges, down to a number or up to an error over their size."""
    import meshoptimizer  # noqa: PLC0415 - few meshes need it

    index = welded(triangles)
    corners = np.empty((int(index.max()) + 1, 3))
    corners[index.ravel()] = triangles.reshape(-1, 3)
    single = np.ascontiguousarray((corners - corners.mean(axis=0)).astype(np.float32))
    faces = index[(index != np.roll(index, -1, axis=1)).all(axis=1)].astype(np.uint32)
    chosen = np.empty(faces.size, np.uint32)
    kept = meshoptimizer.simplify(
        chosen, faces.ravel(), single, target_index_count=3 * count, target_error=error
    )
    collapsed: FloatArray = corners[chosen[:kept].reshape(-1, 3)]
    return collapsed


def _compare(triangles: FloatArray, result: FloatArray) -> tuple[float, Indices]:
    """Return the greatest distance between two surfaces, and the triangle nearest to each of the second's."""
    scene, simple = scene_of(triangles), scene_of(result)
    corners = triangles.reshape(-1, 3)[:: max(1, 3 * len(triangles) // _PLACES)]
    there = float(simple.compute_distance(as_tensor(corners)).numpy().max())
    weights = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]], float)
    weights /= weights.sum(axis=1, keepdims=True)
    some = result[:: max(1, 4 * len(result) // _PLACES)]
    places = np.einsum("kc,tcd->tkd", weights, some).reshape(-1, 3)
    back = float(scene.compute_distance(as_tensor(places)).numpy().max())
    found = scene.compute_closest_points(as_tensor(result.mean(axis=1)))["primitive_ids"].numpy()
    return max(there, back), found.astype(np.int64)
