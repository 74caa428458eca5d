"""Evidence for the pose from the rays beside the outline.

A small motion of the target moves the outline, and each ray beside it may change sides. So its likelihood is
a step function of its distance from the outline,

    p(m_j | pose) = p_out + (p_in - p_out) [s_j + a_j . (dtau, dtheta) > 0].

p_in is the likelihood of the ray's measured result m_j if it meets the near surface, p_out the one if it
passes. s_j is the distance of the ray from the outline, positive inside, and a_j its derivative. Such a
likelihood has no gradient; ``step_posterior`` combines it with the information of the ranges.
"""

from math import log, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, kernel
from rpod_pose.lidar.outline.places import Places, on_plane, places
from rpod_pose.lidar.posterior.step_posterior import Steps
from rpod_pose.lidar.returns.detection import LEAST_LOG, RUNGS, RUNGS_PER_LOG
from rpod_pose.lidar.scan_likelihood import PEAK, STEEPEST, Assumptions, Rays
from rpod_pose.registration.lie_group import PoseArrays, in_target
from rpod_schemas.arrays import FloatArray

FARTHEST = 4
"""Largest number of rays in a row, on each side of the outline, that may contradict it. Numerics: a budget;
rays farther from the outline do not move it."""
SAME_LINE, SAME_PLACE = 0.95, 0.1
"""Least cosine between the normals, and largest difference of the ray's distances over its distance from the
place, at which two places of the outline lie on one line. Hand: 18 deg, and a tenth of that distance."""
MOST_ODDS = 30.0
"""Limit of the log ratio of two likelihoods of one ray. Numerics: the exponential stays finite, and such a
ray is certain."""
LINES = 4
"""Largest number of lines of the outline that are distinguished beside one ray. Numerics: memory; at a corner
of the outline two lines meet."""


class Scene(NamedTuple):
    """A scan, and the pose at which it is evaluated."""

    range_m: FloatArray
    """Measured range of each ray, 0 without a return, shape (rows, columns)."""
    pose: PoseArrays
    """Pose of the target in the sensor."""
    rays: Rays
    """Rays and target; their buffers hold the target rendered at the pose."""
    assumed: Assumptions
    """Statistics of returns."""
    power: int
    """Index of the likeliest value in ``detection.HALVES``."""


class Found(NamedTuple):
    """Buffer of the steps that have been found so far."""

    number: NDArray[np.int64]
    """Number of steps, shape (1,)."""
    steps: Steps
    place: NDArray[np.int32]
    """Number of the place of the outline of each step, shape (E,)."""
    of_ray: NDArray[np.int32]
    """Numbers of the steps of each ray, -1 for none, shape (rays, LINES)."""


class Beside(NamedTuple):
    """A ray beside a place of the outline."""

    place: int
    """Number of the place."""
    ray: int
    """Row-major index of the ray."""
    odds: float
    """Log ratio of the likelihoods of its result if it meets the near surface and if it passes."""


@kernel
def outline_steps(scene: Scene) -> Steps:
    """Return the evidence of the nearest ray on each side of the outline, and of rays that contradict it.

    On each side, rays are followed until one is consistent with the pose, at most ``FARTHEST`` of them.
    """
    outline = places(scene.pose, scene.rays, scene.assumed)
    most = 2 * FARTHEST * outline.number
    found = Found(
        np.zeros(1, np.int64),
        Steps(most, np.empty((most, 6)), np.empty(most), np.empty(most)),
        np.empty(most, np.int32),
        np.full((scene.range_m.size, LINES), np.int32(-1)),
    )
    for n in range(outline.number):
        outwards = outline.rays[n, 1] - outline.rays[n, 0]
        for inside in range(2):
            first = outline.rays[n, 0] if inside else outline.rays[n, 1]
            onwards = -outwards if inside else outwards
            for away in range(FARTHEST):
                ray = first + away * onwards
                if not _is_in_line(ray, first, outwards, scene.rays):
                    break
                odds = _odds(scene, outline, n, ray, inside)
                contradicts = odds < 0.0 if inside else odds > 0.0
                if away == 0 or contradicts:
                    _add(found, scene, outline, Beside(n, ray, odds))
                if not contradicts:
                    break
    number, steps = found.number[0], found.steps
    return Steps(number, steps.rows[:number], steps.distance_m[:number], steps.odds[:number])


