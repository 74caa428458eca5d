"""Alignment of the target with a scan: steps in the distance field from afar, steps to the faces to finish.

From afar each return is moved along the distance field's gradient, which needs no correspondence. To finish,
the target is cast at the pose: each return belongs to the face that its own ray meets, and its residual is
the distance from that face's plane, weighted for an error along the ray (projective point to plane, after
G. Blais, M. D. Levine, Registering Multiview Range Data to Create 3D Computer Objects, IEEE PAMI 17, 1995).
Both steps share the unknowns of ``normal_equations``; outliers fade by Geman-McClure weights.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_geometry.rays import GridArrays, RenderBuffers, cast_pose
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
from rpod_pose.registration.surface_model import Faces
from rpod_schemas.arrays import FloatArray

FEWEST = 3
"""Fewer returns on faces determine no step."""
ALONE = 0.75
"""Leverage beyond which a return alone determines a motion: it may be on the wrong face."""
PARALLEL = 1e-6
"""Squared cosine of incidence that stands for less: a face seen edge-on."""


class ScanErrors(NamedTuple):
    """What is assumed of returns and faces."""

    sigma_m: float
    """Standard deviation of a range."""
    slack_m: float
    """Standard deviation of a face's plane."""
    steepest: float
    """Squared cosine of incidence below which the distance from a plane tells outliers, not along the ray."""
    per_outline_m: float
    """One over the standard deviation of the field's distance of a return whose ray passes the target by,
    1/m; 0 leaves those out."""


class FaceProblem(NamedTuple):
    """Returns to be aligned with the faces that their rays meet."""

    points_m: FloatArray
    """Returns, sensor axes, shape (N, 3)."""
    rays: NDArray[np.int64]
    """Row-major index of each return's ray, -1 for none, shape (N,)."""
    grid: GridArrays
    """Of the sensor's rays, shape (rows, columns)."""
    faces: Faces
    field: FieldArrays
    """Of the same target, for returns whose rays pass it by."""
    errors: ScanErrors
    scales_m: FloatArray
    """Geman-McClure scale of a range's residual in each step, shape (steps,)."""
    buffers: RenderBuffers


class FaceEvidence(NamedTuple):
    """What returns on faces say in one step."""

    sums: FloatArray
    """Of returns on faces alone, shape (35,)."""
    claims: FloatArray
    """Derivatives and weight of each return, shape (N, 7); weight 0 for one that is on no face."""
    squares_m2: float
    """Sum of the inliers' squared distances from their planes."""
    inliers: int
    """Returns within the Geman-McClure scale."""
    faded: float
    """Sum of the inliers' Geman-McClure weights."""


class ScanFit(NamedTuple):
    """A pose settled on the faces."""

    pose: PoseArrays
    information: FloatArray
    """About (dtau, dtheta), what more than one return tells in the last step, in units of one over the
    weights' sigmas, shape (6, 6); inliers count as whole ones, though good ones fade a little too."""
    squares_m2: float
    """Sum of the squared distances of the last step's inliers from their planes."""
    inliers: int
    """Returns within the last Geman-McClure scale."""


@kernel
def spread(information: FloatArray, R: FloatArray) -> FloatArray:
    """Return the covariance of (dp, dtheta) in the sensor's axes, shape (6, 6).

    That is the inverse of the information about (dtau, dtheta), shape (6, 6), turned by R_sensor_target.
    """
    to_sensor = np.zeros((6, 6))
    to_sensor[:3, :3] = R
    to_sensor[3:, 3:] = R
    covariance: FloatArray = to_sensor @ np.linalg.inv(information) @ to_sensor.T
    return covariance


