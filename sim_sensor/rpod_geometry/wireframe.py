"""The target's wireframe as a sensor sees it, without hidden lines."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.lens import distort
from rpod_geometry.rays import NEAREST_M, RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Camera
from rpod_target import Target

_PIECES = 12
"""Number of pieces of an edge; each is hidden or visible as a whole."""
_SLACK_M = 0.02
"""Least distance between a surface and an edge behind it that it hides: an edge lies on its own faces."""


def visible_pieces(target: Target, T_sensor_target: RigidTransform) -> FloatArray:
    """Return the visible pieces of the wireframe, sensor axes, shape (N, 2, 3), m."""
    centres = T_sensor_target.apply(target.edges_m.mean(axis=1))
    normals = np.einsum("ij,enj->eni", T_sensor_target.rotation.as_matrix(), target.edge_normals)
    facing = (np.einsum("eni,ei->en", normals, centres) < 0.0).any(axis=1)
    ends = T_sensor_target.apply(target.edges_m[facing].reshape(-1, 3)).reshape(-1, 2, 3)
    knots = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    points = ends[:, None, 0] + knots * (ends[:, None, 1] - ends[:, None, 0])
    pieces: FloatArray = np.stack([points[:, :-1], points[:, 1:]], axis=2)
    pieces = pieces[(points[:, :, 2] > NEAREST_M).all(axis=1)]
    return pieces[_seen(pieces.mean(axis=2), target, T_sensor_target)] if len(pieces) else pieces[:, 0]


def _seen(points: FloatArray, target: Target, T_sensor_target: RigidTransform) -> NDArray[np.bool_]:
    """Return which points, shape (rows, columns, 3), are visible, by one ray to each, (rows, columns)."""
    distance_m = np.linalg.norm(points, axis=-1)
    grid = RayGrid(np.ascontiguousarray(np.moveaxis(points / distance_m[..., None], -1, 0)))
    seen: NDArray[np.bool_] = cast(grid, target.triangles_m, T_sensor_target).range_m > distance_m - _SLACK_M
    return seen


def project(points_m: FloatArray, camera: Camera | None) -> FloatArray:
    """Return image coordinates, shape (..., 2): a camera's pixels, or x/z and y/z in thousandths."""
    slopes = np.moveaxis(points_m[..., :2] / points_m[..., 2:], -1, 0)
    if camera is None:
        return 1e3 * np.moveaxis(slopes, 0, -1)
    x, y = distort(slopes, camera)
    return np.stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy], axis=-1)
