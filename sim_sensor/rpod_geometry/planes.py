"""Planes in point clouds: the largest one by random draws, and the best one through points."""

from typing import NamedTuple

import numpy as np

from rpod_schemas.arrays import FloatArray


class Plane(NamedTuple):
    """A plane."""

    point_m: FloatArray
    """A point on it, shape (3,)."""
    normal: FloatArray
    """Unit normal, shape (3,); its sign is arbitrary."""

    def distances_m(self, points_m: FloatArray) -> FloatArray:
        """Return the distances of points, shape (N, 3), from the plane, shape (N,)."""
        distances_m: FloatArray = np.abs((points_m - self.point_m) @ self.normal)
        return distances_m


def fitted_plane(points_m: FloatArray) -> Plane:
    """Return the plane with the least squared distances from points, shape (N, 3), N of 3 or more."""
    middle_m = points_m.mean(axis=0)
    return Plane(middle_m, np.linalg.svd(points_m - middle_m, full_matrices=False)[2][2])


def largest_plane(
    points_m: FloatArray, within_m: float, *, draws: int, generator: np.random.Generator
) -> Plane | None:
    """Return the plane through three points that has most points near it (RANSAC, Fischler and Bolles 1981).

    Args:
        points_m: the points, shape (N, 3).
        within_m: largest distance of a point that is near.
        draws: number of planes that are tried.
        generator: draws the three points of each.

    Returns:
        The plane, not fitted to the points near it; None if all draws are points on one line.
    """
    a, b, c = points_m[generator.integers(len(points_m), size=(3, draws))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 0.0
    if not usable.any():
        return None
    normals, a = normals[usable] / lengths[usable, None], a[usable]
    offsets_m = np.einsum("ni,ni->n", normals, a)
    best = int(np.argmax((np.abs(points_m @ normals.T - offsets_m) < within_m).sum(axis=0)))
    return Plane(a[best], normals[best])
