"""Alignment of the target with a scan: first steps in the distance field, then steps to the faces.

In the first steps the residual of a return is its distance in the field, which needs no correspondence. In
the last steps the target is cast at the pose. Each return belongs to the face that its own ray meets. Its
residual is the distance from that face's plane, weighted for an error along the ray (projective point to
plane, after G. Blais, M. D. Levine, Registering Multiview Range Data to Create 3D Computer Objects, IEEE PAMI
17, 1995). The unknowns are those of ``normal_equations``; Geman-McClure weights reduce the effect of
outliers.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.rays import GridArrays, RenderBuffers
from rpod_pose.registration.distance_field import FieldArrays, distance_and_gradient
from rpod_pose.registration.field_alignment import REACH_M, REACH_RAD
from rpod_pose.registration.gauss_newton import Linear, State, linearises, minimised
from rpod_pose.registration.lie_group import PoseArrays, Vector, in_target
from rpod_pose.registration.normal_equations import (
    UNKNOWNS,
    add_residual,
    geman_mcclure,
    information_of,
    no_sums,
)
from rpod_pose.registration.surface_model import Faces, cast_faces
from rpod_schemas.arrays import FloatArray

FEWEST = 3
"""Least number of returns on faces for a step. Physics: each gives one equation, and the prior of a step
determines the rest."""
INFLUENTIAL = 0.75
"""Leverage above which a single return determines a direction; it may be assigned to the wrong face. Hand:
without this return the direction has a quarter of its information."""
PARALLEL = 1e-6
"""Least squared cosine of incidence in a division, for a face seen edge-on. Numerics: it avoids a division by
zero; ``steepest`` is larger in practice."""


class ScanErrors(NamedTuple):
    """Assumed errors of returns and faces."""

    sigma_m: float
    """Standard deviation of a range."""
    slack_m: float
    """Standard deviation of a face's position along its normal."""
    steepest: float
    """Least squared cosine of incidence in the distance along the ray, by which outliers are detected."""
    per_outline_m: float
    """Inverse of the standard deviation of the distance in the field, for a return whose ray misses the
    target, 1/m; with 0 such returns are left out."""


class FaceProblem(NamedTuple):
    """Returns to be aligned with the faces that their rays meet."""

    points_m: FloatArray
    """Returns, sensor axes, shape (N, 3)."""
    rays: NDArray[np.int64]
    """Row-major index of each return's ray, -1 for none, shape (N,)."""
    grid: GridArrays
    """Grid of the sensor's rays, shape (rows, columns)."""
    faces: Faces
    field: FieldArrays
    """Distance field of the same target, for returns whose rays miss it."""
    errors: ScanErrors
    scales_m: FloatArray
    """Geman-McClure scale of a range's residual in each step, shape (steps,)."""
    buffers: RenderBuffers
    """Buffers of the target rendered at the pose."""


class FaceEvidence(NamedTuple):
    """Statistics of the returns on faces in one step."""

    sums: FloatArray
    """Sums over the returns on faces alone, shape (35,)."""
    rows: FloatArray
    """Derivatives and weight of each return, shape (N, 7); the weight is 0 for a return that is on no
    face."""
    squares_m2: float
    """Sum of the inliers' squared distances from their planes."""
    inliers: int
    """Number of returns within the Geman-McClure scale."""
    faded: float
    """Sum of the inliers' Geman-McClure weights, at most their number."""


class FaceFit(NamedTuple):
    """A pose aligned with the faces."""

    pose: PoseArrays
    information: FloatArray
    """Information matrix of (dtau, dtheta) in the last step, without influential returns, for the assumed
    sigmas, shape (6, 6). It is rescaled so that inliers count fully, although their weights are below 1."""
    squares_m2: float
    """Sum of the squared distances of the last step's inliers from their planes."""
    inliers: int
    """Number of returns within the last Geman-McClure scale."""


@kernel
def excess(squares_m2: float, inliers: int, sigma_m: float) -> float:
    """Return the factor by which the variance of residuals exceeds the assumed one, at least 1.

    It takes account of the degrees of freedom that six unknowns use.

    Args:
        squares_m2: sum of the inliers' squared distances from their planes.
        inliers: number of inliers.
        sigma_m: assumed standard deviation of a range.
    """
    return max(1.0, squares_m2 / (max(inliers, 1) * sigma_m * sigma_m)) * inliers / max(inliers - 6, 1)


@kernel
def pose_covariance(information: FloatArray, R: FloatArray) -> FloatArray:
    """Return the covariance of (dp, dtheta) in sensor axes, shape (6, 6).

    It is the inverse of the information matrix of (dtau, dtheta), shape (6, 6), rotated by R_sensor_target.
    """
    to_sensor = np.zeros((6, 6))
    to_sensor[:3, :3] = R
    to_sensor[3:, 3:] = R
    covariance: FloatArray = to_sensor @ np.linalg.inv(information) @ to_sensor.T
    return covariance


