"""Likelihood of a scan at a pose, ray by ray: the actual and the expected one, and which rays agree.

These are the kernels of ``scan_fit``. The range error of a return from a surface has Student's distribution
with four degrees of freedom, with the scale that the sensor states. This is the distribution of a normal
error whose variance is only roughly known (by a scaled inverse chi-square distribution with four degrees of
freedom). Its tails contain outliers, so that neither their number nor their size has to be known.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_geometry.ray_tree import Waiting, first_hit, in_target, no_nodes
from rpod_geometry.rays import GridArrays, RenderBuffers
from rpod_pose.lidar.returns.detection import LEAST_LOG, RUNGS, RUNGS_PER_LOG, Detection
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.surface_model import Faces, cast_faces
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

STEEPEST = 0.05
"""Least cosine of incidence by which a surface's slack is converted to the ray. Numerics: it avoids a
division by zero; the angle is 87 deg."""
PEAK = 0.375
"""Density of Student's distribution with 4 degrees of freedom at zero, in units of one over its scale.
Physics: 3/8."""
HALF_BEAM_RAD = 1.5e-3
"""Half the width of a beam. Physics: rotating scanners have 3 mrad (Velodyne, VLS-128 manual, table F-1), and
no message states it. A beam may give a return if only its edge meets a surface and its middle passes."""
HIT_MEAN, HIT_VARIANCE = 1.6818, 0.9661
"""Mean and variance of minus the logarithm of Student's density with unit scale. Physics: integrated
numerically."""


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
    """Range at which the weakest sensor detects every other pulse on a white surface at normal incidence."""
    detection: Detection
    """Probabilities that rays give returns."""


class Rays(NamedTuple):
    """The rays of a pattern, the target on which they are cast, and buffers of shape (rows, columns)."""

    grid: GridArrays
    """``RayGrid.arrays``."""
    faces: Faces
    """``SurfaceModel.faces``."""
    range_m: Float32Array
    """Predicted range."""
    face: NDArray[np.int32]
    """Predicted face, -1 for none."""


class ScanAgreement(NamedTuple):
    """Agreement of a scan with a pose."""

    log_likelihood: float
    """Log likelihood, relative to that of an empty sky."""
    agreeing: int
    """Number of returns that the predicted face explains better than clutter does."""
    inconsistent: int
    """Number of all other returns except the grazing ones."""
    grazing: int
    """Number of returns whose rays pass the target while the edges of their beams meet it."""
    missing: float
    """Number of rays that meet a face and gave no return, beyond the number expected for their echoes."""

    @property
    def share(self) -> float:
        """Share of agreeing rays among those with a measured or predicted return; NaN if there is none."""
        counted = self.agreeing + self.inconsistent + self.missing
        return self.agreeing / counted if counted else float("nan")


class ScanStatistics(NamedTuple):
    """Agreement of a scan with a pose, and the expected log likelihood if the pose is right."""

    agreement: ScanAgreement
    """Agreement of the scan with the pose."""
    expected: float
    """Mean of the log likelihood over the scans that the pose predicts."""
    variance: float
    """Variance of the log likelihood over these scans."""


class RaySums(NamedTuple):
    """Sums over the rays of a scan at a pose; arrays have one entry for each step of the echo."""

    log_density: float
    """Sum of the logarithms of the returns' densities, relative to an empty sky."""
    agreeing: int
    """Number of returns that the predicted face explains better than clutter does."""
    inconsistent: int
    """Number of all other returns except the grazing ones."""
    grazing: int
    """Number of returns whose rays pass the target while the edges of their beams meet it."""
    met: FloatArray
    """Number of rays that meet a face, shape (RUNGS,)."""
    returned: FloatArray
    """Number of agreeing returns, shape (RUNGS,)."""
    missing: FloatArray
    """Number of rays that meet a face and gave no return, shape (RUNGS,)."""
    log_variance: FloatArray
    """Sums of the logarithm of the range variance, in m2, and of this logarithm's square, (2, RUNGS)."""


class Beams(NamedTuple):
    """Data for casting the edges of a scan's beams at a pose."""

    R: FloatArray
    """R_sensor_target, shape (3, 3)."""
    origin: FloatArray
    """Position of the sensor in target axes, shape (3,), m."""
    variance_m2: float
    """Variance of a range."""
    waiting: Waiting
    """Work memory for casting a ray."""


