"""Likelihood of a scan at a pose, ray by ray: actual, expected, and which rays agree.

These are the kernels of ``scan_fit``. The range error of a return from a surface has Student's distribution
with four degrees of freedom, with the scale that the sensor states: a normal error whose variance is only
roughly known (by a scaled inverse chi-square distribution with four degrees of freedom). Its tails cover
outliers, so that neither their number nor their size has to be known.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_geometry.rays import GridArrays, cast_pose
from rpod_pose.lidar.detection import LEAST_LOG, RUNGS, RUNGS_PER_LOG, Detection
from rpod_pose.registration.lie_group import turned
from rpod_pose.registration.surface_model import Faces
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

STEEPEST = 0.05
"""Least cosine of incidence in the effect of a surface's slack along the ray."""
PEAK = 0.375
"""Density of Student's distribution with 4 degrees of freedom at zero, in units of one over its scale."""
HIT_MEAN, HIT_VARIANCE = 1.6818, 0.9661
"""Mean and variance of minus the logarithm of that density, integrated numerically."""


class Assumptions(NamedTuple):
    """Assumed statistics of returns."""

    sigma_m: float
    """Scale of a range error."""
    slack_m: float
    """Standard deviation of a face's position along its normal."""
    clutter_share: float
    """Share of rays whose result, return or none, is unrelated to the target."""
    clutter_density: float
    """Number of unrelated returns per ray and metre of range, 1/m."""
    least_range_m: float
    """Range at which a white surface at normal incidence gives a return for every other pulse, at least."""
    detection: Detection
    """Probabilities that rays give returns."""


class Rays(NamedTuple):
    """The rays of a pattern, the target that they are cast at, and buffers of shape (rows, columns)."""

    grid: GridArrays
    """``RayGrid.arrays``."""
    faces: Faces
    """``SurfaceModel.faces``."""
    range_m: Float32Array
    """Predicted range."""
    face: NDArray[np.int32]
    """Predicted face, -1 for none."""


class Draws(NamedTuple):
    """Samples of a pose's neighbourhood."""

    normal: FloatArray
    """Standard normal samples, shape (rounds, samples, 6)."""
    elite: int
    """Number of best samples of a round that determine the next round's distribution."""


class ScanStatistics(NamedTuple):
    """Statistics of a scan at a pose."""

    log_likelihood: float
    """Log likelihood, relative to that of an empty sky."""
    expected: float
    """Mean of the log likelihood over the scans that the pose predicts."""
    variance: float
    """Variance of the log likelihood over these scans."""
    agreeing: int
    """Number of returns that the predicted face explains better than clutter does."""
    inconsistent: int
    """Number of all other returns."""
    missing: float
    """Number of rays that meet a face and gave no return, above the number expected for their echoes."""


@kernel
def scan_statistics(
    range_m: FloatArray, R: FloatArray, t: FloatArray, rays: Rays, assumed: Assumptions
) -> ScanStatistics:
    """Return the statistics of a scan at a pose R, t of the target in the sensor.

    Args:
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        rays: rays, target and buffers.
        assumed: statistics of returns.
    """
    cast_pose(rays.grid, rays.faces[0], R, t, True, rays.range_m, rays.face)
    log, power = _log_likelihood(range_m, R, rays, assumed)
    mean, variance = _expectation(R, rays, assumed, power)
    counts = _agreement(range_m, R, rays, assumed, power)
    return ScanStatistics(log, mean, variance, counts[0], counts[1], counts[2])


@kernel
def log_likelihood(
    range_m: FloatArray, R: FloatArray, t: FloatArray, rays: Rays, assumed: Assumptions
) -> float:
    """Return the log likelihood of ``scan_statistics`` alone."""
    cast_pose(rays.grid, rays.faces[0], R, t, True, rays.range_m, rays.face)
    return _log_likelihood(range_m, R, rays, assumed)[0]


