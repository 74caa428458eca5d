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

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_pose.lidar.outline.places import Places, along, cross, dot, places, ray_of, row_of
from rpod_pose.lidar.posterior.step_posterior import Steps
from rpod_pose.lidar.returns.detection import LEAST_LOG, RUNGS, RUNGS_PER_LOG
from rpod_pose.lidar.scan_likelihood import PEAK, STEEPEST, Assumptions, Rays
from rpod_pose.registration.lie_group import PoseArrays, Vector, in_target
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
    direction: Vector
    """Its unit vector, sensor axes."""
    odds: float
    """Log ratio of the likelihoods of its result if it meets the near surface and if it passes."""


class Surface(NamedTuple):
    """What the likelihood of a ray's result takes: few arrays, since each use of a record counts them all."""

    t: Vector
    """Position of the target in the sensor, but in target axes, m."""
    normals: FloatArray
    """``Faces.normals``, shape (T, 3)."""
    offsets_m: FloatArray
    """``Faces.offsets_m``, shape (T,)."""
    albedo: FloatArray
    """``Faces.albedo``, shape (T,)."""
    share: FloatArray
    """Probability of a return, by echo, shape (RUNGS,)."""
    log_missing: FloatArray
    """Log probability of no return, by echo, shape (RUNGS,)."""
    noise: "Noise"


class Noise(NamedTuple):
    """Statistics of returns; the fields are those of ``Assumptions``."""

    variance_m2: float
    slack_m: float
    clutter_density: float
    clutter_share: float
    least_range_m: float