@inlined_kernel
def _odds(scene: Scene, outline: Places, place: int, ray: int, inside: int) -> float:
    """Return the log ratio of the likelihoods of a ray's result if it meets the near surface and if not.

    Args:
        scene: scan and pose.
        outline: places of the outline.
        place: number of the place beside which the ray lies.
        ray: row-major index of the ray.
        inside: 1 for a ray that meets the near surface at the pose, 0 for one that passes it.
    """
    width = scene.range_m.shape[1]
    here = int(np.int64(scene.rays.face[ray // width, ray % width]))
    near = _log_likelihood(scene, ray, here if inside else outline.faces[place, 0])
    far = _log_likelihood(scene, ray, outline.faces[place, 1] if inside else here)
    return min(max(near - far, -MOST_ODDS), MOST_ODDS)


@inlined_kernel
def _add(found: Found, scene: Scene, outline: Places, beside: Beside) -> None:
    """Add a ray beside a place of the outline to the steps, unless it has a step of the same line already.

    Args:
        found: steps so far, input and output.
        scene: scan and pose.
        outline: places of the outline.
        beside: the ray and the place.
    """
    n, ray = beside.place, beside.ray
    width, components, r = scene.range_m.shape[1], scene.rays.grid.components, outline.range_m[n]
    i, j, s, apart = ray // width, ray % width, 0.0, 0.0
    for k in range(3):
        s += r * outline.normal[n, k] * components[k, i, j]
        apart += (r * (components[k, i, j] - outline.direction[n, k])) ** 2
    slot = 0
    while slot < LINES and found.of_ray[ray, slot] >= 0:
        known = found.of_ray[ray, slot]
        other, cosine = found.place[known], 0.0
        for k in range(3):
            cosine += outline.normal[other, k] * outline.normal[n, k]
        if cosine > SAME_LINE and abs(found.steps.distance_m[known] - s) < SAME_PLACE * sqrt(apart):
            return
        slot += 1
    number = found.number[0]
    if slot < LINES:
        found.of_ray[ray, slot] = number
    found.place[number] = n
    found.steps.distance_m[number], found.steps.odds[number] = s, beside.odds
    _fill_row(found.steps.rows[number], scene.pose, outline, n)
    found.number[0] = number + 1


@inlined_kernel
def _is_in_line(ray: int, start: int, outwards: int, rays: Rays) -> bool:
    """Return whether a ray lies in the same row or column of the pattern as the ray at which a count starts.

    Args:
        ray: row-major index of the ray.
        start: row-major index of the other ray.
        outwards: step from one ray to the next, a row or a column.
        rays: rays of the pattern.
    """
    height, width = rays.face.shape
    if ray < 0 or ray >= height * width:
        return False
    return bool(abs(outwards) == width or ray // width == start // width)


@inlined_kernel
def _log_likelihood(scene: Scene, ray: int, face: int) -> float:
    """Return the log likelihood of the result of a ray, a row-major index, if it meets a face (-1: none)."""
    rays, pose, assumed, width = scene.rays, scene.pose, scene.assumed, scene.range_m.shape[1]
    i, j, density = ray // width, ray % width, assumed.clutter_density
    m = scene.range_m[i, j]
    if m < 0.0:
        return 0.0  # something hides the target
    if face < 0:
        return log(density) if m > 0.0 else log(1.0 - assumed.clutter_share)
    components, normal = rays.grid.components, rays.faces.normals[face]
    d = in_target(pose.R, components[0, i, j], components[1, i, j], components[2, i, j])
    cosine = max(-(normal[0] * d.x + normal[1] * d.y + normal[2] * d.z), STEEPEST)
    r = on_plane(pose, rays, face, ray)
    echo = cosine * rays.faces.albedo[face] * (assumed.least_range_m / r) ** 2
    rung = min(max(int((log(max(echo, 1e-9)) - LEAST_LOG) * RUNGS_PER_LOG), 0), RUNGS - 1)
    if m <= 0.0:
        return float(assumed.detection.log_missing[scene.power, rung])
    lateral_m = assumed.slack_m / cosine
    variance = assumed.sigma_m * assumed.sigma_m + lateral_m * lateral_m
    tail = 1.0 + 0.25 * (m - r) * (m - r) / variance
    near = PEAK / (sqrt(variance * tail) * tail * tail)
    return float(log(near * assumed.detection.share[scene.power, rung] + density))


@inlined_kernel
def _fill_row(row: FloatArray, pose: PoseArrays, outline: Places, place: int) -> None:
    """Fill the derivatives of a ray's distance from the outline with respect to (dtau, dtheta), shape (6,).

    The normal points inwards. If the target moves by d along it, the distance of the ray decreases by d.

    Args:
        row: output.
        pose: pose of the target in the sensor.
        outline: places of the outline.
        place: number of the place.
    """
    normal, direction, r = outline.normal[place], outline.direction[place], outline.range_m[place]
    n = in_target(pose.R, normal[0], normal[1], normal[2])
    x = in_target(
        pose.R, r * direction[0] - pose.t[0], r * direction[1] - pose.t[1], r * direction[2] - pose.t[2]
    )
    row[0], row[1], row[2] = -n.x, -n.y, -n.z
    row[3], row[4], row[5] = n.y * x.z - n.z * x.y, n.z * x.x - n.x * x.z, n.x * x.y - n.y * x.x