@kernel
def agreement_counts(
    range_m: FloatArray, R: FloatArray, t: FloatArray, rays: Rays, assumed: Assumptions
) -> tuple[int, int, float]:
    """Return the counts of ``scan_statistics`` alone: agreeing, inconsistent, missing."""
    cast_pose(rays.grid, rays.faces[0], R, t, True, rays.range_m, rays.face)
    power = _log_likelihood(range_m, R, rays, assumed)[1]
    return _agreement(range_m, R, rays, assumed, power)


@kernel
def _met(R: FloatArray, rays: Rays, least_range_m: float, i: int, j: int) -> tuple[float, float, int]:
    """Return a ray's predicted range, m, its cosine of incidence, and the step of its echo in the table."""
    directions, (_, normals, _, albedo) = rays.grid[0], rays.faces
    face = rays.face[i, j]
    dx, dy, dz = directions[0, i, j], directions[1, i, j], directions[2, i, j]
    cosine = 0.0
    for k in range(3):
        cosine -= normals[face, k] * (R[0, k] * dx + R[1, k] * dy + R[2, k] * dz)
    r = np.float64(rays.range_m[i, j])
    echo = cosine * albedo[face] * (least_range_m / r) ** 2
    rung = int((np.log(max(echo, 1e-9)) - LEAST_LOG) * RUNGS_PER_LOG)
    return r, cosine, min(max(rung, 0), RUNGS - 1)


@kernel
def _density(error_m: float, cosine: float, assumed: Assumptions) -> float:
    """Return the density of a range error on a face, 1/m."""
    lateral_m = assumed.slack_m / max(cosine, STEEPEST)
    variance = assumed.sigma_m * assumed.sigma_m + lateral_m * lateral_m
    tail = 1.0 + 0.25 * error_m * error_m / variance
    density: float = PEAK / (np.sqrt(variance * tail) * tail * tail)
    return density


@kernel
def _log_likelihood(
    range_m: FloatArray, R: FloatArray, rays: Rays, assumed: Assumptions
) -> tuple[float, int]:
    """Return a scan's log likelihood relative to an empty sky, and the index of the likeliest ``half``.

    A return that clutter explains better than the face does is not counted as detected.
    """
    log_density, log_clear = np.log(assumed.clutter_density), np.log(1.0 - assumed.clutter_share)
    returned, missing, total = np.zeros(RUNGS), np.zeros(RUNGS), 0.0
    for i in range(rays.face.shape[0]):
        for j in range(rays.face.shape[1]):
            m = range_m[i, j]
            if rays.face[i, j] < 0:
                if m > 0.0:
                    total += log_density - log_clear
                continue
            r, cosine, rung = _met(R, rays, assumed.least_range_m, i, j)
            total -= log_clear
            if m <= 0.0:
                missing[rung] += 1.0
                continue
            near = _density(m - r, cosine, assumed)
            total += np.log(near + assumed.clutter_density)
            if near > assumed.clutter_density:
                returned[rung] += 1.0
    evidence, power = _detected(returned, missing, assumed.detection)
    return total + evidence, power


@kernel
def _detected(returned: FloatArray, missing: FloatArray, detection: Detection) -> tuple[float, int]:
    """Return the log mean likelihood of the detections over ``HALVES``, and the index of the likeliest one.

    Args:
        returned: number of rays with a return, by echo, shape (RUNGS,).
        missing: number of rays without a return, by echo, shape (RUNGS,).
        detection: probabilities of a return.
    """
    logs = np.zeros(detection.share.shape[0])
    for h in range(logs.size):
        for rung in range(RUNGS):
            logs[h] += returned[rung] * detection.log_share[h, rung]
            logs[h] += missing[rung] * detection.log_missing[h, rung]
    power = int(np.argmax(logs))
    evidence: float = logs[power] + np.log(np.mean(np.exp(logs - logs[power])))
    return evidence, power


