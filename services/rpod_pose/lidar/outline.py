"""The outline of the target in a scan: which rays meet it, beside how far away it is.

The ranges of a flat face do not tell where on its plane the target lies. Which rays give a return does. Two
neighbouring rays of which one meets a near surface and the other does not have the outline between them. It
is found there by bisection, at the pose that the ranges give. A small motion of the target moves the outline,
and each ray beside it may change sides: its likelihood is a step in its distance from the outline,

    p(m_j | pose) = p_out + (p_in - p_out) [s_j + a_j . (dtau, dtheta) > 0],

with the probabilities of its measured result if it meets the near surface and if it passes it. Such a
likelihood has no gradient; ``step_posterior`` combines it with what the ranges tell.
"""

from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_geometry.ray_tree import DEPTH, Hit, first_hit, ray_in_target
from rpod_pose.lidar.detection import LEAST_LOG, RUNGS, RUNGS_PER_LOG
from rpod_pose.lidar.scan_likelihood import PEAK, STEEPEST, Assumptions, Rays
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.step_posterior import Steps
from rpod_schemas.arrays import Array, FloatArray

HALVINGS = 6
"""Number of bisections between two rays: the outline is found within 1/128 of their distance."""
FARTHEST = 4
"""Number of rays on each side of the outline that may contradict it one behind the other."""
JUMP = 4.0
"""Least difference of two ranges, in standard deviations of one, at which a surface ends."""
SAME_LINE, SAME_PLACE = 0.95, 0.1
"""Cosine between two normals, and difference of two distances in units of the rays' distance, up to which two
places of the outline lie on one line for a ray between them."""
MOST_ODDS = 30.0
"""Greatest logarithm of the ratio of two likelihoods of one ray."""


class Edge(NamedTuple):
    """Places of the outline between neighbouring rays."""

    number: int
    """Number of places, N; the arrays may be longer."""
    direction: FloatArray
    """Unit direction of each place in sensor axes, shape (N, 3)."""
    range_m: FloatArray
    """Range of the near surface there, shape (N,)."""
    front: NDArray[np.int64]
    """Row-major index of the ray that meets the near surface, shape (N,)."""
    back: NDArray[np.int64]
    """Row-major index of the ray that passes it, shape (N,)."""
    faces: NDArray[np.int32]
    """Face of the near surface, and the face behind it, -1 for none, shape (N, 2)."""
    of_pair: NDArray[np.int32]
    """Place between a ray and the next one in its row, and in its column, -1 for none, shape
    (2, rows, columns)."""


class Scene(NamedTuple):
    """A scan and a pose at which it is looked at."""

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
    """Steps as they are found."""

    number: NDArray[np.int64]
    """Their number so far, shape (1,)."""
    steps: Steps
    normals: FloatArray
    """Inward normal of the outline at each of them, shape (E, 3)."""
    of_ray: NDArray[np.int32]
    """Steps of each ray, -1 for none, shape (rays, 4)."""


class Crossing(NamedTuple):
    """What lies on both sides of the outline between two rays."""

    one: Hit
    two: Hit
    share: float
    """Place of the outline between the two rays, 0 to 1; negative if there is none."""


@kernel
def outline_steps(
    range_m: FloatArray, pose: PoseArrays, rays: Rays, assumed: Assumptions, power: int
) -> Steps:
    """Return the rays beside the outline.

    Args:
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        pose: pose of the target in the sensor.
        rays: rays and target; their buffers hold the target rendered at the pose.
        assumed: statistics of returns.
        power: index of the likeliest value in ``detection.HALVES``.
    """
    edge = _edge(pose, rays, assumed)
    most = 2 * FARTHEST * edge.number
    found = Found(
        np.zeros(1, np.int64),
        Steps(most, np.empty((most, 6)), np.empty(most), np.empty(most)),
        np.empty((most, 3)),
        np.full((range_m.size, 4), -1, np.int32),
    )
    scene = Scene(range_m, pose, rays, assumed, power)
    for n in range(edge.number):
        normal = _normal(edge, n, rays)
        outwards = edge.back[n] - edge.front[n]
        for inside in range(2):
            first = edge.front[n] if inside else edge.back[n]
            onwards = -outwards if inside else outwards
            for away in range(FARTHEST):
                ray = first + away * onwards
                if not _is_beside(ray, first, outwards, rays):
                    break
                odds = _odds(scene, edge, n, ray, inside)
                contradicts = odds < 0.0 if inside else odds > 0.0
                if away == 0 or contradicts:
                    _add(found, scene, edge, n, ray, normal, odds)
                if not contradicts:
                    break
    number, steps = found.number[0], found.steps
    return Steps(number, steps.rows[:number], steps.distance_m[:number], steps.odds[:number])


