"""Alignment of points with a target in its distance field, without a search for correspondences.

A measured point p, in sensor axes, lies at q = R^T (p - t) in target axes; its residual is the signed
distance d(q), trilinear in the grid, along its gradient (``normal_equations``). Outliers are damped by
Geman-McClure weights, whose scale narrows from step to step.
"""

from typing import NamedTuple

import numpy as np

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_pose.registration.distance_field import (
    FieldArrays,
    FieldSample,
    distance_and_gradient,
    field_at,
)
from rpod_pose.registration.gauss_newton import Fit, Linear, State, linearises, minimised
from rpod_pose.registration.lie_group import PoseArrays, Vector, in_target
from rpod_pose.registration.normal_equations import (
    UNKNOWNS,
    add_residual,
    geman_mcclure,
    no_sums,
)
from rpod_schemas.arrays import FloatArray

AWAY = 0.5
"""Largest cosine between a ray and the normal of a face that can have reflected it. Hand: for a visible face
it is negative; 0.5 leaves 30 deg for the error of the pose."""
TRACED = 8
"""Largest number of steps to the face in front of a point. Numerics: a budget; each step is at least half a
cell."""
REACH_M, REACH_RAD = 0.5, 0.1
"""Prior standard deviations of a step, m and rad. Numerics: it is then small in directions that no point
determines."""
SPREAD = 0.1
"""Assumed standard deviation of the residuals, over the Geman-McClure scale. Hand: it matters only in
directions that no point determines."""


class Points(NamedTuple):
    """Measured points with weights."""

    places_m: FloatArray
    """Positions of the points, sensor axes, shape (N, 3)."""
    trust: FloatArray
    """Weight of each point, 0 to 1, shape (N,)."""

    @classmethod
    def equal(cls, places_m: FloatArray) -> "Points":
        """Return points of equal weight, sensor axes, shape (N, 3), m."""
        return cls(places_m, np.ones(len(places_m)))


class FieldEvidence(NamedTuple):
    """Statistics of points in a distance field."""

    weight: float
    """Sum of the weights."""
    squares_m2: float
    """Sum of the inliers' squared distances, times their trust."""
    inliers: int
    """Number of points within the Geman-McClure scale."""
    trusted: float
    """Sum of the inliers' trust."""


class FieldProblem(NamedTuple):
    """Points to be aligned with a target's distance field."""

    points: Points
    field: FieldArrays
    scales_m: FloatArray
    """Geman-McClure scale of each step, shape (steps,)."""


@inner_kernel
def add_field_points(
    sums: FloatArray, points: Points, pose: PoseArrays, field: FieldArrays, scale: float
) -> FieldEvidence:
    """Add the factors of points in a distance field to the sums, shape (35,); return their evidence.

    If the nearest face of a point is turned away from the sensor, the point belongs to the face in front, up
    to a distance of twice the scale. Without such a face it has no residual.

    Args:
        sums: information and gradient, input and output.
        points: N measured points.
        pose: pose to linearise at.
        field: the target's distance field.
        scale: Geman-McClure scale, m, above 0.
    """
    R, t = pose.R, pose.t
    places, trust, c2 = points.places_m, points.trust, scale * scale
    weights, squares, inliers, trusted = 0.0, 0.0, 0, 0.0
    for n in range(places.shape[0]):
        px, py, pz = places[n, 0], places[n, 1], places[n, 2]
        ray, range_m = in_target(R, px, py, pz), np.sqrt(px * px + py * py + pz * pz)
        place = in_target(R, px - t[0], py - t[1], pz - t[2])
        distance, g = seen_sample(field, place, ray, range_m, 2.0 * scale)
        if g.x == 0.0 and g.y == 0.0 and g.z == 0.0:
            continue
        d2 = distance * distance
        weight = trust[n] * geman_mcclure(d2, c2)
        weights += weight
        add_residual(sums, g, place, distance, weight)
        inlier = (
            1 if d2 < c2 else 0
        )  # no branch, because the processor would predict it wrongly half of the time
        inliers += inlier
        squares += inlier * trust[n] * d2
        trusted += inlier * trust[n]
    return FieldEvidence(weights, squares, inliers, trusted)


