"""Surfaces as bodies: the inside test, and the signed distance to their union."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh.repair import winding_number
from rpod_target.target import DistanceField
from rpod_target.visibility import Sky, as_tensor, scene_of

_RAYS = 3
"""Number of rays in the inside test; the majority decides, because a ray through an edge may be wrong."""
_INSIDE = 0.5
"""Winding number above which a place is inside."""
_SEEN = 0.1
"""Share of all directions from which a place is seen above which it is not inside an open surface."""

_DISAGREE = 1e-3
"""Share of places where rays and winding number disagree, above which a surface cuts through itself."""
_PLACES = 4000
"""Number of triangles of a surface at which rays and winding number are compared."""

Inside = Callable[[NDArray[np.floating]], NDArray[np.bool_]]


class Body:
    """A surface, and the test whether points, (N, 3), are inside of it; queries are made by Open3D."""

    def __init__(self, triangles_m: FloatArray, inside: Inside | None = None) -> None:
        self.triangles_m = triangles_m
        self._scene = scene_of(triangles_m)
        self.inside = inside or self._by_rays
        self.low, self.high = triangles_m.min(axis=(0, 1)), triangles_m.max(axis=(0, 1))

    @classmethod
    def of_mesh(cls, triangles_m: FloatArray) -> "Body":
        """Return closed surfaces that may cut through themselves and each other, as one body.

        The winding number decides where they do; elsewhere rays agree with it and are faster.
        """
        body = cls(triangles_m)
        places_m = _places(triangles_m, 1e-3 * float((body.high - body.low).max()))

        def enclosed(points_m: NDArray[np.floating]) -> NDArray[np.bool_]:
            within: NDArray[np.bool_] = winding_number(triangles_m, points_m) > _INSIDE
            return within

        if (body.inside(places_m) != enclosed(places_m)).mean() > _DISAGREE:
            body.inside = enclosed
        return body

    @classmethod
    def of_open_surface(cls, triangles_m: FloatArray, sky: Sky) -> "Body":
        """Return open surfaces: a point is inside if they enclose it and hardly any direction sees it."""

        def inside(points_m: NDArray[np.floating]) -> NDArray[np.bool_]:
            enclosed = winding_number(triangles_m, points_m) > _INSIDE
            enclosed[enclosed] = sky.share(points_m[enclosed]) <= _SEEN
            return enclosed

        return cls(triangles_m, inside)

    def _by_rays(self, points_m: NDArray[np.floating]) -> NDArray[np.bool_]:
        within: NDArray[np.bool_] = (
            self._scene.compute_occupancy(as_tensor(points_m), nsamples=_RAYS).numpy() > 0.5
        )
        return within

    def distance_m(self, points_m: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the distance, m, of points, (N, 3), from the surface, shape (N,)."""
        distance_m: NDArray[np.float32] = self._scene.compute_distance(as_tensor(points_m)).numpy()
        return distance_m

    def depth_m(self, points_m: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the distance, m, of points, (N, 3), from the surface where they are inside, else 0; (N,)."""
        depth_m = np.zeros(len(points_m), np.float32)
        if len(points_m):
            inside = self.inside(points_m)
            depth_m[inside] = self.distance_m(points_m[inside])
        return depth_m


class Bodies:
    """Bodies that may touch and overlap."""

    def __init__(self, bodies: Sequence[Body]) -> None:
        self._bodies = bodies

    def depth_m(self, points_m: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the depth, m, of points, (N, 3), in the body in which they lie deepest; 0 outside; (N,)."""
        deepest_m = np.zeros(len(points_m), np.float32)
        for body in self._bodies:
            near = np.flatnonzero(((points_m > body.low) & (points_m < body.high)).all(axis=1))
            deepest_m[near] = np.maximum(deepest_m[near], body.depth_m(points_m[near]))
        return deepest_m

    def distance_field(
        self, *, origin_m: FloatArray, spacing_m: float, shape: Sequence[int]
    ) -> DistanceField:
        """Return the minimum of the bodies' signed distances on a grid.

        Outside all bodies this minimum is the distance to the nearest surface, one query for all of them.
        Only the few nodes inside a body need that body's own distance.
        """
        axes = [
            (origin + spacing_m * np.arange(n)).astype(np.float32)
            for origin, n in zip(origin_m, shape, strict=True)
        ]
        surface = Body(np.concatenate([body.triangles_m for body in self._bodies]))
        signed_m = np.empty(tuple(shape), np.float32)
        for layer, x in enumerate(axes[0]):
            signed_m[layer] = surface.distance_m(_nodes(np.array([x]), *axes[1:])).reshape(shape[1:])
        depth_m = np.zeros(tuple(shape), np.float32)
        for body in self._bodies:
            within = [
                np.flatnonzero((axis > low) & (axis < high))
                for axis, low, high in zip(axes, body.low, body.high, strict=True)
            ]
            if all(len(indices) for indices in within):
                nodes_m = _nodes(*(axis[indices] for axis, indices in zip(axes, within, strict=True)))
                block = tuple(slice(indices[0], indices[-1] + 1) for indices in within)
                depth_m[block] = np.maximum(
                    depth_m[block], body.depth_m(nodes_m).reshape(depth_m[block].shape)
                )
        return DistanceField(origin_m, spacing_m, np.where(depth_m > 0.0, -depth_m, signed_m))


def _nodes(*axes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the nodes of a grid, shape (N, 3), the last axis fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _places(triangles_m: FloatArray, off_m: float) -> FloatArray:
    """Return places on both sides of some triangles, shape (N, 3)."""
    some = triangles_m[:: max(1, len(triangles_m) // _PLACES)]
    middle_m = some.mean(axis=1)
    normals = np.cross(some[:, 1] - some[:, 0], some[:, 2] - some[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.concatenate([middle_m + off_m * normals, middle_m - off_m * normals])