@kernel
def scan_statistics(
    range_m: FloatArray, R: FloatArray, t: FloatArray, rays: Rays, assumed: Assumptions
) -> ScanStatistics:
    """Return the statistics of a scan at a pose.

    Args:
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        rays: rays, target and buffers.
        assumed: statistics of returns.
    """
    cast_faces(rays.grid, rays.faces, R, t, RenderBuffers(rays.range_m, rays.face))
    sums = _ray_sums(range_m, PoseArrays(R, t), rays, assumed, True)
    evidence, power = _detected(sums.returned, sums.missing, assumed.detection)
    mean, variance = _expectation(sums, assumed, power)
    missing = _missing(sums, assumed.detection.share[power])
    likelihood = sums.log_density + evidence
    return ScanStatistics(
        ScanAgreement(likelihood, sums.agreeing, sums.inconsistent, sums.grazing, missing), mean, variance
    )


@inner_kernel
def scan_agreement(
    range_m: FloatArray, R: FloatArray, t: FloatArray, rays: Rays, assumed: Assumptions
) -> ScanAgreement:
    """Return the agreement of ``scan_statistics`` without the expectation; arguments as there."""
    cast_faces(rays.grid, rays.faces, R, t, RenderBuffers(rays.range_m, rays.face))
    sums = _ray_sums(range_m, PoseArrays(R, t), rays, assumed, False)
    evidence, power = _detected(sums.returned, sums.missing, assumed.detection)
    missing = _missing(sums, assumed.detection.share[power])
    likelihood = sums.log_density + evidence
    return ScanAgreement(likelihood, sums.agreeing, sums.inconsistent, sums.grazing, missing)


@inner_kernel
def rendered_likelihood(
    range_m: FloatArray, pose: PoseArrays, rays: Rays, assumed: Assumptions
) -> tuple[float, int]:
    """Return a scan's log likelihood at a rendered pose, and the index of the likeliest ``HALVES`` value.

    Args:
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        pose: pose of the target in the sensor.
        rays: rays, target and buffers, which hold the target rendered at the pose.
        assumed: statistics of returns.
    """
    sums = _ray_sums(range_m, pose, rays, assumed, False)
    evidence, power = _detected(sums.returned, sums.missing, assumed.detection)
    return sums.log_density + evidence, power


@inner_kernel
def _ray_sums(
    range_m: FloatArray, pose: PoseArrays, rays: Rays, assumed: Assumptions, spread: bool
) -> RaySums:
    """Return the sums over the rays, after the target was cast at the pose.

    Args:
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        pose: pose of the target in the sensor.
        rays: rays, target and buffers, which hold the target rendered at the pose.
        assumed: statistics of returns.
        spread: whether ``log_variance`` is computed, which only the expectation needs.
    """
    directions, normals, albedo = rays.grid.components, rays.faces.normals, rays.faces.albedo
    density, sigma2 = assumed.clutter_density, assumed.sigma_m * assumed.sigma_m
    log_clear = np.log(1.0 - assumed.clutter_share)
    met, returned, missing = np.zeros(RUNGS), np.zeros(RUNGS), np.zeros(RUNGS)
    log_variance = np.zeros((2, RUNGS))
    total, agreeing, inconsistent, grazing = 0.0, 0, 0, 0
    R, beams = pose.R, _beams(pose, sigma2)
    for i in range(rays.face.shape[0]):
        for j in range(rays.face.shape[1]):
            m, face = range_m[i, j], rays.face[i, j]
            if m < 0.0:
                continue  # something hides the target
            if face < 0:
                if m > 0.0:
                    edge = _at_edge(m, i, j, rays, beams)
                    total += np.log(density + edge) - log_clear
                    grazing += int(edge > density)
                    inconsistent += int(edge <= density)
                continue
            dx, dy, dz = directions[0, i, j], directions[1, i, j], directions[2, i, j]
            cosine = 0.0
            for k in range(3):
                cosine -= normals[face, k] * (R[0, k] * dx + R[1, k] * dy + R[2, k] * dz)
            r = np.float64(rays.range_m[i, j])
            echo = cosine * albedo[face] * (assumed.least_range_m / r) ** 2
            step = int((np.log(max(echo, 1e-9)) - LEAST_LOG) * RUNGS_PER_LOG)
            rung = min(max(step, 0), RUNGS - 1)
            lateral_m = assumed.slack_m / max(cosine, STEEPEST)
            variance = sigma2 + lateral_m * lateral_m
            met[rung] += 1.0
            if spread:
                log_scale = np.log(variance)
                log_variance[0, rung] += log_scale
                log_variance[1, rung] += log_scale * log_scale
            total -= log_clear
            if m <= 0.0:
                missing[rung] += 1.0
                continue
            tail = 1.0 + 0.25 * (m - r) * (m - r) / variance
            near = PEAK / (np.sqrt(variance * tail) * tail * tail)
            total += np.log(near + density)
            if near > density:
                returned[rung] += 1.0
                agreeing += 1
            else:
                inconsistent += 1
    return RaySums(total, agreeing, inconsistent, grazing, met, returned, missing, log_variance)