@inner_kernel
def seen_sample(field: FieldArrays, place: Vector, ray: Vector, range_m: float, reach: float) -> FieldSample:
    """Return the distance of a place from the nearest face that the sensor can see, and its gradient.

    If the nearest face is turned away from the sensor, the distance is that from the face in front, up to
    ``reach``; the gradient is 0 if there is none.

    Args:
        field: the target's distance field.
        place: the place, target axes, m.
        ray: vector from the sensor to the measured point, target axes, of any length.
        range_m: this length.
        reach: largest distance to a face in front, m.
    """
    origin, per_m = field.origin_m, 1.0 / field.spacing_m
    distance, slope = distance_and_gradient(
        (place.x - origin[0]) * per_m,
        (place.y - origin[1]) * per_m,
        (place.z - origin[2]) * per_m,
        field.values,
    )
    g = Vector(slope.x * per_m, slope.y * per_m, slope.z * per_m)
    if g.x * ray.x + g.y * ray.y + g.z * ray.z > AWAY * range_m:
        towards = Vector(-ray.x / range_m, -ray.y / range_m, -ray.z / range_m)
        return _face_in_front(field, place, towards, abs(distance), reach)
    return FieldSample(distance, g)


@inner_kernel
def _face_in_front(
    field: FieldArrays, place: Vector, towards: Vector, beyond: float, reach: float
) -> FieldSample:
    """Return the distance of a place from the face in front of it, and that face's normal.

    The range of a thin part may be too long by more than its thickness. Then the nearest face is its back,
    which the sensor does not see. The way towards the sensor is traced through the field until a face is
    turned to the sensor; the distance is that from its plane. The gradient is 0 if there is none.

    Args:
        field: the target's distance field.
        place: a place whose nearest face is turned away from the sensor, target axes, m.
        towards: unit vector towards the sensor, target axes.
        beyond: distance of the nearest face, m.
        reach: longest way, m.
    """
    least, way = 0.5 * field.spacing_m, beyond
    for _ in range(TRACED):
        way = max(way, least)
        if way > reach:
            break
        x, y, z = place.x + way * towards.x, place.y + way * towards.y, place.z + way * towards.z
        distance, g = field_at(field, Vector(x, y, z))
        facing = g.x * towards.x + g.y * towards.y + g.z * towards.z
        if facing > 0.0:
            return FieldSample(distance - way * facing, g)
        way += max(abs(distance), least)
    return FieldSample(0.0, Vector(0.0, 0.0, 0.0))


@linearises(FieldProblem)
@kernel
def field_equations(problem: FieldProblem, state: State, step: int) -> Linear[FieldEvidence]:
    """Return the normal equations of points in a distance field, of the pose alone."""
    scale = problem.scales_m[step]
    sums, hold = no_sums(), np.ones(UNKNOWNS)
    evidence = add_field_points(sums, problem.points, state.pose, problem.field, scale)
    variance = (SPREAD * scale) ** 2
    hold[:3] = variance / REACH_M**2
    hold[3:6] = variance / REACH_RAD**2
    return Linear(sums, hold, True, evidence)


@kernel
def field_fit(problem: FieldProblem, pose: PoseArrays) -> Fit[FieldEvidence]:
    """Return the pose after one step for each of the problem's scales, and the last step's sums."""
    return minimised(problem, State(pose, 0.0), problem.scales_m.size)


@kernel
def field_aligned(points: Points, pose: PoseArrays, field: FieldArrays, scales_m: FloatArray) -> PoseArrays:
    """Return the pose after one step in the field for each Geman-McClure scale, shape (steps,), m."""
    if scales_m.size == 0:
        return pose
    problem = FieldProblem(points, field, scales_m)
    return minimised(problem, State(pose, 0.0), scales_m.size).state.pose
