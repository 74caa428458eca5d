"""Posterior of a pose from few returns, computed from samples near the pose.

With few returns, the likelihood has several optima within some degrees, and none is much likelier than the
others. Therefore mean, covariance and mass of the posterior near a pose are computed from samples. Each round
draws from Student's distribution with the mean and the covariance of the earlier rounds. All samples are
weighted by the likelihood over the mixture of all rounds' distributions (adaptive multiple importance
sampling, J.-M. Cornuet, J.-M. Marin, A. Mira, C. P. Robert, Adaptive Multiple Importance Sampling,
Scandinavian Journal of Statistics 39, 2012). While a few samples have nearly all the weight, mean and
covariance of the next round are computed with the weights raised to a power below 1.
"""

from functools import cache
from math import lgamma, log, pi
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv, ndtri

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.near_poses import (
    NearPoses,
    NearTriangles,
    apart,
    cast_near,
    is_near,
    near_triangles,
    no_triangles,
)
from rpod_geometry.rays import RenderBuffers
from rpod_pose.lidar.scan_likelihood import Assumptions, Rays, rendered_likelihood
from rpod_pose.registration.lie_group import PoseArrays, stepped
from rpod_pose.registration.surface_model import cast_faces
from rpod_pose.search.even_samples import sobol
from rpod_schemas.arrays import FloatArray

FREEDOM = 4.0
"""Degrees of freedom of Student's distribution. Numerics: its tails reach poses that earlier rounds did
not."""
ROUNDS, SAMPLES = 12, 64
"""Largest number of rounds, and number of samples in each. Numerics: a budget of computation."""
SPREAD = 24.0
"""Least effective number of samples from which a covariance is computed. Numerics: four for each unknown."""
ENOUGH = 48.0
"""Effective number of samples that ends the rounds. Numerics: the mean is then known to a seventh of a
sigma."""
OF_POSE = 6
"""Number of unknowns of a pose. Physics: three of position, three of attitude."""
HALVINGS = 20
"""Number of bisections for the power of the weights. Numerics: the power is then known to 1e-6."""
IMPOSSIBLE = -1e9
"""Log likelihood of a step whose rotation is larger than 180 deg. Numerics: its weight is zero; a shorter
step leads to the same attitude."""


MOST_NEAR, ENOUGH_NEAR, NARROWER = 0.9, 0.75, 1.0 / 3.0
"""Limits for the lists of triangles that each ray may meet near a pose: share of a round's samples that new
lists cover; least share of samples that old lists must cover; largest width of the samples, over that of the
old lists, at which new ones are made. Numerics: measured times; the lists do not change a likelihood."""
WIDEST = 0.1
"""Largest motion of the target by the samples, over its size, at which lists of triangles save time.
Numerics: measured times of 560 and 11,540 triangles."""


class Proposal(NamedTuple):
    """Distribution from which the samples of the first round are drawn."""

    covariance: FloatArray
    """Rough covariance of (dtau, dtheta), too large rather than too small, shape (6, 6)."""
    steps: FloatArray
    """Result of ``draws``."""


class SampledPosterior(NamedTuple):
    """Posterior near a pose, in steps (dtau, dtheta) from this pose, m and rad."""

    mean: FloatArray
    """Mean, shape (6,)."""
    covariance: FloatArray
    """Covariance of the true pose about this mean, shape (6, 6)."""
    log_mass: float
    """Logarithm of the integral of the likelihood over (dtau, dtheta), m3 rad3."""
    likeliest: FloatArray
    """Likeliest sample, shape (6,)."""
    effective: float
    """Effective number of samples: that of equal weights with the same accuracy."""


@cache
def draws() -> FloatArray:
    """Return evenly spread samples of Student's distribution, deterministic, (ROUNDS, SAMPLES, 6)."""
    even = sobol(7, 10)[: ROUNDS * SAMPLES].clip(1e-4, 1.0 - 1e-4)
    chi_squared = 2.0 * gammaincinv(0.5 * FREEDOM, even[:, 6:])
    steps: FloatArray = ndtri(even[:, :6]) * np.sqrt(FREEDOM / chi_squared)
    return steps.reshape(ROUNDS, SAMPLES, 6)