@kernel
def without_influential(information: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the information without returns whose leverage is above ``INFLUENTIAL``, shape (6, 6).

    The leverage of a residual is w J (sum of w J^T J)^-1 J^T, its share in its own prediction
    (R. D. Cook, Detection of Influential Observation in Linear Regression, Technometrics 19(1), 1977).

    Args:
        information: information of all returns, shape (6, 6).
        rows: derivatives and weight of each return, shape (N, 7).
    """
    leverages = np.linalg.inv(information + 1e-3 * np.eye(6))
    for i in range(6):
        leverages[i, :i] = 0.0
        leverages[i, i + 1 :] *= 2.0
    kept = information.copy()
    for row in rows:
        leverage = 0.0
        for i in range(6):
            product = 0.0
            for j in range(i, 6):
                product += leverages[i, j] * row[j]
            leverage += row[i] * product
        if row[6] * leverage > INFLUENTIAL:
            for i in range(6):
                for j in range(6):
                    kept[i, j] -= row[6] * row[i] * row[j]
    return kept


@kernel
def add_face_points(
    outline: FloatArray, problem: FaceProblem, pose: PoseArrays, scale: float
) -> FaceEvidence:
    """Return the sums and the evidence of returns on faces; add the factors of the others to ``outline``.

    A return on a face with the plane n . q = o has the residual n . q - o along n. Its error along the ray
    causes an error of sigma cos(incidence) along the normal, and the face has an error of its own, the slack.
    So the weight is 1 / (sigma^2 cos^2 + slack^2). For a return whose ray misses the target, the residual is
    the distance in the target's field, along the field's gradient.

    Args:
        outline: sums over the returns whose rays miss the target, shape (35,), input and output.
        problem: the problem; its buffers hold the target rendered at the pose.
        pose: pose to linearise at.
        scale: Geman-McClure scale, m, above 0.
    """
    points, rays = problem.points_m, problem.rays
    normals, offsets = problem.faces.normals, problem.faces.offsets_m
    origin, per_m, values = problem.field.origin_m, 1.0 / problem.field.spacing_m, problem.field.values
    errors, owner = problem.errors, problem.buffers.triangle.reshape(-1)
    R, t, c2, sums = pose.R, pose.t, scale * scale, no_sums()
    rows, inliers, counted, squares = np.zeros((points.shape[0], 7)), 0, 0.0, 0.0
    for n in range(points.shape[0]):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        x, y, z = in_target(R, px - t[0], py - t[1], pz - t[2])
        face = owner[rays[n]] if 0 <= rays[n] < owner.size else -1
        if face < 0:  # the ray misses the target: the residual moves the outline towards the return
            d, g = distance_and_gradient(
                (x - origin[0]) * per_m, (y - origin[1]) * per_m, (z - origin[2]) * per_m, values
            )
            weight = geman_mcclure(d * d, c2) * errors.per_outline_m * errors.per_outline_m
            slope = Vector(g.x * per_m, g.y * per_m, g.z * per_m)
            add_residual(outline, slope, Vector(x, y, z), d, weight)
            continue
        dx, dy, dz = in_target(R, px, py, pz)
        n0, n1, n2 = float(normals[face, 0]), float(normals[face, 1]), float(normals[face, 2])
        e = n0 * x + n1 * y + n2 * z - offsets[face]
        cosine2 = (n0 * dx + n1 * dy + n2 * dz) ** 2 / (px * px + py * py + pz * pz)
        along2 = e * e / max(cosine2, errors.steepest, PARALLEL)
        fading = geman_mcclure(along2, c2)
        weight = fading / (errors.sigma_m**2 * cosine2 + errors.slack_m**2)
        add_residual(sums, Vector(n0, n1, n2), Vector(x, y, z), e, weight)
        rows[n, 0], rows[n, 1], rows[n, 2] = n0, n1, n2
        rows[n, 3], rows[n, 4], rows[n, 5] = y * n2 - z * n1, z * n0 - x * n2, x * n1 - y * n0
        rows[n, 6] = weight
        if along2 < c2:
            inliers += 1
            counted += fading
            squares += e * e
    return FaceEvidence(sums, rows, squares, inliers, counted)


@linearises(FaceProblem)
@inner_kernel
def face_equations(problem: FaceProblem, state: State, step: int) -> Linear[FaceEvidence]:
    """Return the normal equations of a scan at a pose: each return belongs to the face that its ray meets."""
    pose, buffers = state.pose, problem.buffers
    cast_faces(problem.grid, problem.faces, pose.R, pose.t, buffers)
    outline, hold = no_sums(), np.ones(UNKNOWNS)
    evidence = add_face_points(outline, problem, pose, problem.scales_m[step])
    hold[:3] = REACH_M**-2
    hold[3:6] = REACH_RAD**-2
    return Linear(evidence.sums + outline, hold, evidence.inliers >= FEWEST, evidence)


@inner_kernel
def face_aligned(problem: FaceProblem, pose: PoseArrays) -> FaceFit:
    """Return the pose after one step to the faces for each of the problem's Geman-McClure scales."""
    fit = minimised(problem, State(pose, 0.0), problem.scales_m.size)
    evidence = fit.linear.evidence
    whole = evidence.inliers / max(evidence.faded, 1e-6)
    information = without_influential(information_of(evidence.sums, 6), evidence.rows) * whole
    return FaceFit(fit.state.pose, information, evidence.squares_m2, evidence.inliers)
