"""The wireframe in an image: which samples show, where each lies, and what that says of the pose.

From a sample's projection the image is searched along the edge's normal for the steepest change, nearer ones
preferred. The distance found is the residual (after T. Drummond, R. Cipolla, Real-Time Visual Tracking of
Complex Structures, IEEE PAMI 24(7), 2002).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import RigidTransform

from rpod_geometry.wireframe import project, visible_pieces
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Camera, Float32Array
from rpod_target import Target

_STEP_M = 1e-5
"""Step of the numerical derivatives of the projection."""


@dataclass(frozen=True, eq=False)
class Edges:
    """Samples of the edges that a pose shows."""

    places_m: FloatArray
    """Target axes, shape (N, 3)."""
    directions: FloatArray
    """Along the edges, target axes, shape (N, 3)."""

    @classmethod
    def shown(cls, target: Target, T_sensor_target: RigidTransform) -> "Edges":
        """Return samples, one a piece of the wireframe that no surface hides."""
        pieces_m = visible_pieces(target, T_sensor_target)
        if not len(pieces_m):
            return cls(np.zeros((0, 3)), np.zeros((0, 3)))
        T_target_sensor = T_sensor_target.inv()
        along_m = T_target_sensor.rotation.apply(pieces_m[:, 1] - pieces_m[:, 0])
        directions = along_m / np.linalg.norm(along_m, axis=1, keepdims=True)
        return cls(T_target_sensor.apply(pieces_m.mean(axis=1)), directions)


@dataclass(frozen=True, eq=False)
class Found:
    """Samples whose edge was found."""

    offset_px: FloatArray
    """From the projection to the edge, along the normal, shape (M,)."""
    rows: FloatArray
    """Derivatives of the projection along the normal by (dtau, dtheta) in target axes, shape (M, 6)."""
    asked: int
    """Samples whose profile lies in the image."""


def find(
    edges: Edges,
    T_sensor_target: RigidTransform,
    camera: Camera,
    image: Float32Array,
    *,
    reach: float,
    least: float,
) -> Found:
    """Return where the edges are.

    Args:
        edges: samples.
        T_sensor_target: where they are projected from.
        camera: the lens.
        image: smoothed, shape (H, W).
        reach: pixels searched both ways.
        least: change of brightness over two pixels that counts.
    """
    R = T_sensor_target.rotation.as_matrix()
    at_m = T_sensor_target.apply(edges.places_m)
    pixels, by_place = _projected(at_m, camera)
    tangent = np.einsum("nij,jk,nk->ni", by_place, R, edges.directions)
    length = np.linalg.norm(tangent, axis=1)
    normal = np.column_stack((-tangent[:, 1], tangent[:, 0])) / np.maximum(length, 1e-9)[:, None]
    offset_px, inside, found = _searched(image, pixels, normal, reach=reach, least=least)
    inside, found = inside & (length > 1e-6), found & (length > 1e-6)
    along = np.einsum("ni,nij->nj", normal[found], by_place[found]) @ R  # by the place, target axes
    rows = np.hstack((along, np.cross(edges.places_m[found], along)))
    return Found(offset_px[found], rows, int(np.count_nonzero(inside)))


def _projected(at_m: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return pixels, shape (N, 2), and their derivatives by the place in sensor axes, shape (N, 2, 3)."""
    moved = [project(at_m + _STEP_M * axis, camera) for axis in np.eye(3)]
    back = [project(at_m - _STEP_M * axis, camera) for axis in np.eye(3)]
    by_place = np.stack([(p - m) / (2.0 * _STEP_M) for p, m in zip(moved, back, strict=True)], axis=-1)
    return project(at_m, camera), by_place


def _searched(
    image: Float32Array, pixels: FloatArray, normal: FloatArray, *, reach: float, least: float
) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the steepest change's offset, whether a profile is inside the image, and whether it has one."""
    most = int(np.ceil(reach)) + 2
    k = np.arange(-most, most + 1)
    columns = pixels[:, :1] + k * normal[:, :1]
    rows = pixels[:, 1:] + k * normal[:, 1:]
    height, width = image.shape
    inside = ((columns >= 0) & (columns <= width - 1) & (rows >= 0) & (rows <= height - 1)).all(axis=1)
    profile = map_coordinates(image, (rows, columns), order=1, mode="nearest", output=np.float64)
    change = np.abs(profile[:, 2:] - profile[:, :-2])  # at k[1:-1]
    middle = change[:, 1:-1]  # at k[2:-2]
    peak = (middle >= least) & (middle >= change[:, :-2]) & (middle >= change[:, 2:])
    score = np.where(peak, middle / (1.0 + (k[2:-2] / (0.5 * reach + 1.0)) ** 2), 0.0)
    best = score.argmax(axis=1)
    each = np.arange(len(best))
    before, here, after = change[each, best], change[each, best + 1], change[each, best + 2]
    bend = before - 2.0 * here + after
    shift = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, 1.0), 0.0)
    return k[2:-2][best] + shift, inside, inside & peak.any(axis=1)
