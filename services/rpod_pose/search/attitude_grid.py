"""Attitudes spread evenly over all of SO(3), and directions over the sphere."""

from functools import lru_cache
from math import cos, radians

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
"""Angle between successive points of an even spiral on a sphere, rad. Physics: the golden section of a
turn."""
BORESIGHT = np.array([0.0, 0.0, 1.0])
"""Direction in which a sensor looks. Physics: +z (ICD section 1)."""


def super_fibonacci(count: int) -> Rotation:
    """Return ``count`` evenly spread attitudes, R_sensor_target; deterministic.

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


@lru_cache(maxsize=16)
def attitudes_of(count: int) -> Float32Array:
    """Return ``super_fibonacci`` as matrices, shape (count, 3, 3); cached, so the result is read-only."""
    return super_fibonacci(count).as_matrix().astype(np.float32)


def within(attitudes: Float32Array, around: FloatArray, angle_deg: float) -> NDArray[np.bool_]:
    """Return which attitudes, shape (M, 3, 3), lie within an angle of another attitude, shape (M,)."""
    near: NDArray[np.bool_] = np.einsum("mij,ij->m", attitudes, around) >= 1.0 + 2.0 * cos(radians(angle_deg))
    return near