@kernel
def _odds(scene: Scene, edge: Edge, place: int, ray: int, inside: int) -> float:
    """Return the log ratio of the likelihoods of a ray's result if it meets the near surface and if not.

    Args:
        scene: scan and pose.
        edge: places of the outline.
        place: place that the ray is beside.
        ray: row-major index of the ray.
        inside: 1 for a ray that meets the near surface at the pose, 0 for one that passes it.
    """
    width = scene.range_m.shape[1]
    here = int(np.int64(scene.rays.face[ray // width, ray % width]))
    near = _log_likelihood(scene, ray, here if inside else int(np.int64(edge.faces[place, 0])))
    far = _log_likelihood(scene, ray, int(np.int64(edge.faces[place, 1])) if inside else here)
    return min(max(near - far, -MOST_ODDS), MOST_ODDS)


@kernel
def _add(  # noqa: PLR0917
    found: Found, scene: Scene, edge: Edge, place: int, ray: int, normal: FloatArray, odds: float
) -> None:
    """Add a ray beside a place of the outline to the steps, unless the same line of the outline has it.

    Args:
        found: steps so far, input and output.
        scene: scan and pose.
        edge: places of the outline.
        place: the place.
        ray: row-major index of the ray.
        normal: inward normal of the outline at the place, shape (3,).
        odds: ``_odds`` of the ray.
    """
    width, components, r = scene.range_m.shape[1], scene.rays.grid.components, edge.range_m[place]
    i, j, s, apart = ray // width, ray % width, 0.0, 0.0
    for k in range(3):
        s += r * normal[k] * components[k, i, j]
        apart += (r * (components[k, i, j] - edge.direction[place, k])) ** 2
    slot = 0
    while slot < 4 and found.of_ray[ray, slot] >= 0:
        known = found.of_ray[ray, slot]
        cosine = (found.normals[known] * normal).sum()
        if cosine > SAME_LINE and abs(found.steps.distance_m[known] - s) < SAME_PLACE * sqrt(apart):
            return
        slot += 1
    number = found.number[0]
    if slot < 4:
        found.of_ray[ray, slot] = number
    found.normals[number] = normal
    found.steps.distance_m[number], found.steps.odds[number] = s, odds
    _fill_row(found.steps.rows[number], scene.pose, normal, edge.direction[place], r)
    found.number[0] = number + 1


@kernel
def _is_beside(ray: int, start: int, outwards: int, rays: Rays) -> bool:
    """Return whether a ray lies in the same row or column of the pattern as the one from which it is counted.

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


@kernel
def _edge(pose: PoseArrays, rays: Rays, assumed: Assumptions) -> Edge:
    """Return the places where near surfaces end between neighbouring rays, at a rendered pose."""
    height, width = rays.face.shape
    most, number = 2 * height * width, 0
    edge = Edge(
        most,
        np.empty((most, 3)),
        np.empty(most),
        np.empty(most, np.int64),
        np.empty(most, np.int64),
        np.empty((most, 2), np.int32),
        np.full((2, height, width), -1, np.int32),
    )
    stack = np.empty((DEPTH + 1, 3))
    for one in range(height * width):
        for way in range(2):
            two = one + (width if way else 1)
            beyond = two >= height * width if way else two % width == 0
            if beyond or not _may_end(pose, rays, one, two, assumed):
                continue
            crossing = _crossing(pose, rays, one, two, assumed, stack)
            if crossing.share < 0.0:
                continue
            first_is_front = crossing.one.range_m < crossing.two.range_m
            near, far = crossing.one, crossing.two
            if not first_is_front:
                near, far = far, near
            for k in range(3):
                a = rays.grid.components[k, one // width, one % width]
                b = rays.grid.components[k, two // width, two % width]
                edge.direction[number, k] = a + crossing.share * (b - a)
            edge.direction[number] /= sqrt((edge.direction[number] ** 2).sum())
            edge.range_m[number] = near.range_m
            edge.front[number], edge.back[number] = (one, two) if first_is_front else (two, one)
            edge.faces[number, 0], edge.faces[number, 1] = near.triangle, far.triangle
            edge.of_pair[way, one // width, one % width] = number
            number += 1
    return Edge(number, edge.direction, edge.range_m, edge.front, edge.back, edge.faces, edge.of_pair)


@kernel
def _crossing(  # noqa: PLR0917
    pose: PoseArrays, rays: Rays, one: int, two: int, assumed: Assumptions, stack: FloatArray
) -> Crossing:
    """Return where the outline is between two neighbouring rays, by bisection.

    Args:
        pose: pose of the target in the sensor.
        rays: rays and target; their buffers hold the target rendered at the pose.
        one: row-major index of the first ray.
        two: row-major index of the other ray.
        assumed: statistics of returns.
        stack: memory of ``first_hit``.
    """
    width, origin, ends = rays.face.shape[1], np.empty(3), np.empty((2, 3))
    low, high = 0.0, 1.0
    for k in range(3):
        origin[k] = -(pose.R[0, k] * pose.t[0] + pose.R[1, k] * pose.t[1] + pose.R[2, k] * pose.t[2])
        ends[0, k] = rays.grid.components[k, one // width, one % width]
        ends[1, k] = rays.grid.components[k, two // width, two % width]
    a, b = _hit(rays, one), _hit(rays, two)
    for _ in range(HALVINGS):
        share = 0.5 * (low + high)
        x = ends[0, 0] + share * (ends[1, 0] - ends[0, 0])
        y = ends[0, 1] + share * (ends[1, 1] - ends[0, 1])
        z = ends[0, 2] + share * (ends[1, 2] - ends[0, 2])
        length = sqrt(x * x + y * y + z * z)
        ray = ray_in_target(pose.R, origin, x / length, y / length, z / length)
        hit = first_hit(rays.faces.tree, ray, np.inf, stack)
        if _apart(hit, a) <= _apart(hit, b):
            a, low = hit, share
        else:
            b, high = hit, share
    if _goes_on(pose, rays, a, ends[0] + high * (ends[1] - ends[0]), b, assumed):
        return Crossing(a, b, -1.0)
    if _goes_on(pose, rays, b, ends[0] + low * (ends[1] - ends[0]), a, assumed):
        return Crossing(a, b, -1.0)
    return Crossing(a, b, 0.5 * (low + high))


@kernel
def _hit(rays: Rays, ray: int) -> Hit:
    """Return what a ray of the pattern, a row-major index, meets at the rendered pose."""
    width = rays.face.shape[1]
    i, j = ray // width, ray % width
    return Hit(np.float64(rays.range_m[i, j]), int(np.int64(rays.face[i, j])))


@kernel
def _apart(one: Hit, two: Hit) -> float:
    """Return the difference of two ranges, m: 0 between two misses, inf between a hit and a miss."""
    if one.triangle < 0 or two.triangle < 0:
        return 0.0 if one.triangle == two.triangle else np.inf
    return abs(one.range_m - two.range_m)


@kernel
def _may_end(pose: PoseArrays, rays: Rays, one: int, two: int, assumed: Assumptions) -> bool:
    """Return whether a surface may end between two rays: neither continues the other's plane."""
    width = rays.face.shape[1]
    a = int(np.int64(rays.face[one // width, one % width]))
    b = int(np.int64(rays.face[two // width, two % width]))
    if a < 0 or b < 0:
        return bool(a != b)
    if a == b:
        return False
    limit = JUMP * assumed.sigma_m
    forth = abs(_on_plane(pose, rays, a, two) - np.float64(rays.range_m[two // width, two % width]))
    aback = abs(_on_plane(pose, rays, b, one) - np.float64(rays.range_m[one // width, one % width]))
    return bool(forth > limit and aback > limit)


@kernel
def _goes_on(  # noqa: PLR0917
    pose: PoseArrays, rays: Rays, hit: Hit, direction: FloatArray, other: Hit, assumed: Assumptions
) -> bool:
    """Return whether what a ray met nearby is on the plane of what another ray met, within the noise.

    Args:
        pose: pose of the target in the sensor.
        rays: rays and target.
        hit: what the one ray met.
        direction: unit direction of the other ray, sensor axes, shape (3,).
        other: what this ray met.
        assumed: statistics of returns.
    """
    if hit.triangle < 0 or other.triangle < 0:
        return False
    expected_m = _along(pose, rays, hit.triangle, direction)
    return abs(expected_m - other.range_m) < JUMP * assumed.sigma_m


@kernel
def _on_plane(pose: PoseArrays, rays: Rays, face: int, ray: int) -> float:
    """Return the range at which a ray, a row-major index, meets a face's plane, m; inf if it does not."""
    width = rays.face.shape[1]
    return _along(pose, rays, face, rays.grid.components[:, ray // width, ray % width])


@kernel
def _along(pose: PoseArrays, rays: Rays, face: int, direction: Array) -> float:
    """Return ``_on_plane`` for any unit direction in sensor axes, shape (3,)."""
    across, height = 0.0, rays.faces.offsets_m[face]
    for k in range(3):
        n = 0.0
        for c in range(3):
            n += pose.R[k, c] * rays.faces.normals[face, c]
        across += n * direction[k]
        height += n * pose.t[k]
    found = height / across
    return found if found > 0.0 else np.inf


@kernel
def _log_likelihood(scene: Scene, ray: int, face: int) -> float:
    """Return the log likelihood of a ray's result, by its row-major index, if it meets a face (-1: none)."""
    rays, pose, assumed, width = scene.rays, scene.pose, scene.assumed, scene.range_m.shape[1]
    i, j, density, cosine = ray // width, ray % width, assumed.clutter_density, 0.0
    m = scene.range_m[i, j]
    if face < 0:
        return log(density) if m > 0.0 else log(1.0 - assumed.clutter_share)
    for k in range(3):
        for c in range(3):
            cosine -= pose.R[k, c] * rays.faces.normals[face, c] * rays.grid.components[k, i, j]
    cosine = max(cosine, STEEPEST)
    r = _on_plane(pose, rays, face, ray)
    echo = cosine * rays.faces.albedo[face] * (assumed.least_range_m / r) ** 2
    rung = min(max(int((log(max(echo, 1e-9)) - LEAST_LOG) * RUNGS_PER_LOG), 0), RUNGS - 1)
    if m <= 0.0:
        return float(assumed.detection.log_missing[scene.power, rung])
    lateral_m = assumed.slack_m / cosine
    variance = assumed.sigma_m * assumed.sigma_m + lateral_m * lateral_m
    tail = 1.0 + 0.25 * (m - r) * (m - r) / variance
    near = PEAK / (sqrt(variance * tail) * tail * tail)
    return float(log(near * exp(assumed.detection.log_share[scene.power, rung]) + density))


@kernel
def _fill_row(
    row: FloatArray, pose: PoseArrays, normal: FloatArray, place: FloatArray, range_m: float
) -> None:
    """Fill the derivatives of the distance of a ray from the outline by (dtau, dtheta), shape (6,).

    A motion of the target by d along the normal, which points inwards, brings the outline nearer by d.

    Args:
        row: output.
        pose: pose of the target in the sensor.
        normal: inward normal of the outline, sensor axes, shape (3,).
        place: direction of a place on it, sensor axes, shape (3,).
        range_m: range of this place.
    """
    n, x = np.empty(3), np.empty(3)
    for c in range(3):
        n[c], x[c] = 0.0, 0.0
        for k in range(3):
            n[c] += pose.R[k, c] * normal[k]
            x[c] += pose.R[k, c] * (range_m * place[k] - pose.t[k])
    row[0], row[1], row[2] = -n[0], -n[1], -n[2]
    row[3], row[4], row[5] = n[1] * x[2] - n[2] * x[1], n[2] * x[0] - n[0] * x[2], n[0] * x[1] - n[1] * x[0]


@kernel
def _normal(edge: Edge, place: int, rays: Rays) -> FloatArray:
    """Return the inward normal of the outline at a place, sensor axes, perpendicular to its direction, (3,).

    The outline goes on to a place in each of the two squares of four rays that the place lies between
    (marching squares). Where the two ways differ, at a corner of the target, the straighter one is taken.
    """
    width, here, tangent = rays.face.shape[1], edge.direction[place], np.zeros(3)
    i, j, way = _pair(edge, place, width)
    ahead, behind = _next(edge, place, i - 1 + way, j - way), _next(edge, place, i, j)
    if ahead >= 0 and behind >= 0:
        one, two = _unit(edge.direction[ahead] - here), _unit(here - edge.direction[behind])
        if (one * two).sum() > SAME_LINE:
            tangent = edge.direction[ahead] - edge.direction[behind]
        elif _straightness(edge, ahead, i - 1 + way, j - way, one) >= _straightness(edge, behind, i, j, -two):
            tangent = one
        else:
            tangent = two
    elif ahead >= 0:
        tangent = edge.direction[ahead] - here
    elif behind >= 0:
        tangent = here - edge.direction[behind]
    inwards = np.empty(3)
    for k in range(3):
        inwards[k] = (
            rays.grid.components[k, edge.front[place] // width, edge.front[place] % width]
            - rays.grid.components[k, edge.back[place] // width, edge.back[place] % width]
        )
    normal = np.empty(3)
    normal[0] = here[1] * tangent[2] - here[2] * tangent[1]
    normal[1] = here[2] * tangent[0] - here[0] * tangent[2]
    normal[2] = here[0] * tangent[1] - here[1] * tangent[0]
    if ahead < 0 and behind < 0:
        normal = inwards - (inwards * here).sum() * here
    normal = _unit(normal)
    return normal if (normal * inwards).sum() >= 0.0 else -normal


@kernel
def _unit(vector: FloatArray) -> FloatArray:
    """Return a vector divided by its length, shape (3,); zero stays zero."""
    length = sqrt((vector**2).sum())
    return vector / length if length > 0.0 else vector


@kernel
def _pair(edge: Edge, place: int, width: int) -> tuple[int, int, int]:
    """Return row and column of the first ray of a place's pair, and 1 if the other is in the next row."""
    first = min(edge.front[place], edge.back[place])
    way = 0 if abs(edge.front[place] - edge.back[place]) == 1 else 1
    return first // width, first % width, way


@kernel
def _next(edge: Edge, place: int, row: int, column: int) -> int:
    """Return the place to which the outline goes on in the square of four rays from a row and column on.

    If there are several, it is the one at the most similar range; -1 without any.
    """
    height, width = edge.of_pair.shape[1], edge.of_pair.shape[2]
    if row < 0 or column < 0 or row + 1 >= height or column + 1 >= width:
        return -1
    found, least = -1, np.inf
    for other in (
        edge.of_pair[0, row, column],
        edge.of_pair[0, row + 1, column],
        edge.of_pair[1, row, column],
        edge.of_pair[1, row, column + 1],
    ):
        if other >= 0 and other != place:
            difference = abs(edge.range_m[other] - edge.range_m[place])
            if difference < least:
                found, least = int(np.int64(other)), difference
    return found


@kernel
def _straightness(edge: Edge, place: int, row: int, column: int, way: FloatArray) -> float:
    """Return the cosine by which the outline turns after it came to a place; -1 if it ends there.

    Args:
        edge: all places.
        place: the place.
        row: first row of the square that it came through.
        column: first column of this square.
        way: unit direction in which it came, sensor axes, shape (3,).
    """
    i, j, down = _pair(edge, place, edge.of_pair.shape[2])
    if row == i and column == j:
        i, j = i - 1 + down, j - down
    onward = _next(edge, place, i, j)
    if onward < 0:
        return -1.0
    return float((_unit(edge.direction[onward] - edge.direction[place]) * way).sum())
