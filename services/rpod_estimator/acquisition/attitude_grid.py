"""Attitudes spread evenly over all of SO(3), and directions over the sphere."""

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
BORESIGHT = np.array([0.0, 0.0, 1.0])


def super_fibonacci(count: int) -> Rotation:
    """Return ``count`` attitudes, low in discrepancy and always the same ones.

    Source: M. Alexa, Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling of SO(3), CVPR 2022.
    """
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    return Rotation.from_quat(
        np.column_stack(
            (inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta))
        )
    )


def even_directions(count: int) -> FloatArray:
    """Return unit vectors spread evenly over the sphere (a Fibonacci lattice), shape (count, 3)."""
    index = np.arange(count)
    z = 1.0 - (2.0 * index + 1.0) / count
    across = np.sqrt(1.0 - z * z)
    return np.column_stack((across * np.cos(GOLDEN_ANGLE * index), across * np.sin(GOLDEN_ANGLE * index), z))
