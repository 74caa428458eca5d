"""What a scan says of a pose, ray by ray: its log likelihood, what that was to be expected, which rays agree.

The kernels of ``scan_fit``. They share

    measured: range of each ray, 0 where no return, shape (rows, columns), m.
    pose: R and t of the target in the sensor, shapes (3, 3) and (3,), m.
    grid: ``RayGrid.arrays``.
    faces: ``SurfaceModel.faces``.
    chances: ``scan_fit.chances``.
    noise: sigma, slack, outlier share, clutter share, clutter density a metre.
    buffers: predicted range and face of each ray, -1 for none, shape (rows, columns) each.
"""

import numpy as np
from numba import njit

from rpod_geometry.rays import cast_pose
from rpod_pose.registration.lie_group import turned

OUTLIER_FACTOR = 4.0
"""Sigma of outliers over that of the others (2015 paper, section 3.2)."""
STEEPEST = 0.05
"""Cosine of incidence below which a surface's slack along the ray grows no more."""
HIT_MEAN, HIT_VARIANCE = 0.677, 1.03
"""Of minus the log likelihood of a range error, without 0.5 log(2 pi sigma^2): of the mixture with 6 % of
outliers, integrated numerically."""
AGREEING = 4.0
"""Standard deviations of an outlier within which a range is as predicted."""


@njit(cache=True, nogil=True, error_model="numpy")
def judged(measured, pose, grid, faces, chances, noise, buffers):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return ``log_likelihood``, ``expectation`` and ``agreement`` of a scan at a pose."""
    cast_pose(grid, faces[0], pose[0], pose[1], True, buffers[0], buffers[1])
    seen = (pose[0], grid[0], faces, buffers)
    told = log_likelihood(measured, seen, chances, noise)
    return told, expectation(seen, chances, noise), agreement(measured, seen, chances, noise)


@njit(cache=True, nogil=True, error_model="numpy")
def told(measured, pose, grid, faces, chances, noise, buffers):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return ``log_likelihood`` of a scan at a pose."""
    cast_pose(grid, faces[0], pose[0], pose[1], True, buffers[0], buffers[1])
    return log_likelihood(measured, (pose[0], grid[0], faces, buffers), chances, noise)


