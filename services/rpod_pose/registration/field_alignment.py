"""Alignment of points with a target in its distance field, from afar: no correspondences are searched.

Each point is moved along the gradient of the distance field. The unknowns are those of
``normal_equations``; outliers fade by Geman-McClure weights.
"""

import numpy as np
from numba import njit

from rpod_pose.registration.distance_field import distance_and_gradient
from rpod_pose.registration.lie_group import in_target, turned

AWAY = 0.5
"""A face turned from the ray by more than this cosine cannot have sent it back."""
REACH_M, REACH_RAD = 0.5, 0.1
"""Standard deviation of a step that no return asks for: what they do not determine stays where it is."""


@njit(cache=True, nogil=True, error_model="numpy")
def add_upper(information, gradient, normal, place, residual, weight):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Add a distance along a normal at a place, target axes; of the symmetric sum only the upper half."""
    n0, n1, n2 = normal
    x, y, z = place
    j0, j1, j2, j3, j4, j5 = -n0, -n1, -n2, n1 * z - n2 * y, n2 * x - n0 * z, n0 * y - n1 * x
    w0, w1, w2, w3, w4, w5 = weight * j0, weight * j1, weight * j2, weight * j3, weight * j4, weight * j5
    information[0, 0] += w0 * j0
    information[0, 1] += w0 * j1
    information[0, 2] += w0 * j2
    information[0, 3] += w0 * j3
    information[0, 4] += w0 * j4
    information[0, 5] += w0 * j5
    information[1, 1] += w1 * j1
    information[1, 2] += w1 * j2
    information[1, 3] += w1 * j3
    information[1, 4] += w1 * j4
    information[1, 5] += w1 * j5
    information[2, 2] += w2 * j2
    information[2, 3] += w2 * j3
    information[2, 4] += w2 * j4
    information[2, 5] += w2 * j5
    information[3, 3] += w3 * j3
    information[3, 4] += w3 * j4
    information[3, 5] += w3 * j5
    information[4, 4] += w4 * j4
    information[4, 5] += w4 * j5
    information[5, 5] += w5 * j5
    gradient[0] += w0 * residual
    gradient[1] += w1 * residual
    gradient[2] += w2 * residual
    gradient[3] += w3 * residual
    gradient[4] += w4 * residual
    gradient[5] += w5 * residual


@njit(cache=True, nogil=True)
def mirror(information):  # type: ignore[no-untyped-def]
    """Fill the lower half of a symmetric sum."""
    for i in range(6):
        for j in range(i):
            information[i, j] = information[j, i]


@njit(cache=True, nogil=True)
def held(information, gradient, variance):  # type: ignore[no-untyped-def]
    """Return the Gauss-Newton step of residuals of a variance, held back where they say little."""
    held_back = information.copy()
    for i in range(3):
        held_back[i, i] += variance / REACH_M**2
        held_back[i + 3, i + 3] += variance / REACH_RAD**2
    return np.linalg.solve(held_back, -gradient)


@njit(cache=True, nogil=True, error_model="numpy")
def draw_in(points, R, t, field, scales):  # type: ignore[no-untyped-def]
    """Return R and t after one step in the distance field for each Geman-McClure scale, m.

    Args:
        points: returns, sensor axes, shape (N, 3), m.
        R: of the target in the sensor, shape (3, 3).
        t: of the target in the sensor, shape (3,), m.
        field: ``SurfaceModel.field``.
        scales: shape (steps,), m.
    """
    origin, spacing, values = field
    per_m = 1.0 / spacing
    for scale in scales:
        information, gradient, weights, c2 = np.zeros((6, 6)), np.zeros(6), 0.0, scale * scale
        for n in range(points.shape[0]):
            px, py, pz = points[n, 0], points[n, 1], points[n, 2]
            x, y, z = in_target(R, px - t[0], py - t[1], pz - t[2])
            d, gx, gy, gz = distance_and_gradient(
                (x - origin[0]) * per_m, (y - origin[1]) * per_m, (z - origin[2]) * per_m, values
            )
            gx, gy, gz = gx * per_m, gy * per_m, gz * per_m
            dx, dy, dz = in_target(R, px, py, pz)
            if gx * dx + gy * dy + gz * dz > AWAY * np.sqrt(px * px + py * py + pz * pz):
                continue
            weight = (c2 / (c2 + d * d)) ** 2
            weights += weight
            add_upper(information, gradient, (gx, gy, gz), (x, y, z), d, weight)
        mirror(information)
        step = held(information, gradient, 0.01 * c2)
        t = t + R @ step[:3]
        R = turned(R, step[3:])
    return R, t
