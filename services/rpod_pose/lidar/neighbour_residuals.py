"""Sums over the residuals of neighbouring returns, which test the target's model (``ScanModel.misfit``)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

BESIDE, RETURNED = 1, 2
"""Flags of a ray: more than one ray away from the target's outline; its return has a residual.
Numerics: a bit each."""


class NeighbourSums(NamedTuple):
    """Sums over pairs of horizontal or vertical neighbours."""

    product_m2: float
    """Sum of the products of two residuals."""
    squares_m4: float
    """Sum of the squared products."""
    products: int
    """Number of the products."""
    chance_m2: float
    """Sum of products that is expected by chance of the returns beside the target."""


@kernel
def neighbour_sums(
    range_m: FloatArray, shown_m: Float32Array, triangle: NDArray[np.int32], limit_m: float
) -> NeighbourSums:
    """Return the sums over the residuals of neighbouring returns.

    Args:
        range_m: measured ranges, 0 without a return, shape (rows, columns).
        shown_m: ranges of the target at a pose, same shape.
        triangle: index of the triangle that each ray meets, -1 for none, same shape.
        limit_m: limit of a residual, and the residual of a return beside the target.
    """
    rows, columns = triangle.shape
    residual_m, flags = np.zeros((rows, columns)), np.zeros((rows, columns), np.uint8)
    free, false = 0, 0
    for i in range(rows):
        for j in range(columns):
            met, m = triangle[i, j] >= 0, range_m[i, j]
            beside = not met and _is_beside(triangle, i, j)
            returned = m > 0.0 and (met or beside)
            flags[i, j] = BESIDE * beside + RETURNED * returned
            free += beside
            false += beside and returned
            if returned:
                residual_m[i, j] = min(max(m - shown_m[i, j], -limit_m), limit_m) if met else limit_m
    total, squares, products, pairs = 0.0, 0.0, 0, 0
    for i in range(rows):
        for j in range(columns):
            for k, n in ((i, j + 1), (i + 1, j)):
                if k == rows or n == columns:
                    continue
                both = flags[i, j] & flags[k, n]
                pairs += (both & BESIDE) > 0
                if both & RETURNED:
                    product = residual_m[i, j] * residual_m[k, n]
                    total += product
                    squares += product * product
                    products += 1
    share = false / max(free, 1)
    return NeighbourSums(total, squares, products, (share * limit_m) ** 2 * pairs)


@inner_kernel
def _is_beside(triangle: NDArray[np.int32], i: int, j: int) -> bool:
    """Return whether neither a ray nor one of its eight neighbours meets the target.

    Args:
        triangle: index of the triangle that each ray meets, -1 for none, shape (rows, columns).
        i: row of the ray.
        j: its column.
    """
    rows, columns = triangle.shape
    for k in range(max(i - 1, 0), min(i + 2, rows)):
        for n in range(max(j - 1, 0), min(j + 2, columns)):
            if triangle[k, n] >= 0:
                return False
    return True
