"""The target rendered at a pose on the coarse pixels, and cast anew between them where it matters.

Coarse pixels lie several pixels apart. Whether a range, or a dark place, might belong to what lies a pixel or
two beside it is asked of a few more rays there, on no more triangles than the pixel and its neighbours show.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rpod_geometry.rays import RayGrid
from rpod_schemas.arrays import FloatArray

NEAREST_M = 0.3
"""Lengths are not seen from nearer than this."""
NINE = 9
"""A pixel and its neighbours."""


@dataclass(frozen=True, eq=False)
class Rendering:
    """What every coarse pixel would see of the target, and what it takes to look between them."""

    range_m: NDArray[np.float32]
    """inf where there is nothing, shape (rows, columns)."""
    triangle: NDArray[np.int32]
    """-1 where there is nothing, same shape."""
    grid: RayGrid
    """Of the coarse pixels."""
    stride: int
    """Pixels from one coarse pixel to the next."""
    focal_px: float
    """Of the camera."""
    triangles_m: FloatArray
    """Of the target, target axes, shape (T, 3, 3), counter-clockwise from outside."""
    R: FloatArray
    """Of the target in the sensor, shape (3, 3)."""
    t: FloatArray
    """Of the target in the sensor, shape (3,), m."""

    @property
    def px_per_m(self) -> float:
        """Of a length across the line of sight, as far off as the target's origin."""
        return self.focal_px / max(float(np.linalg.norm(self.t)), NEAREST_M)

    @property
    def arrays(self) -> tuple[object, ...]:
        """As the kernels take them."""
        return (
            self.range_m, self.triangle, self.grid.components, self.stride, self.triangles_m, self.R, self.t,
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def around(rendered, i, j, reach):  # type: ignore[no-untyped-def]
    """Return the least and greatest range in and around a coarse pixel, and how many of nine rays hit.

    Args:
        rendered: ``Rendering.arrays``.
        i: row of the coarse pixel.
        j: its column.
        reach: to the eight rays around it, along rows and columns, px.
    """
    _, owner, rays, stride, triangles, R, t = rendered
    rows, columns = owner.shape
    below, beside = (i + 1 if i + 1 < rows else i - 1), (j + 1 if j + 1 < columns else j - 1)
    down, across = reach / stride * (below - i), reach / stride * (beside - j)
    inverse, corner, ray = np.zeros(NINE), np.empty((3, 3)), np.empty(3)
    tried, count = np.empty(NINE, np.int32), 0
    for v in range(max(i - 1, 0), min(i + 2, rows)):
        for u in range(max(j - 1, 0), min(j + 2, columns)):
            k = owner[v, u]
            if k < 0 or (tried[:count] == k).any():
                continue
            tried[count] = k
            count += 1
            _place(triangles[k], R, t, corner)
            for n in range(NINE):
                a, b = (n // 3 - 1) * down, (n % 3 - 1) * across
                for m in range(3):
                    here = rays[m, i, j]
                    ray[m] = here + a * (rays[m, below, j] - here) + b * (rays[m, i, beside] - here)
                inverse[n] = max(inverse[n], _per_range(corner, ray))
    low, high, hits = np.inf, 0.0, 0
    for n in range(NINE):
        if inverse[n] > 0.0:
            low, high, hits = min(low, 1.0 / inverse[n]), max(high, 1.0 / inverse[n]), hits + 1
    return low, high, hits


@njit(cache=True, nogil=True, error_model="numpy")
def facing(rendered, i, j):  # type: ignore[no-untyped-def]
    """Return the cosine of incidence at a coarse pixel that shows the target; arguments as for ``around``."""
    _, owner, rays, _, triangles, R, _ = rendered
    a, b, c = triangles[owner[i, j]]
    squares, along = 0.0, 0.0
    for n in range(3):
        p, q = (n + 1) % 3, (n + 2) % 3
        normal = (b[p] - a[p]) * (c[q] - a[q]) - (b[q] - a[q]) * (c[p] - a[p])
        ray = R[0, n] * rays[0, i, j] + R[1, n] * rays[1, i, j] + R[2, n] * rays[2, i, j]
        squares += normal * normal
        along += normal * ray
    return -along / np.sqrt(squares)


@njit(cache=True, nogil=True)
def _place(triangle, R, t, corner):  # type: ignore[no-untyped-def]
    """Fill in a triangle's corners in sensor axes."""
    for n in range(3):
        x, y, z = triangle[n]
        for m in range(3):
            corner[n, m] = t[m] + R[m, 0] * x + R[m, 1] * y + R[m, 2] * z


@njit(cache=True, nogil=True, error_model="numpy")
def _per_range(corner, ray):  # type: ignore[no-untyped-def]
    """Return one over the range at which a ray meets a triangle seen from outside, 0 where it does not.

    By the products of ``rpod_geometry.rays``; the ray's length is taken for one.
    """
    total = 0.0
    for n in range(3):
        side = _product(corner[n], corner[(n + 1) % 3], ray)
        if side > 0.0:
            return 0.0
        total += side
    return total / _product(corner[0], corner[1], corner[2])


@njit(cache=True, nogil=True)
def _product(a, b, c):  # type: ignore[no-untyped-def]
    """Return (a x b) . c."""
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    return x * c[0] + y * c[1] + z * c[2]
