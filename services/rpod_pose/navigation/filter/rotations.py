"""Rotations and their derivatives, as the filter needs them.

They are computed component by component: for three components, calls of numpy take several times as long.
"""

from math import hypot, sin

import numpy as np

from rpod_schemas.arrays import FloatArray


def left_jacobian(phi: FloatArray) -> FloatArray:
    """Return J_l of SO(3), shape (3, 3): Exp(phi + d) = Exp(J_l(phi) d) Exp(phi) to first order in d."""
    angle = hypot(*phi.tolist())
    if angle < 1e-4:  # the closed form loses digits that the series keeps
        return _one_plus(0.5, 1.0 / 6.0, phi)
    return _one_plus(2.0 * (sin(0.5 * angle) / angle) ** 2, (angle - sin(angle)) / angle**3, phi)


def exponential(phi: FloatArray) -> FloatArray:
    """Return Exp(phi) of SO(3), shape (3, 3), by Rodrigues' formula."""
    angle = hypot(*phi.tolist())
    if angle < 1e-4:
        return _one_plus(1.0 - angle**2 / 6.0, 0.5, phi)
    return _one_plus(sin(angle) / angle, 2.0 * (sin(0.5 * angle) / angle) ** 2, phi)


def _one_plus(first: float, second: float, phi: FloatArray) -> FloatArray:
    """Return 1 + first [phi]x + second [phi]x [phi]x, shape (3, 3)."""
    x, y, z = phi.tolist()
    xx, yy, zz = second * x * x, second * y * y, second * z * z
    xy, xz, yz = second * x * y, second * x * z, second * y * z
    x, y, z = first * x, first * y, first * z
    return np.array(
        [
            [1.0 - yy - zz, xy - z, xz + y],
            [xy + z, 1.0 - xx - zz, yz - x],
            [xz - y, yz + x, 1.0 - xx - yy],
        ]
    )


def orthonormal(R: FloatArray) -> FloatArray:
    """Return a rotation matrix, shape (3, 3), after a Newton step that removes its rounding errors."""
    return R @ (1.5 * np.eye(3) - 0.5 * R.T @ R)


def cross_matrix(vector: FloatArray) -> FloatArray:
    """Return [v]x, shape (3, 3): [v]x u is the cross product of v and u."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix, shape (N, N)."""
    return 0.5 * (matrix + matrix.T)