@kernel
def _expectation(R: FloatArray, rays: Rays, assumed: Assumptions, power: int) -> tuple[float, float]:
    """Return mean and variance of the log likelihood over the scans that the pose predicts."""
    log_clear, mean, variance = np.log(1.0 - assumed.clutter_share), 0.0, 0.0
    share, log_share, log_missing = assumed.detection
    for i in range(rays.face.shape[0]):
        for j in range(rays.face.shape[1]):
            if rays.face[i, j] < 0:
                continue
            _, cosine, rung = _met(R, rays, assumed.least_range_m, i, j)
            p, miss = share[power, rung], log_missing[power, rung]
            lateral_m = assumed.slack_m / max(cosine, STEEPEST)
            scale = np.log(assumed.sigma_m * assumed.sigma_m + lateral_m * lateral_m)
            hit = log_share[power, rung] - 0.5 * scale - HIT_MEAN
            mean += p * hit + (1.0 - p) * miss - log_clear
            variance += p * (1.0 - p) * (hit - miss) ** 2 + HIT_VARIANCE * p
    return mean, variance


@kernel
def _agreement(
    range_m: FloatArray, R: FloatArray, rays: Rays, assumed: Assumptions, power: int
) -> tuple[int, int, float]:
    """Return the numbers of returns that agree, that are inconsistent, and that are missing.

    Missing returns are counted separately for each echo: no sensor misses bright surfaces and detects dark
    ones. The number at each echo is reduced by one standard deviation.
    """
    agreeing, inconsistent = 0, 0
    missed, expected = np.zeros(RUNGS), np.zeros(RUNGS)
    for i in range(rays.face.shape[0]):
        for j in range(rays.face.shape[1]):
            m = range_m[i, j]
            if rays.face[i, j] < 0:
                inconsistent += m > 0.0
                continue
            r, cosine, rung = _met(R, rays, assumed.least_range_m, i, j)
            expected[rung] += 1.0 - assumed.detection.share[power, rung]
            if m <= 0.0:
                missed[rung] += 1.0
            elif _density(m - r, cosine, assumed) > assumed.clutter_density:
                agreeing += 1
            else:
                inconsistent += 1
    missing = 0.0
    for rung in range(RUNGS):
        missing += max(0.0, missed[rung] - expected[rung] - np.sqrt(expected[rung]))
    return agreeing, inconsistent, missing


@kernel
def likeliest(  # noqa: PLR0917
    range_m: FloatArray,
    R: FloatArray,
    t: FloatArray,
    rays: Rays,
    assumed: Assumptions,
    covariance: FloatArray,
    draws: Draws,
) -> tuple[FloatArray, FloatArray]:
    """Return the likeliest pose R, t near a given one (``scan_fit.ScanModel.outline_refined``).

    The samples of the first round have the given covariance of (dtau, dtheta), shape (6, 6); those of each
    next round have that of the best samples of the round before. The other arguments are as in
    ``scan_statistics``.
    """
    normal, elite = draws
    best_R, best_t = R, t
    best = log_likelihood(range_m, R, t, rays, assumed)
    steps, scores, spread = np.empty(normal.shape[1:]), np.empty(normal.shape[1]), covariance
    for number in range(normal.shape[0]):
        root = np.linalg.cholesky(spread + 1e-12 * np.eye(6))
        centre_R, centre_t = best_R, best_t
        for n in range(normal.shape[1]):
            steps[n] = root @ normal[number, n]
            moved_R, moved_t = turned(centre_R, steps[n, 3:]), centre_t + centre_R @ steps[n, :3]
            scores[n] = log_likelihood(range_m, moved_R, moved_t, rays, assumed)
            if scores[n] > best:
                best, best_R, best_t = scores[n], moved_R, moved_t
        leading = steps[np.argsort(-scores)[:elite]]
        middle = np.zeros(6)
        for row in leading:
            middle += row / elite
        spread = np.zeros((6, 6))
        for row in leading:
            spread += np.outer(row - middle, row - middle) / elite
    return best_R, best_t