@kernel
def outline_steps(scene: Scene) -> Steps:
    """Return the evidence of the nearest ray on each side of the outline, and of rays that contradict it.

    On each side, rays are followed until one is consistent with the pose, at most ``FARTHEST`` of them.
    """
    outline, surface = places(scene.pose, scene.rays, scene.assumed), _surface(scene)
    components, face, measured_m, R = scene.rays.grid.components, scene.rays.face, scene.range_m, scene.pose.R
    height, width = face.shape
    most = 2 * FARTHEST * outline.number
    found = Found(
        np.zeros(1, np.int64),
        Steps(most, np.empty((most, 6)), np.empty(most), np.empty(most)),
        np.empty(most, np.int32),
        np.full((height * width, LINES), np.int32(-1)),
    )
    for n in range(outline.number):
        front, back = outline.rays[n, 0], outline.rays[n, 1]
        ends, behind = outline.faces[n, 0], outline.faces[n, 1]
        for inside in range(2):
            first, onwards = (front, front - back) if inside else (back, back - front)
            for away in range(FARTHEST):
                ray = first + away * onwards
                i, j = ray // width, ray % width
                if ray < 0 or i >= height or (abs(onwards) != width and i != first // width):
                    break
                here, direction = int(np.int64(face[i, j])), ray_of(components, i, j)
                near, far = (here, behind) if inside else (ends, here)
                d = in_target(R, direction.x, direction.y, direction.z)
                odds = _odds(measured_m[i, j], near, far, d, surface)
                contradicts = odds < 0.0 if inside else odds > 0.0
                if away == 0 or contradicts:
                    _add(found, scene.pose, outline, Beside(n, ray, direction, odds))
                if not contradicts:
                    break
    number, steps = found.number[0], found.steps
    return Steps(number, steps.rows[:number], steps.distance_m[:number], steps.odds[:number])


@inner_kernel
def _surface(scene: Scene) -> Surface:
    """Return what the likelihoods of a scene's rays take."""
    pose, faces, assumed = scene.pose, scene.rays.faces, scene.assumed
    share, log_missing = assumed.detection.share[scene.power], assumed.detection.log_missing[scene.power]
    t = in_target(pose.R, pose.t[0], pose.t[1], pose.t[2])
    noise = Noise(
        assumed.sigma_m * assumed.sigma_m,
        assumed.slack_m,
        assumed.clutter_density,
        assumed.clutter_share,
        assumed.least_range_m,
    )
    return Surface(t, faces.normals, faces.offsets_m, faces.albedo, share, log_missing, noise)


@inlined_kernel
def _odds(m: float, near: int, far: int, direction: Vector, surface: Surface) -> float:
    """Return the log ratio of the likelihoods of a ray's result if it meets one face and if another one.

    Args:
        m: measured range, 0 without a return, negative where something hides the target.
        near: the near face, -1 for none.
        far: the face behind it, -1 for none.
        direction: the ray's unit vector, target axes.
        surface: the target's surface.
    """
    odds = _log_likelihood(m, near, direction, surface) - _log_likelihood(m, far, direction, surface)
    return min(max(odds, -MOST_ODDS), MOST_ODDS)


@inlined_kernel
def _add(found: Found, pose: PoseArrays, outline: Places, beside: Beside) -> None:
    """Add a ray beside a place of the outline to the steps, unless it has a step of the same line already.

    Args:
        found: steps so far, input and output.
        pose: pose of the target in the sensor.
        outline: places of the outline.
        beside: the ray and the place.
    """
    n, ray, r, away = beside.place, beside.ray, outline.range_m[beside.place], beside.direction
    normal, place = row_of(outline.normal, n), row_of(outline.direction, n)
    x, y, z = r * (away.x - place.x), r * (away.y - place.y), r * (away.z - place.z)
    s = r * normal.x * away.x + r * normal.y * away.y + r * normal.z * away.z
    apart = sqrt(x * x + y * y + z * z)
    slot = 0
    while slot < LINES and found.of_ray[ray, slot] >= 0:
        known = found.of_ray[ray, slot]
        cosine = dot(row_of(outline.normal, found.place[known]), normal)
        if cosine > SAME_LINE and abs(found.steps.distance_m[known] - s) < SAME_PLACE * apart:
            return
        slot += 1
    number = found.number[0]
    if slot < LINES:
        found.of_ray[ray, slot] = number
    found.place[number] = n
    found.steps.distance_m[number], found.steps.odds[number] = s, beside.odds
    _fill_row(found.steps.rows, number, pose, normal, Vector(r * place.x, r * place.y, r * place.z))
    found.number[0] = number + 1


@inlined_kernel
def _log_likelihood(m: float, face: int, direction: Vector, surface: Surface) -> float:
    """Return the log likelihood of a ray's result if it meets a face; other arguments as for ``_odds``.

    Args:
        m: measured range.
        face: the face, -1 for none.
        direction: the ray's unit vector.
        surface: the target's surface.
    """
    noise = surface.noise
    if m < 0.0:
        return 0.0  # something hides the target
    if face < 0:
        return log(noise.clutter_density) if m > 0.0 else log(1.0 - noise.clutter_share)
    normal = row_of(surface.normals, face)
    cosine = max(-dot(normal, direction), STEEPEST)
    r = along(normal, surface.offsets_m[face], surface.t, direction)
    echo = cosine * surface.albedo[face] * (noise.least_range_m / r) ** 2
    rung = min(max(int((log(max(echo, 1e-9)) - LEAST_LOG) * RUNGS_PER_LOG), 0), RUNGS - 1)
    if m <= 0.0:
        return float(surface.log_missing[rung])
    lateral_m = noise.slack_m / cosine
    variance = noise.variance_m2 + lateral_m * lateral_m
    tail = 1.0 + 0.25 * (m - r) * (m - r) / variance
    near = PEAK / (sqrt(variance * tail) * tail * tail)
    return float(log(near * surface.share[rung] + noise.clutter_density))


@inlined_kernel
def _fill_row(rows: FloatArray, number: int, pose: PoseArrays, normal: Vector, place: Vector) -> None:
    """Fill the derivatives of a ray's distance from the outline with respect to (dtau, dtheta), shape (6,).

    The normal points inwards. If the target moves by d along it, the distance of the ray decreases by d.

    Args:
        rows: output, shape (E, 6).
        number: index of the row.
        pose: pose of the target in the sensor.
        normal: the outline's normal, sensor axes.
        place: the place of the outline, sensor axes, m.
    """
    n, t = in_target(pose.R, normal.x, normal.y, normal.z), pose.t
    x = in_target(pose.R, place.x - t[0], place.y - t[1], place.z - t[2])
    rows[number, 0], rows[number, 1], rows[number, 2] = -n.x, -n.y, -n.z
    moved = cross(x, n)
    rows[number, 3], rows[number, 4], rows[number, 5] = -moved.x, -moved.y, -moved.z
