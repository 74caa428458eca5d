"""Rotations and their derivatives, as the filter needs them."""

import numpy as np

from rpod_schemas.arrays import FloatArray


def left_jacobian(phi: FloatArray) -> FloatArray:
    """Return J_l of SO(3), shape (3, 3): Exp(phi + d) = Exp(J_l(phi) d) Exp(phi) to first order in d."""
    angle = float(np.linalg.norm(phi))
    if angle < 1e-4:  # the closed form loses digits that the series keeps
        first, second = 0.5, 1.0 / 6.0
    else:
        first = 2.0 * (np.sin(0.5 * angle) / angle) ** 2
        second = (angle - np.sin(angle)) / angle**3
    cross = cross_matrix(phi)
    return np.eye(3) + first * cross + second * cross @ cross


def exponential(phi: FloatArray) -> FloatArray:
    """Return Exp(phi) of SO(3), shape (3, 3), as 1 + [phi]x J_l(phi)."""
    return np.eye(3) + cross_matrix(phi) @ left_jacobian(phi)


def orthonormal(R: FloatArray) -> FloatArray:
    """Return a rotation matrix, (3, 3), without the rounding errors of many products, by one Newton step."""
    return R @ (1.5 * np.eye(3) - 0.5 * R.T @ R)


def cross_matrix(vector: FloatArray) -> FloatArray:
    """Return [v]x, shape (3, 3): [v]x u is the cross product of v and u."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix, shape (N, N)."""
    return 0.5 * (matrix + matrix.T)
