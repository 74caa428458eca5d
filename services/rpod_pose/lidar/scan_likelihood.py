"""What a scan says of a pose, ray by ray: its log likelihood, what that was to be expected, which rays agree.

The kernels of ``scan_fit``. A return from a surface errs by Student's distribution with four degrees of
freedom, whose scale is what the sensor says of itself: a normal error whose variance is known roughly (by a
scaled inverse chi-square distribution with four degrees of freedom). Its tails take outliers without being
told how many there are, or how large.
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
"""Cosine of incidence below which a surface's slack along the ray grows no more."""
PEAK = 0.375
"""Density of Student's distribution (4) at zero, in units of one over its scale."""
HIT_MEAN, HIT_VARIANCE = 1.6818, 0.9661
"""Mean and variance of minus the logarithm of that density, integrated numerically."""


class Assumptions(NamedTuple):
    """What is expected of a return."""

    sigma_m: float
    """Scale of a range error."""
    slack_m: float
    """Standard deviation of a face across its plane."""
    clutter_share: float
    """Share of rays whose return, or its lack, says nothing."""
    clutter_density: float
    """Such returns a ray and metre of range, 1/m."""
    least_range_m: float
    """At which a white surface seen squarely is detected by half or more."""
    detection: Detection
    """Which rays come back."""


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
    """How a pose's neighbourhood is sampled."""

    normal: FloatArray
    """Standard normal samples, shape (rounds, samples, 6)."""
    elite: int
    """How many of the best of a round lead the next."""


class Judgement(NamedTuple):
    """What a scan says of a pose."""

    log_likelihood: float
    """Against that of an empty sky."""
    expected: float
    """Its mean over the scans that the pose lets expect."""
    variance: float
    """Its variance over these."""
    agreeing: int
    """Returns that the predicted face explains better than clutter does."""
    contrary: int
    """Other returns."""
    missing: float
    """Rays that meet a face and did not come back, beyond the number that is expected of their echo."""


@kernel
def judged(range_m: FloatArray, R: FloatArray, t: FloatArray, rays: Rays, assumed: Assumptions) -> Judgement:
    """Return the ``Judgement`` on a pose R, t of the target in the sensor.

    Args:
        range_m: of each ray, 0 where no return, shape (rows, columns).
        R: shape (3, 3).
        t: shape (3,), m.
        rays: ``Rays``.
        assumed: ``Assumptions``.
    """
    cast_pose(rays.grid, rays.faces[0], R, t, True, rays.range_m, rays.face)
    told, power = _log_likelihood(range_m, R, rays, assumed)
    mean, variance = _expectation(R, rays, assumed, power)
    counts = _agreement(range_m, R, rays, assumed, power)
    return Judgement(told, mean, variance, counts[0], counts[1], counts[2])


@kernel
def log_likelihood(
    range_m: FloatArray, R: FloatArray, t: FloatArray, rays: Rays, assumed: Assumptions
) -> float:
    """Return that part of ``judged`` alone."""
    cast_pose(rays.grid, rays.faces[0], R, t, True, rays.range_m, rays.face)
    return _log_likelihood(range_m, R, rays, assumed)[0]


@kernel
def agreed(
    range_m: FloatArray, R: FloatArray, t: FloatArray, rays: Rays, assumed: Assumptions
) -> tuple[int, int, float]:
    """Return the counts of ``judged`` alone: agreeing, contrary, missing."""
    cast_pose(rays.grid, rays.faces[0], R, t, True, rays.range_m, rays.face)
    power = _log_likelihood(range_m, R, rays, assumed)[1]
    return _agreement(range_m, R, rays, assumed, power)


@kernel
def _met(R: FloatArray, rays: Rays, least_range_m: float, i: int, j: int) -> tuple[float, float, int]:
    """Return the predicted range of a ray, its cosine of incidence, and the step of its echo in the table."""
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
    """Return the log likelihood of a scan against that of an empty sky, and the likeliest of ``HALVES``.

    A return that clutter explains better than the face does tells nothing of what is detected.
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
    """Return the log of the mean likelihood over ``HALVES`` of which rays came back, and the likeliest one.

    Args:
        returned: rays that came back, by echo, shape (RUNGS,).
        missing: rays that did not, likewise.
        detection: ``Detection``.
    """
    told = np.zeros(detection.share.shape[0])
    for h in range(told.size):
        for rung in range(RUNGS):
            told[h] += returned[rung] * detection.log_share[h, rung]
            told[h] += missing[rung] * detection.log_missing[h, rung]
    power = int(np.argmax(told))
    evidence: float = told[power] + np.log(np.mean(np.exp(told - told[power])))
    return evidence, power


@kernel
def _expectation(R: FloatArray, rays: Rays, assumed: Assumptions, power: int) -> tuple[float, float]:
    """Return mean and variance of the log likelihood over the scans that the pose lets expect."""
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
    """Return how many returns agree, how many contradict, and how many are missing.

    What is missing is counted for each echo apart: no sensor loses bright surfaces and returns dark ones. One
    standard deviation of each number is left to chance.
    """
    agreeing, contrary = 0, 0
    missed, expected = np.zeros(RUNGS), np.zeros(RUNGS)
    for i in range(rays.face.shape[0]):
        for j in range(rays.face.shape[1]):
            m = range_m[i, j]
            if rays.face[i, j] < 0:
                contrary += m > 0.0
                continue
            r, cosine, rung = _met(R, rays, assumed.least_range_m, i, j)
            expected[rung] += 1.0 - assumed.detection.share[power, rung]
            if m <= 0.0:
                missed[rung] += 1.0
            elif _density(m - r, cosine, assumed) > assumed.clutter_density:
                agreeing += 1
            else:
                contrary += 1
    missing = 0.0
    for rung in range(RUNGS):
        missing += max(0.0, missed[rung] - expected[rung] - np.sqrt(expected[rung]))
    return agreeing, contrary, missing


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
    """Return the likeliest pose R, t near one (``scan_fit.ScanModel.sharpen``).

    The samples of the first round have a covariance of (dtau, dtheta), shape (6, 6), those of each next one
    that of the elite, the best of the round. The other arguments are those of ``judged``, and ``Draws``.
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
