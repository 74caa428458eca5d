"""Exact matches of points on a triangulated surface: the closest point, or the closest foot of a normal.

The search for the closest point first tries the triangle that was closest the last time. Its distance rules
out most other triangles by their bounding spheres.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_schemas.arrays import FloatArray

EDGE_M2 = 1e-9
"""Tolerance of the inside test (distance times length of the edge), m2. Numerics: no foot of a normal falls
between two faces."""


class Triangles(NamedTuple):
    """Triangles with their bounding spheres, in the form that the kernels take."""

    triangles_m: FloatArray
    """Corners, shape (T, 3, 3)."""
    centres_m: FloatArray
    """Centres of the bounding spheres, shape (T, 3)."""
    radii_m: FloatArray
    """Radii of the bounding spheres, shape (T,)."""
    usable: NDArray[np.bool_]
    """Mask of the triangles that may be matched, shape (T,)."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with their normals and bounding spheres."""

    triangles_m: FloatArray
    """Corners, shape (T, 3, 3)."""
    normals: FloatArray
    """Outward unit normals, shape (T, 3)."""
    centres_m: FloatArray
    """Centres of the bounding spheres, shape (T, 3)."""
    radii_m: FloatArray
    """Radii of the bounding spheres, shape (T,)."""

    @classmethod
    def of(cls, triangles_m: FloatArray, normals: FloatArray) -> Self:
        """Return the surface of triangles, shape (T, 3, 3), with normals, shape (T, 3)."""
        centres_m = (triangles_m.min(axis=1) + triangles_m.max(axis=1)) / 2.0
        radii_m = np.linalg.norm(triangles_m - centres_m[:, None], axis=2).max(axis=1)
        return cls(np.ascontiguousarray(triangles_m), np.ascontiguousarray(normals), centres_m, radii_m)

    def facing(self, viewpoint_m: FloatArray) -> NDArray[np.bool_]:
        """Return which triangles show their outer side to a viewpoint, shape (T,)."""
        facing: NDArray[np.bool_] = ((viewpoint_m - self.triangles_m[:, 0]) * self.normals).sum(axis=1) > 0.0
        return facing

    def closest(
        self, points_m: FloatArray, usable: NDArray[np.bool_], nearest: NDArray[np.int32]
    ) -> FloatArray:
        """Return the closest point on a usable triangle for each point, shape (N, 3).

        Args:
            points_m: the points, shape (N, 3).
            usable: mask of the triangles that may be matched, shape (T,), at least one.
            nearest: in: a guess of each point's triangle, shape (N,); out: the closest triangle.
        """
        closest_m: FloatArray = closest_points(
            Triangles(self.triangles_m, self.centres_m, self.radii_m, usable),
            np.ascontiguousarray(points_m),  # compiled once, whatever the layout of the points
            nearest,
        )
        return closest_m

    def projected(
        self, points_m: FloatArray, usable: NDArray[np.bool_], nearest: NDArray[np.int32]
    ) -> FloatArray:
        """Return the closest foot of a normal on a usable triangle for each point, shape (N, 3).

        Args:
            points_m: the points, shape (N, 3).
            usable: mask of the triangles that may be matched, shape (T,).
            nearest: out: the triangle of each point's foot, shape (N,); -1 for a point that lies above or
                below no triangle and is returned unchanged.
        """
        points_m = np.ascontiguousarray(points_m)
        projected_m: FloatArray = projected_points(points_m, self.triangles_m, self.normals, usable, nearest)
        return projected_m


