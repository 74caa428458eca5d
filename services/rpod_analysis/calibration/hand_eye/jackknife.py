"""Covariance of a hand-eye calibration, whose successive errors are correlated.

The covariance is a jackknife over blocks of time (Kuensch, Annals of Statistics 17(3), 1989), which needs no
model of the errors. It is never below that of independent errors.
"""

import numpy as np
from scipy.linalg import eigh

from rpod_schemas.arrays import FloatArray

_BLOCKS = 15
"""Number of blocks of the jackknife: of a minute, 4 s each, longer than the errors of poses are
correlated."""


def independent_covariance(information: FloatArray, prior: FloatArray, scale: float) -> FloatArray:
    """Return the covariance of n parameters for independent errors of the residuals' own size, shape (n, n).

    Args:
        information: information of each of N pairs of poses about the parameters, shape (N, n, n).
        prior: information without them, shape (n, n).
        scale: standard deviation of the residuals over the stated one.
    """
    seen = information.sum(axis=0)
    inverse = np.linalg.inv(seen + prior)
    covariance: FloatArray = inverse @ (scale**2 * seen + prior) @ inverse
    return 0.5 * (covariance + covariance.T)


def lasting_covariance(
    information: FloatArray, scores: FloatArray, prior: FloatArray, independent: FloatArray
) -> FloatArray:
    """Return the covariance from the solutions that lack one block of time each, to first order.

    It is at least that of independent errors, since few blocks say little about the directions in which the
    parameters are known worst.

    Args:
        information: information of each of N pairs of poses about the n parameters, shape (N, n, n).
        scores: their derivatives of the log likelihood by the parameters, shape (N, n).
        prior: information without them, shape (n, n).
        independent: covariance for independent errors, shape (n, n).
    """
    whole = information.sum(axis=0) + prior
    blocks = np.array_split(np.arange(len(scores)), _BLOCKS)
    moves = np.stack(
        [
            np.linalg.solve(whole - information[block].sum(axis=0), scores[block].sum(axis=0))
            for block in blocks
        ]
    )
    moves -= moves.mean(axis=0)
    inverse = np.linalg.inv(whole)
    values, vectors = eigh((_BLOCKS - 1) / _BLOCKS * moves.T @ moves + inverse @ prior @ inverse, independent)
    root = independent @ vectors  # vectors.T @ independent @ vectors = 1
    covariance: FloatArray = (root * np.maximum(values, 1.0)) @ root.T
    return covariance


def block_correlation(white: FloatArray) -> float:
    """Return the correlation of the mean residuals of successive blocks; 0 if blocks are independent.

    The residuals, shape (N, 6), are in the order of time, each over its standard deviation.
    """
    means = np.stack([block.mean(axis=0) for block in np.array_split(white, _BLOCKS)])
    means -= means.mean(axis=0)
    return float((means[1:] * means[:-1]).sum() / max((means**2).sum(), 1e-30))
