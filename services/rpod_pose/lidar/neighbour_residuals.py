"""Residuals of neighbouring returns: a test of the target's model (``ScanModel.misfit``), and their noise."""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_schemas.types import Float32Array

BESIDE, RETURNED = 1, 2
"""Flags of a ray: more than one ray away from the target's outline; its return has a residual.
Numerics: a bit each."""

SCATTER = 1.16
"""Relative standard deviation of an estimate by the median of absolute values, times the root of their
number. Physics: for normal errors, of which it uses 37 %."""
SURE = 2.5
"""Standard deviations by which an estimate must be beyond its limit. Physics: one in 160 normal errors is."""
NOISIER = sqrt(2.0)
"""Least ratio of the noise and the assumed one at which they differ. Numerics: twice the variance."""
MOST_SHARED = 0.25
"""Largest correlation of neighbours' residuals at which they are noise. Hand: a wrong pose or a wrong model
has 0.3 to 0.9, noise has 0; a larger limit accepts wrong poses of scans with a wrong sigma."""
CLIP = 4.0
"""Limit of a residual, in standard deviations, for this correlation. Numerics: outliers do not decide."""


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


@kernel
def noise_over(
    range_m: FloatArray, shown_m: Float32Array, triangle: NDArray[np.int32], sigma_m: float
) -> float:
    """Return the noise of the ranges over the assumed one; 1 where the residuals show no other noise.

    The noise of two pulses is independent. What neighbours share is an error of the pose or of the model, so
    that large residuals with a correlation are no noise.

    Args:
        range_m: measured ranges, 0 without a return, shape (rows, columns).
        shown_m: ranges of the target at a pose, same shape.
        triangle: index of the triangle that each ray meets, -1 for none, same shape.
        sigma_m: assumed standard deviation of a range.
    """
    rows, columns = triangle.shape
    residual_m, sizes_m, count = np.full((rows, columns), np.nan), np.empty(triangle.size), 0
    for i in range(rows):
        for j in range(columns):
            if triangle[i, j] >= 0 and range_m[i, j] > 0.0:
                residual_m[i, j] = range_m[i, j] - shown_m[i, j]
                sizes_m[count] = abs(residual_m[i, j])
                count += 1
    if count == 0:
        return 1.0
    noise_m = MAD_TO_SIGMA * np.median(sizes_m[:count])
    uncertain = SURE * SCATTER / sqrt(count)
    if noise_m * (1.0 + uncertain) * NOISIER < sigma_m:
        return noise_m / sigma_m
    if not noise_m * (1.0 - uncertain) > NOISIER * sigma_m:
        return 1.0
    shared, pairs = _shared(residual_m, CLIP * noise_m)
    independent = pairs > 0 and shared <= MOST_SHARED - 1.0 / sqrt(pairs)
    return noise_m / sigma_m if independent else 1.0


@inner_kernel
def _shared(residual_m: FloatArray, limit_m: float) -> tuple[float, int]:
    """Return the correlation of neighbours' residuals, and the number of pairs.

    Args:
        residual_m: residuals, NaN where there is none, shape (rows, columns).
        limit_m: limit of a residual.
    """
    rows, columns = residual_m.shape
    products, pairs, squares, count = 0.0, 0, 0.0, 0
    for i in range(rows):
        for j in range(columns):
            if np.isnan(residual_m[i, j]):
                continue
            own = min(max(residual_m[i, j], -limit_m), limit_m)
            squares, count = squares + own * own, count + 1
            for k, n in ((i, j + 1), (i + 1, j)):
                if k < rows and n < columns and not np.isnan(residual_m[k, n]):
                    products += own * min(max(residual_m[k, n], -limit_m), limit_m)
                    pairs += 1
    return (products / pairs) / (squares / count) if pairs > 0 and squares > 0.0 else 0.0, pairs