@njit(cache=True, nogil=True, error_model="numpy")
def agreed(measured, pose, grid, faces, chances, noise, buffers):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return ``agreement`` of a scan at a pose."""
    cast_pose(grid, faces[0], pose[0], pose[1], True, buffers[0], buffers[1])
    return agreement(measured, (pose[0], grid[0], faces, buffers), chances, noise)


@njit(cache=True, nogil=True, error_model="numpy")
def met(seen, i, j):  # type: ignore[no-untyped-def]
    """Return the predicted range of a ray, its cosine of incidence and the echo rho cos(theta) / R^2."""
    R, rays, (_, normals, _, reflectivity), (range_m, owner) = seen
    face, dx, dy, dz = owner[i, j], rays[0, i, j], rays[1, i, j], rays[2, i, j]
    cosine = 0.0
    for k in range(3):
        cosine -= normals[face, k] * (R[0, k] * dx + R[1, k] * dy + R[2, k] * dz)
    r = np.float64(range_m[i, j])
    return r, cosine, cosine * reflectivity[face] / (r * r)


@njit(cache=True, nogil=True, error_model="numpy")
def log_likelihood(measured, seen, chances, noise):  # type: ignore[no-untyped-def]
    """Return the log likelihood of a scan against that of an empty sky."""
    owner, (steps, table), (sigma, slack, outliers, clutter, density) = seen[3][1], chances, noise
    log_density, log_clear, total = np.log(density), np.log(1.0 - clutter), 0.0
    for i in range(owner.shape[0]):
        for j in range(owner.shape[1]):
            m = measured[i, j]
            if owner[i, j] < 0:
                if m > 0.0:
                    total += log_density - log_clear
                continue
            r, cosine, echo = met(seen, i, j)
            rung = min(int(echo * steps), table.shape[1] - 1)
            total -= log_clear
            if m <= 0.0:
                total += table[2, rung]
                continue
            e2, lateral = (m - r) * (m - r), slack / max(cosine, STEEPEST)
            narrow = sigma * sigma + lateral * lateral
            wide = OUTLIER_FACTOR**2 * sigma * sigma + lateral * lateral
            near = (1.0 - outliers) * np.exp(-0.5 * e2 / narrow) / np.sqrt(2.0 * np.pi * narrow)
            near += outliers * np.exp(-0.5 * e2 / wide) / np.sqrt(2.0 * np.pi * wide)
            total += np.log(table[0, rung] * near + density)
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def expectation(seen, chances, noise):  # type: ignore[no-untyped-def]
    """Return mean and variance of ``log_likelihood`` over the scans that the pose lets expect."""
    owner, (steps, table), (sigma, slack, _, clutter, _) = seen[3][1], chances, noise
    log_clear, mean, variance = np.log(1.0 - clutter), 0.0, 0.0
    for i in range(owner.shape[0]):
        for j in range(owner.shape[1]):
            if owner[i, j] < 0:
                continue
            _, cosine, echo = met(seen, i, j)
            rung = min(int(echo * steps), table.shape[1] - 1)
            p, log_p, miss = table[0, rung], table[1, rung], table[2, rung]
            lateral = slack / max(cosine, STEEPEST)
            hit = log_p - 0.5 * np.log(2.0 * np.pi * (sigma * sigma + lateral * lateral)) - HIT_MEAN
            mean += p * hit + (1.0 - p) * miss - log_clear
            variance += p * (1.0 - p) * (hit - miss) ** 2 + HIT_VARIANCE * p
    return mean, variance


@njit(cache=True, nogil=True, error_model="numpy")
def agreement(measured, seen, chances, noise):  # type: ignore[no-untyped-def]
    """Return how many returns agree, how many contradict, how many lack, and how many were expected to."""
    owner, (steps, table), (sigma, slack, _, _, _) = seen[3][1], chances, noise
    agreeing, contrary, missed, expected_missed = 0, 0, 0.0, 0.0
    for i in range(owner.shape[0]):
        for j in range(owner.shape[1]):
            m = measured[i, j]
            if owner[i, j] < 0:
                contrary += m > 0.0
                continue
            r, cosine, echo = met(seen, i, j)
            expected_missed += 1.0 - table[0, min(int(echo * steps), table.shape[1] - 1)]
            if m <= 0.0:
                missed += 1.0
                continue
            lateral = slack / max(cosine, STEEPEST)
            wide = OUTLIER_FACTOR**2 * sigma * sigma + lateral * lateral
            if (m - r) * (m - r) < AGREEING**2 * wide:
                agreeing += 1
            else:
                contrary += 1
    return agreeing, contrary, missed, expected_missed


@njit(cache=True, nogil=True, error_model="numpy")
def likeliest(measured, pose, grid, faces, chances, noise, buffers, covariance, draws, elite):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Return the likeliest pose R, t near one (``scan_fit.ScanModel.sharpen``).

    The samples of the first round have a covariance of (dtau, dtheta), shape (6, 6), those of each next one
    that of so many of the best, the elite. Draws are standard normal, shape (rounds, samples, 6).
    """
    best_R, best_t = pose
    best = told(measured, pose, grid, faces, chances, noise, buffers)
    steps, scores, spread = np.empty(draws.shape[1:]), np.empty(draws.shape[1]), covariance
    for number in range(draws.shape[0]):
        root = np.linalg.cholesky(spread + 1e-12 * np.eye(6))
        centre_R, centre_t = best_R, best_t
        for n in range(draws.shape[1]):
            steps[n] = root @ draws[number, n]
            moved = turned(centre_R, steps[n, 3:]), centre_t + centre_R @ steps[n, :3]
            scores[n] = told(measured, moved, grid, faces, chances, noise, buffers)
            if scores[n] > best:
                best, (best_R, best_t) = scores[n], moved
        leading = steps[np.argsort(-scores)[:elite]]
        middle = np.zeros(6)
        for row in leading:
            middle += row / elite
        spread = np.zeros((6, 6))
        for row in leading:
            spread += np.outer(row - middle, row - middle) / elite
    return best_R, best_t
