"""The target's wireframe as a sensor sees it: hidden lines left out, drawn as SVG paths."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Camera
from rpod_sim_sensor.geometry import RayGrid, cast
from rpod_target import Target

_PIECES = 12
"""Parts of an edge that are hidden or seen as a whole."""
_NEAR_M = 0.05
_SLACK_M = 0.02
"""An edge lies on its own faces; a surface hides it only from this much in front."""


def visible_pieces(target: Target, T_sensor_target: RigidTransform) -> FloatArray:
    """Return the pieces of the wireframe that are seen, sensor axes, shape (N, 2, 3)."""
    centres = T_sensor_target.apply(target.edges_m.mean(axis=1))
    normals = np.einsum("ij,enj->eni", T_sensor_target.rotation.as_matrix(), target.edge_normals)
    facing = (np.einsum("eni,ei->en", normals, centres) < 0.0).any(axis=1)
    ends = T_sensor_target.apply(target.edges_m[facing].reshape(-1, 3)).reshape(-1, 2, 3)
    knots = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    points = ends[:, None, 0] + knots * (ends[:, None, 1] - ends[:, None, 0])
    pieces: FloatArray = np.stack([points[:, :-1], points[:, 1:]], axis=2)
    pieces = pieces[(points[:, :, 2] > _NEAR_M).all(axis=1)]
    return pieces[_seen(pieces.mean(axis=2), target, T_sensor_target)] if len(pieces) else pieces[:, 0]


def _seen(points: FloatArray, target: Target, T_sensor_target: RigidTransform) -> NDArray[np.bool_]:
    """Return which points, shape (rows, columns, 3), no surface hides: one ray to each."""
    distance_m = np.linalg.norm(points, axis=-1)
    grid = RayGrid(np.ascontiguousarray(np.moveaxis(points / distance_m[..., None], -1, 0)))
    seen: NDArray[np.bool_] = cast(grid, target.triangles_m, T_sensor_target).range_m > distance_m - _SLACK_M
    return seen


def project(points_m: FloatArray, camera: Camera | None) -> FloatArray:
    """Return image coordinates, shape (..., 2): a camera's pixels, else x/z and y/z in thousandths."""
    flat = points_m.reshape(-1, 3)
    if camera is None or not len(flat):
        return (1e3 * flat[:, :2] / flat[:, 2:]).reshape(*points_m.shape[:-1], 2)
    image, _ = cv2.projectPoints(flat, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    return np.asarray(image, np.float64).reshape(*points_m.shape[:-1], 2)


def svg_path(segments: FloatArray) -> str:
    """Return the path data of segments, shape (N, 2, 2); those that follow each other are joined."""
    parts: list[str] = []
    last = ""
    for start, end in segments:
        begin, finish = f"{start[0]:.1f} {start[1]:.1f}", f"{end[0]:.1f} {end[1]:.1f}"
        parts.append(f"L{finish}" if begin == last else f"M{begin}L{finish}")
        last = finish
    return "".join(parts)