@kernel
def shared(information: FloatArray, claims: FloatArray) -> FloatArray:
    """Return the information without that of returns whose leverage is beyond ``ALONE``, shape (6, 6).

    The leverage of a residual is w J (sum of w J^T J)^-1 J^T, its share in its own prediction
    (R. D. Cook, Detection of Influential Observation in Linear Regression, Technometrics 19(1), 1977).

    Args:
        information: of all returns, shape (6, 6).
        claims: derivatives and weight of each return, shape (N, 7).
    """
    leverages = np.linalg.inv(information + 1e-3 * np.eye(6))
    for i in range(6):
        leverages[i, :i] = 0.0
        leverages[i, i + 1 :] *= 2.0
    kept = information.copy()
    for claim in claims:
        leverage = 0.0
        for i in range(6):
            row = 0.0
            for j in range(i, 6):
                row += leverages[i, j] * claim[j]
            leverage += claim[i] * row
        if claim[6] * leverage > ALONE:
            for i in range(6):
                for j in range(6):
                    kept[i, j] -= claim[6] * claim[i] * claim[j]
    return kept


@kernel
def add_face_points(
    outline: FloatArray, problem: FaceProblem, pose: PoseArrays, scale: float
) -> FaceEvidence:
    """Return the sums and the evidence of returns on faces; add the factors of the others to ``outline``.

    A return on a face with the plane n . q = o has the residual n . q - o along n. Its error along the ray
    shows as sigma cos(incidence) along the normal, and the face itself may be off by the slack, so that its
    weight is 1 / (sigma^2 cos^2 + slack^2). A return whose ray passes the target by has the distance in the
    target's field as its residual, along the field's gradient.

    Args:
        outline: sums of the returns beyond the outline, shape (35,), in and out.
        problem: what is aligned; its buffers hold the target rendered at the pose.
        pose: to linearise at.
        scale: of Geman and McClure, m, above 0.
    """
    points, rays = problem.points_m, problem.rays
    normals, offsets = problem.faces.normals, problem.faces.offsets_m
    origin, per_m, values = problem.field.origin_m, 1.0 / problem.field.spacing_m, problem.field.values
    errors, owner = problem.errors, problem.buffers.triangle.reshape(-1)
    R, t, c2, sums = pose.R, pose.t, scale * scale, no_sums()
    claims, inliers, counted, squares = np.zeros((points.shape[0], 7)), 0, 0.0, 0.0
    for n in range(points.shape[0]):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        x, y, z = in_target(R, px - t[0], py - t[1], pz - t[2])
        face = owner[rays[n]] if 0 <= rays[n] < owner.size else -1
        if face < 0:  # beyond the outline, which is moved towards it
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
        claims[n] = (n0, n1, n2, y * n2 - z * n1, z * n0 - x * n2, x * n1 - y * n0, weight)
        if along2 < c2:
            inliers += 1
            counted += fading
            squares += e * e
    return FaceEvidence(sums, claims, squares, inliers, counted)


@linearises(FaceProblem)
@kernel
def face_equations(problem: FaceProblem, state: State, step: int) -> Linear[FaceEvidence]:
    """Return the normal equations of a scan at a pose: each return belongs to the face that its ray meets."""
    pose, buffers = state.pose, problem.buffers
    cast_pose(
        problem.grid, problem.faces.triangles_m, pose.R, pose.t, True, buffers.range_m, buffers.triangle
    )
    outline, hold = no_sums(), np.ones(UNKNOWNS)
    evidence = add_face_points(outline, problem, pose, problem.scales_m[step])
    hold[:3] = REACH_M**-2
    hold[3:6] = REACH_RAD**-2
    return Linear(evidence.sums + outline, hold, evidence.inliers >= FEWEST, evidence)


@kernel
def settle(problem: FaceProblem, pose: PoseArrays) -> ScanFit:
    """Return the pose after one step to the faces for each of the problem's scales."""
    fit = minimised(problem, State(pose, 0.0), problem.scales_m.size)
    evidence = fit.linear.evidence
    whole = evidence.inliers / max(evidence.faded, 1e-6)
    information = shared(information_of(evidence.sums, 6), evidence.claims) * whole
    return ScanFit(fit.state.pose, information, evidence.squares_m2, evidence.inliers)
