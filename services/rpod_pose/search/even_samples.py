"""Evenly spread points in a unit cube, and steps with a given covariance; both are deterministic."""

from functools import cache

import numpy as np
import scipy
from scipy.special import ndtri

from rpod_schemas.arrays import FloatArray
from rpod_target.tables import kept

_SEED = 1
"""Seed of the scrambling. Numerics: the points are equally even with any seed."""
_WIDENED = 1e-6
"""Share of its variances that is added to a covariance before its Cholesky decomposition. Numerics: rounding
may leave a nearly singular covariance with a negative eigenvalue; steps change by half of this share."""


def sobol(dimensions: int, power: int) -> FloatArray:
    """Return 2^power points of a scrambled Sobol sequence, deterministic, shape (2^power, dimensions)."""
    inputs = dimensions, power, _SEED, scipy.__version__
    return kept("sobol", 1, inputs, lambda: {"points": _computed(dimensions, power)})["points"]


def steps_of(covariance: FloatArray, power: int) -> FloatArray:
    """Return 2^power normal steps with a covariance of shape (6, 6), shape (2^power, 6)."""
    widened = covariance + _WIDENED * np.diag(np.diag(covariance))
    steps: FloatArray = normal_steps(power) @ np.linalg.cholesky(widened).T
    return steps


@cache
def normal_steps(power: int) -> FloatArray:
    """Return 2^power standard normal steps in six dimensions, deterministic, shape (2^power, 6)."""
    steps: FloatArray = ndtri(sobol(6, power))
    return steps


def _computed(dimensions: int, power: int) -> FloatArray:
    from scipy.stats import qmc  # noqa: PLC0415 - takes half a second of each start

    return np.asarray(qmc.Sobol(dimensions, seed=_SEED).random_base2(power), np.float64)