@kernel
def projected_points(
    points: FloatArray,
    triangles: FloatArray,
    normals: FloatArray,
    usable: NDArray[np.bool_],
    nearest: NDArray[np.int32],
) -> FloatArray:
    """Return ``Surface.projected`` of points, shape (N, 3), m, with the same arguments as that method.

    The foot of the normal on a triangle's plane is p - n (n . (p - v0)).
    """
    projected = points.copy()
    for n in range(points.shape[0]):
        best, height = np.inf, 0.0
        nearest[n] = -1
        for t in range(triangles.shape[0]):
            if not usable[t]:
                continue
            distance = 0.0
            for k in range(3):
                distance += normals[t, k] * (points[n, k] - triangles[t, 0, k])
            if abs(distance) < best and is_above(points[n], triangles[t], normals[t]):
                best, height, nearest[n] = abs(distance), distance, t
        if nearest[n] >= 0:
            projected[n] -= height * normals[nearest[n]]
    return projected


@inner_kernel
def is_above(p: FloatArray, triangle: FloatArray, normal: FloatArray) -> bool:
    """Return whether the foot of p, (3,), on the plane of a triangle, (3, 3), lies in the triangle; m."""
    for i in range(3):
        a, b = triangle[i], triangle[(i + 1) % 3]
        x, y, z = p[0] - a[0], p[1] - a[1], p[2] - a[2]
        dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        side = normal[0] * (dy * z - dz * y) + normal[1] * (dz * x - dx * z) + normal[2] * (dx * y - dy * x)
        if side < -EDGE_M2:
            return False
    return True


@kernel
def closest_points(surface: Triangles, points: FloatArray, nearest: NDArray[np.int32]) -> FloatArray:
    """Return the closest point on a usable triangle for each point, shape (N, 3), m.

    A triangle whose bounding sphere is farther away than the closest point so far is skipped.

    Args:
        surface: T triangles, of which at least one is usable.
        points: shape (N, 3), m.
        nearest: in: a guess of each point's triangle, shape (N,); out: the closest triangle.
    """
    triangles, centres, radii, usable = surface
    closest = np.empty(points.shape)
    for n in range(points.shape[0]):
        p = points[n]
        best2, best = np.inf, np.inf
        if 0 <= nearest[n] < len(usable) and usable[nearest[n]]:
            q0, q1, q2 = on_triangle(p, triangles[nearest[n]])
            best2 = (p[0] - q0) ** 2 + (p[1] - q1) ** 2 + (p[2] - q2) ** 2
            best = np.sqrt(best2)
            closest[n, 0], closest[n, 1], closest[n, 2] = q0, q1, q2
        for t in range(triangles.shape[0]):
            reach = best + radii[t]
            x, y, z = p[0] - centres[t, 0], p[1] - centres[t, 1], p[2] - centres[t, 2]
            if not usable[t] or x * x + y * y + z * z >= reach * reach:
                continue
            q0, q1, q2 = on_triangle(p, triangles[t])
            distance2 = (p[0] - q0) ** 2 + (p[1] - q1) ** 2 + (p[2] - q2) ** 2
            if distance2 < best2:
                best2, best = distance2, np.sqrt(distance2)
                nearest[n] = t
                closest[n, 0], closest[n, 1], closest[n, 2] = q0, q1, q2
    return closest


@kernel
def on_triangle(p: FloatArray, triangle: FloatArray) -> tuple[float, float, float]:
    """Return the point of a triangle, shape (3, 3), closest to p, shape (3,), as three numbers.

    Source: C. Ericson, Real-Time Collision Detection (2005), section 5.1.5: the regions of the corners,
    then of the edges, then the inside.
    """
    a, b, c = triangle[0], triangle[1], triangle[2]
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for k in range(3):
        ab, ac = b[k] - a[k], c[k] - a[k]
        d1 += ab * (p[k] - a[k])
        d2 += ac * (p[k] - a[k])
        d3 += ab * (p[k] - b[k])
        d4 += ac * (p[k] - b[k])
        d5 += ab * (p[k] - c[k])
        d6 += ac * (p[k] - c[k])
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = d1 / (d1 - d3), 0.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    u = 1.0 - v - w
    return (
        u * a[0] + v * b[0] + w * c[0],
        u * a[1] + v * b[1] + w * c[1],
        u * a[2] + v * b[2] + w * c[2],
    )