@kernel
def sampled_posterior(
    range_m: FloatArray,
    start: PoseArrays,
    rays: Rays,
    assumed: Assumptions,
    proposal: Proposal,
) -> SampledPosterior:
    """Return the posterior near a pose, for equal prior densities of all poses.

    Args:
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        start: pose of the target in the sensor.
        rays: rays, target and buffers.
        assumed: statistics of returns.
        proposal: distribution from which the samples of the first round are drawn.
    """
    covariance, steps = proposal
    rounds, samples = steps.shape[0], steps.shape[1]
    total = rounds * samples
    x, logs, mixture = np.empty((total, 6)), np.empty(total), np.zeros(total)
    means, roots = np.zeros((rounds, 6)), np.zeros((rounds, 6, 6))
    mean, spread, least = np.zeros(6), covariance.copy(), 1e-6 * np.diag(np.diag(covariance))
    weights, effective, known = np.zeros(total), 0.0, 0
    near = no_triangles(start.R, start.t)
    for number in range(rounds):
        means[number], roots[number] = mean, np.linalg.cholesky(spread + least)
        for n in range(samples):
            x[known + n] = mean + roots[number] @ steps[number, n]
        taken = x[known : known + samples]
        near = _near(near, taken, start, mean, rays)
        _fill_logs(logs[known : known + samples], taken, range_m, start, near, rays, assumed)
        for before in range(number):
            _add_density(mixture[known : known + samples], x[known:], means[before], roots[before])
        known += samples
        _add_density(mixture[:known], x, mean, roots[number])
        ratios = logs[:known] - np.log(mixture[:known] / (number + 1.0))
        power = _power(ratios)
        weights = _weights(ratios, power)
        mean, spread = _moments(x[:known], weights)
        weights = _weights(ratios, 1.0)
        effective = _effective(weights)
        if effective >= ENOUGH:
            break
    if effective >= SPREAD:
        mean, spread = _moments(x[:known], weights)
    spread *= _small_sample_factor(max(effective, SPREAD))
    ratios = logs[:known] - np.log(mixture[:known] * (samples / known))
    most = ratios.max()
    log_mass = most + log(np.exp(ratios - most).mean())
    return SampledPosterior(mean, spread + least, log_mass, x[np.argmax(logs[:known])], effective)


@kernel
def log_likelihoods(
    range_m: FloatArray, start: PoseArrays, steps: FloatArray, rays: Rays, assumed: Assumptions
) -> FloatArray:
    """Return the log likelihoods of a scan at steps from a pose, shape (N,).

    Args:
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        start: pose of the target in the sensor.
        steps: steps (dtau, dtheta), shape (N, 6).
        rays: rays, target and buffers.
        assumed: statistics of returns.
    """
    logs = np.empty(len(steps))
    _fill_logs(logs, steps, range_m, start, no_triangles(start.R, start.t), rays, assumed)
    return logs


@inner_kernel
def _near(
    near: NearTriangles, x: FloatArray, start: PoseArrays, mean: FloatArray, rays: Rays
) -> NearTriangles:
    """Return lists of the triangles that rays may meet at most of the samples; old lists if they suffice.

    Args:
        near: the old lists.
        x: samples, shape (N, 6).
        start: pose from which the samples are steps.
        mean: mean of the samples, shape (6,).
        rays: rays and target.
    """
    middle = stepped(start, mean)
    apart_m, turn_rad, held = np.empty(len(x)), np.empty(len(x)), 0
    for n in range(len(x)):
        pose = stepped(start, x[n])
        apart_m[n], turn_rad[n] = apart(middle.R, middle.t, pose.R, pose.t)
        held += is_near(near.poses, pose.R, pose.t)
    most = int(MOST_NEAR * len(x))
    poses = NearPoses(middle.R, middle.t, np.sort(apart_m)[most - 1], np.sort(turn_rad)[most - 1])
    box_m, size2 = rays.faces.tree.boxes_m[0], 0.0
    for k in range(3):
        size2 += max(-box_m[k], box_m[3 + k]) ** 2
    size_m = np.sqrt(size2)
    wide_m = poses.apart_m + poses.turn_rad * size_m
    known_m = near.poses.apart_m + near.poses.turn_rad * size_m
    if wide_m > WIDEST * size_m or (held >= ENOUGH_NEAR * len(x) and wide_m > NARROWER * known_m):
        return near
    return near_triangles(rays.grid, rays.faces.tree, poses)


