"""Closed surfaces as bodies: the inside test, and the signed distance to their union."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_target.target import DistanceField

_RAYS = 3
"""Number of rays in the inside test; the majority decides, because a ray through an edge may be wrong."""


class Bodies:
    """Closed surfaces that may touch and overlap, each facing outwards; queries are made by Open3D."""

    def __init__(self, surfaces: Sequence[FloatArray]) -> None:
        self._surfaces = surfaces
        self._scenes = [_scene(surface) for surface in surfaces]

    def depth_m(self, points_m: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the depth, m, of points, (N, 3), in the body in which they lie deepest; 0 outside; (N,)."""
        deepest_m = np.zeros(len(points_m), np.float32)
        for surface, scene in zip(self._surfaces, self._scenes, strict=True):
            low, high = surface.min(axis=(0, 1)), surface.max(axis=(0, 1))
            near = np.flatnonzero(((points_m > low) & (points_m < high)).all(axis=1))
            inside = near[scene.compute_occupancy(_query(points_m[near]), nsamples=_RAYS).numpy() > 0.5]
            depth_m = scene.compute_distance(_query(points_m[inside])).numpy()
            deepest_m[inside] = np.maximum(deepest_m[inside], depth_m)
        return deepest_m

    def distance_field(
        self, *, origin_m: FloatArray, spacing_m: float, shape: Sequence[int]
    ) -> DistanceField:
        """Return the minimum of the bodies' signed distances on a grid.

        Outside all of them that is the distance to the nearest surface of any, one query for all;
        only the few nodes inside a body need that body's own distance.
        """
        axes = [
            (origin + spacing_m * np.arange(n)).astype(np.float32)
            for origin, n in zip(origin_m, shape, strict=True)
        ]
        nodes_m = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        outside_m = _scene(np.concatenate(self._surfaces)).compute_distance(_query(nodes_m)).numpy()
        depth_m = self.depth_m(nodes_m)
        signed_m = np.where(depth_m > 0.0, -depth_m, outside_m)
        return DistanceField(origin_m, spacing_m, signed_m.reshape(tuple(shape)))


def _scene(triangles_m: FloatArray) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene()
    corners = _query(triangles_m.reshape(-1, 3))
    scene.add_triangles(
        corners, o3d.core.Tensor.from_numpy(np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
    )
    return scene


def _query(points_m: NDArray[np.floating]) -> Any:  # mypy sees Open3D's tensors as Any, pyright does not
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(points_m, dtype=np.float32))
