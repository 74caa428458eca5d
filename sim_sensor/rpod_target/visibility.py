"""Visibility from far away: which sides of a surface, and which places.

An open surface has no inside by itself. The space that no direction sees is taken as its inside. So neither
holes, nor the order of corners, nor duplicate surfaces affect the result.
"""

from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray

_DIRECTIONS = 128
"""Number of directions, spread evenly over the sphere."""
_GRAZING = 0.05
"""Least cosine between a face's normal and a direction from which it is seen."""
_SAMPLES = 100_000
"""Number of places on a surface whose sides are looked at; each triangle has one at least, 16 at most."""
_RAYS = 2_000_000
"""Number of rays that are cast at a time."""


class Sky:
    """Casts rays outwards from places, and counts those that hit nothing."""

    def __init__(self, triangles_m: FloatArray) -> None:
        self._scene = scene_of(triangles_m)
        self._directions = sphere(_DIRECTIONS)

    def share(self, points_m: NDArray[np.floating]) -> FloatArray:
        """Return the share of all directions that see each point, (N, 3); shape (N,)."""
        seen = np.zeros(len(points_m))
        size = max(1, _RAYS // _DIRECTIONS)
        for start in range(0, len(points_m), size):
            some = points_m[start : start + size]
            rays = np.empty((len(some), _DIRECTIONS, 6), np.float32)
            rays[:, :, :3], rays[:, :, 3:] = some[:, None], self._directions
            seen[start : start + size] = (~self._hidden(rays)).mean(axis=1)
        return seen

    def sides(self, triangles_m: FloatArray, *, nudge_m: float) -> tuple[FloatArray, FloatArray]:
        """Return the share of the directions before each triangle that see its front, and behind it its back.

        Args:
            triangles_m: corners, shape (T, 3, 3).
            nudge_m: distance off the surface from which the rays start.
        """
        count = int(np.clip(_SAMPLES // max(len(triangles_m), 1), 1, 16))
        share = np.zeros((2, len(triangles_m)))
        size = max(1, _RAYS // (_DIRECTIONS * count))
        for start in range(0, len(triangles_m), size):
            some = triangles_m[start : start + size]
            spanned = np.cross(some[:, 1] - some[:, 0], some[:, 2] - some[:, 0])
            normals = spanned / np.linalg.norm(spanned, axis=1, keepdims=True)
            cosine = normals @ self._directions.T
            points_m = np.einsum("kc,tcd->tkd", inner_points(count), some)
            rays = np.empty((len(some), count, _DIRECTIONS, 6), np.float32)
            for side, sign in enumerate((1.0, -1.0)):
                rays[..., :3] = (points_m + sign * nudge_m * normals[:, None])[:, :, None]
                rays[..., 3:] = self._directions
                facing = (sign * cosine > _GRAZING)[:, None]
                free = ~self._hidden(rays) & facing
                share[side, start : start + size] = free.sum(axis=(1, 2)) / (
                    count * np.maximum(facing.sum(axis=(1, 2)), 1)
                )
        return share[0], share[1]

    def _hidden(self, rays: NDArray[np.float32]) -> NDArray[np.bool_]:
        hit: NDArray[np.bool_] = self._scene.test_occlusions(o3d.core.Tensor.from_numpy(rays)).numpy()
        return hit


def scene_of(triangles_m: FloatArray) -> o3d.t.geometry.RaycastingScene:
    """Return triangles as a scene of Open3D."""
    scene = o3d.t.geometry.RaycastingScene()
    corners = as_tensor(triangles_m.reshape(-1, 3))
    scene.add_triangles(
        corners, o3d.core.Tensor.from_numpy(np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
    )
    return scene


def as_tensor(points_m: NDArray[np.floating]) -> Any:  # mypy sees Open3D's tensors as Any, pyright does not
    """Return points as Open3D takes them."""
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(points_m, dtype=np.float32))


def sphere(count: int) -> FloatArray:
    """Return unit vectors spread evenly over the sphere by the golden angle, shape (count, 3)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count) + 0.1  # no direction along an axis
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def inner_points(count: int) -> FloatArray:
    """Return weights of the three corners for places spread over a triangle, shape (count, 3)."""
    if count == 1:
        return np.full((1, 3), 1.0 / 3.0)
    number = np.arange(count) + 0.5
    u, v = np.mod(number * 0.7548776662466927, 1.0), np.mod(number * 0.5698402909980532, 1.0)
    folded = u + v > 1.0
    u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
    return np.stack([1.0 - u - v, u, v], axis=1)