@inner_kernel
def _fill_logs(  # noqa: PLR0917
    logs: FloatArray,
    x: FloatArray,
    range_m: FloatArray,
    start: PoseArrays,
    near: NearTriangles,
    rays: Rays,
    assumed: Assumptions,
) -> None:
    """Fill the log likelihoods of a scan at samples.

    Args:
        logs: output, shape (N,).
        x: samples, shape (N, 6).
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        start: pose from which the samples are steps.
        near: lists of the triangles that the rays may meet at poses near each other.
        rays: rays, target and buffers.
        assumed: statistics of returns.
    """
    tree, buffers = rays.faces.tree, RenderBuffers(rays.range_m, rays.face)
    for n in range(len(x)):
        logs[n] = IMPOSSIBLE
        if (x[n, 3:] ** 2).sum() > pi * pi:
            continue
        pose = stepped(start, x[n])
        if is_near(near.poses, pose.R, pose.t):
            cast_near(rays.grid, tree, near, pose.R, pose.t, rays.range_m, rays.face)
        else:
            cast_faces(rays.grid, rays.faces, pose.R, pose.t, buffers)
        logs[n] = rendered_likelihood(range_m, pose, rays, assumed)[0]


@inner_kernel
def _add_density(density: FloatArray, x: FloatArray, mean: FloatArray, root: FloatArray) -> None:
    """Add the density of Student's distribution at samples.

    Args:
        density: input and output, shape (N,).
        x: samples, at least N of them, shape (M, 6).
        mean: centre of the distribution, shape (6,).
        root: lower triangular root of its scale, shape (6, 6).
    """
    constant = lgamma(0.5 * (FREEDOM + 6.0)) - lgamma(0.5 * FREEDOM) - 3.0 * log(FREEDOM * pi)
    for k in range(6):
        constant -= log(root[k, k])
    z = np.empty(6)
    for n in range(density.size):
        squares = 0.0
        for i in range(6):
            z[i] = x[n, i] - mean[i]
            for k in range(i):
                z[i] -= root[i, k] * z[k]
            z[i] /= root[i, i]
            squares += z[i] * z[i]
        density[n] += np.exp(constant - 0.5 * (FREEDOM + 6.0) * np.log1p(squares / FREEDOM))


@inner_kernel
def _weights(ratios: FloatArray, power: float) -> FloatArray:
    """Return weights that sum to 1, shape (N,), from logarithms of weights that are raised to a power."""
    weights = np.exp(power * (ratios - ratios.max()))
    normed: FloatArray = weights / weights.sum()
    return normed


@inner_kernel
def _effective(weights: FloatArray) -> float:
    """Return the effective number of samples for weights that sum to 1, shape (N,)."""
    return float(1.0 / (weights * weights).sum())


@inner_kernel
def _power(ratios: FloatArray) -> float:
    """Return the largest power, at most 1, of weights with which ``SPREAD`` samples are effective.

    Args:
        ratios: logarithms of the weights, shape (N,).
    """
    if _effective(_weights(ratios, 1.0)) >= SPREAD:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _effective(_weights(ratios, middle)) < SPREAD:
            high = middle
        else:
            low = middle
    return low


@inner_kernel
def _small_sample_factor(number: float) -> float:
    """Return the factor that corrects a covariance for the number of samples from which it was computed.

    For n normal samples of d unknowns, the inverse of such a covariance is too large by the factor
    (n - 1) / (n - d - 2) on average (T. W. Anderson, An Introduction to Multivariate Statistical Analysis,
    2003, lemma 7.7.1). The error of the mean adds 1 / n of the covariance.
    """
    return (1.0 + 1.0 / number) * (number - 1.0) / (number - OF_POSE - 2.0)


@inner_kernel
def _moments(x: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean, shape (6,), and covariance, shape (6, 6), of weighted samples, shape (N, 6)."""
    mean, covariance = np.zeros(6), np.zeros((6, 6))
    for n in range(weights.size):
        for i in range(6):
            mean[i] += weights[n] * x[n, i]
    for n in range(weights.size):
        for i in range(6):
            for k in range(6):
                covariance[i, k] += weights[n] * (x[n, i] - mean[i]) * (x[n, k] - mean[k])
    return mean, covariance
