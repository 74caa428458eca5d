"""Posterior of a pose from a normal distribution and from likelihoods that are step functions.

A ray beside the outline of a target only shows on which side of the ray the outline is. So its likelihood is
a step function of the pose, p_out + (p_in - p_out) [s + a . (dtau, dtheta) > 0]. Many such rays bound the
pose from all sides. Their product with a normal distribution is approximated by a normal distribution, by
expectation propagation (T. Minka, Expectation Propagation for Approximate Bayesian Inference, UAI 2001;
section 4, the Bayes point machine). The result is the mean of the pose and its covariance.
"""

from math import erf, exp, pi, sqrt
from typing import NamedTuple

import numpy as np

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_schemas.arrays import FloatArray

SWEEPS = 8
"""Largest number of passes over all steps. Numerics: a budget; ``SETTLED`` ends most of them."""
SETTLED = 3e-2
"""Largest change of the mean in the last pass, in standard deviations. Numerics: a thirtieth of the error."""
CERTAIN = 5.0
"""Least distance from a step, in standard deviations, at which a consistent measurement gives no information.
Physics: one in 3.5 million normal errors is larger to one side."""


class Steps(NamedTuple):
    """Measurements, such as rays beside an outline, whose likelihoods are step functions of the pose."""

    number: int
    """Number of measurements, E; the arrays may be longer."""
    rows: FloatArray
    """Derivatives a of the distance with respect to (dtau, dtheta), shape (E, 6)."""
    distance_m: FloatArray
    """Distance s from the step at the pose, positive inside, shape (E,)."""
    odds: FloatArray
    """Logarithm of p_in / p_out, shape (E,)."""


class Normal(NamedTuple):
    """A normal distribution of a step (dtau, dtheta), which is updated in place."""

    mean: FloatArray
    """Mean, shape (6,)."""
    covariance: FloatArray
    """Covariance, shape (6, 6)."""
    spread: FloatArray
    """Work memory for a covariance with one distance, shape (6,)."""


class Factors(NamedTuple):
    """Normal factors that approximate the steps."""

    precision: FloatArray
    """Precision, shape (E,)."""
    shift: FloatArray
    """Precision times mean, shape (E,)."""


class Posterior(NamedTuple):
    """A normal distribution of a step (dtau, dtheta)."""

    mean: FloatArray
    """Mean, shape (6,)."""
    information: FloatArray
    """Information matrix that the steps add to that of the ranges, shape (6, 6)."""


@kernel
def propagated(
    steps: Steps, information: FloatArray, gradient: FloatArray, hold: FloatArray, blur_m: float
) -> Posterior:
    """Return the posterior of a step (dtau, dtheta) by expectation propagation.

    Args:
        steps: likelihoods of the rays beside the outline.
        information: information matrix of the ranges, shape (6, 6).
        gradient: gradient of the ranges at a step of 0, shape (6,).
        hold: prior information that the step is zero, above 0, shape (6,).
        blur_m: standard deviation of the place of the outline.
    """
    covariance: FloatArray = np.linalg.inv(information + np.diag(hold)).astype(np.float64)
    mean: FloatArray = covariance @ -gradient
    factors = Factors(np.zeros(steps.number), np.zeros(steps.number))
    state = Normal(mean, covariance, np.empty(6))
    for sweep in range(SWEEPS):
        before = mean.copy()
        for e in range(steps.number):
            _assimilate(steps, e, state, factors, blur_m)
        worst = 0.0
        for k in range(6):
            worst = max(worst, abs(mean[k] - before[k]) / sqrt(max(covariance[k, k], 1e-300)))
        if sweep > 0 and worst < SETTLED:
            break
    added = np.zeros((6, 6))
    for e in range(steps.number):
        row = steps.rows[e]
        for i in range(6):
            for k in range(6):
                added[i, k] += factors.precision[e] * row[i] * row[k]
    return Posterior(mean, added)


@inlined_kernel
def _assimilate(steps: Steps, e: int, state: Normal, factors: Factors, blur_m: float) -> None:
    """Replace the normal factor that approximates one step, and update the distribution.

    Args:
        steps: all steps.
        e: index of the step.
        state: distribution by all factors, input and output.
        factors: the factors, input and output.
        blur_m: standard deviation of the place of a step.
    """
    mean, covariance, row, spread = state.mean, state.covariance, steps.rows[e], state.spread
    precision, shift = factors.precision, factors.shift
    v, m = 0.0, steps.distance_m[e]
    for i in range(6):
        spread[i] = 0.0
        for k in range(6):
            spread[i] += covariance[i, k] * row[k]
        v += row[i] * spread[i]
        m += row[i] * mean[i]
    sure = m * steps.odds[e] > 0.0 and m * m > CERTAIN**2 * (v + blur_m * blur_m)
    rest = 1.0 / v - precision[e]
    if (sure and precision[e] == 0.0) or not (v > 0.0 and rest > 1e-9 / v):
        return
    new, moved = _matched((m / v - shift[e]) / rest, 1.0 / rest, steps.odds[e], blur_m)
    change, push = new - precision[e], moved - shift[e]
    precision[e], shift[e] = new, moved
    gain = 1.0 / (1.0 + change * v)
    for i in range(6):
        mean[i] += gain * spread[i] * (push - change * m)
        for k in range(6):
            covariance[i, k] -= change * gain * spread[i] * spread[k]


@inner_kernel
def _matched(centre: float, variance: float, odds: float, blur_m: float) -> tuple[float, float]:
    """Return precision and precision times mean of the normal factor that approximates a step.

    Its product with a normal distribution has the same mean and variance as the product with the step
    p_out + (p_in - p_out) Phi(s / blur), whose larger level is 1. A step that would make the distribution
    wider counts as no information; this happens if the step almost certainly does not hold.

    Args:
        centre: mean of the distance s without the step, m.
        variance: variance of this distance, m2.
        odds: logarithm of p_in / p_out.
        blur_m: blur.
    """
    inside, outside = min(1.0, exp(odds)), min(1.0, exp(-odds))
    sigma = sqrt(variance + blur_m * blur_m)
    z = centre / sigma
    share = 0.5 * (1.0 + erf(z / sqrt(2.0)))
    total = outside + (inside - outside) * share
    if not total > 1e-12:
        total = 1e-12
    slope = (inside - outside) * exp(-0.5 * z * z) / (sqrt(2.0 * pi) * sigma * total)
    bend = slope * (slope + z / sigma)
    left = max(1.0 - variance * bend, 1e-6)
    if not 0.0 < bend < np.inf:
        return 0.0, 0.0
    return bend / left, (centre + variance * slope) / (variance * left) - centre / variance