@inlined_kernel
def _beams(pose: PoseArrays, variance_m2: float) -> Beams:
    """Return the data for casting the edges of beams at a pose, with the variance of a range."""
    origin = np.empty(3)
    for k in range(3):
        origin[k] = -(pose.R[0, k] * pose.t[0] + pose.R[1, k] * pose.t[1] + pose.R[2, k] * pose.t[2])
    return Beams(pose.R, origin, variance_m2, no_nodes())


@inlined_kernel
def _at_edge(m: float, i: int, j: int, rays: Rays, beams: Beams) -> float:
    """Return the density of a range whose ray passes the target, while the edge of its beam may meet it.

    The ray is turned by half a beam towards each of its neighbours. It is unknown whether the part of the
    beam that then meets the target gives a return: a probability of a half is assumed. The surface is assumed
    to be inclined by up to 45 deg.

    Args:
        m: measured range.
        i: row of the ray.
        j: column of the ray.
        rays: rays, target and buffers, which hold the target rendered at the pose.
        beams: data for casting.
    """
    density, grid = 0.0, rays.grid.components
    x, y, z = grid[0, i, j], grid[1, i, j], grid[2, i, j]
    for way in range(4):
        k, n = i + (way == 0) - (way == 1), j + (way == 2) - (way == 3)
        if k < 0 or n < 0 or k >= rays.face.shape[0] or n >= rays.face.shape[1]:
            continue
        dx, dy, dz = grid[0, k, n] - x, grid[1, k, n] - y, grid[2, k, n] - z
        part = min(1.0, HALF_BEAM_RAD / np.sqrt(max(dx * dx + dy * dy + dz * dz, 1e-18)))
        turned = in_target(beams.R, beams.origin, x + part * dx, y + part * dy, z + part * dz)
        r = first_hit(rays.faces.tree, turned, beams.waiting).range_m
        if r < np.inf:
            variance = beams.variance_m2 + (HALF_BEAM_RAD * r) ** 2
            tail = 1.0 + 0.25 * (m - r) * (m - r) / variance
            density = max(density, 0.5 * PEAK / (np.sqrt(variance * tail) * tail * tail))
    return density


@inner_kernel
def _detected(returned: FloatArray, missing: FloatArray, detection: Detection) -> tuple[float, int]:
    """Return the log of the mean likelihood of the detections over ``HALVES``, and the likeliest index.

    A return that clutter explains better than the face does counts neither as detected nor as missing.

    Args:
        returned: number of agreeing returns, by echo, shape (RUNGS,).
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


@inner_kernel
def _expectation(sums: RaySums, assumed: Assumptions, power: int) -> tuple[float, float]:
    """Return mean and variance of the log likelihood over scans, if the pose is right.

    A ray that gives a return with the probability p adds p h + (1 - p) m to the mean, and
    p (1 - p) (h - m)^2 + p v to the variance. m is the log likelihood of no return. h is the mean log
    likelihood of a return, a - s / 2, where s is the logarithm of its error's variance. v is
    ``HIT_VARIANCE``. For the rays of one echo, both follow from the sums of s and s^2.
    """
    log_clear, mean, variance = np.log(1.0 - assumed.clutter_share), 0.0, 0.0
    share, log_share, log_missing = assumed.detection
    for rung in range(RUNGS):
        count, s, s2 = sums.met[rung], sums.log_variance[0, rung], sums.log_variance[1, rung]
        p, miss = share[power, rung], log_missing[power, rung]
        hit = log_share[power, rung] - HIT_MEAN
        mean += p * (count * hit - 0.5 * s) + count * ((1.0 - p) * miss - log_clear)
        squares = count * (hit - miss) ** 2 - (hit - miss) * s + 0.25 * s2
        variance += p * (1.0 - p) * squares + HIT_VARIANCE * p * count
    return mean, variance


@inner_kernel
def _missing(sums: RaySums, share: FloatArray) -> float:
    """Return the number of missing returns beyond the expected number.

    Missing returns are counted separately for each echo, since no sensor misses bright surfaces and detects
    dark ones. The number at each echo is reduced by one standard deviation.

    Args:
        sums: sums over the rays.
        share: probability of a return by echo, shape (RUNGS,).
    """
    missing = 0.0
    for rung in range(RUNGS):
        expected = sums.met[rung] * (1.0 - share[rung])
        missing += max(0.0, sums.missing[rung] - expected - np.sqrt(expected))
    return missing
