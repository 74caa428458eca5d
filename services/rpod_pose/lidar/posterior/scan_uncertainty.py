"""Covariance of a registered scan: its own noise, and the errors of the target's model.

The registration's information contains assumptions that a single scan needs for its belief: faces deviate
from the model by a slack, and the variance of the residuals is never below the stated one. Both also hold for
the outline. The noise that is independent from scan to scan is estimated here from the residuals, each with
its weight in the fit.
"""

from typing import NamedTuple, Self

import numpy as np

from rpod_pose.lidar.scan_alignment import (
    INFLUENTIAL,
    FaceProblem,
    add_face_points,
    excess,
    without_influential,
)
from rpod_pose.lidar.scan_registration import ScanRegistration
from rpod_pose.registration.model_error import ModelError, Parts
from rpod_pose.registration.normal_equations import no_sums
from rpod_pose.registration.surface_model import cast_faces
from rpod_schemas.arrays import FloatArray

LEAST_RESPONSE = 0.5
"""Least mean derivative of a robust residual over its mean weight. Hand: normal errors at a scale of three
standard deviations have 0.7."""


class FaceRows(NamedTuple):
    """Returns on faces at the registered pose, one a row."""

    derivatives: FloatArray
    """Derivatives of the residuals with respect to (dtau, dtheta), with the opposite sign, shape (N, 6)."""
    weights: FloatArray
    """Weights in the last step, shape (N,)."""
    fading: FloatArray
    """Geman-McClure factors in these weights, shape (N,)."""
    residuals_m: FloatArray
    """Distances from the faces' planes, shape (N,)."""
    places_m: FloatArray
    """Positions of the returns, target axes, shape (N, 3)."""
    whole: float
    """Factor by which the registration's information is larger than the sum of these rows."""

    @classmethod
    def of(cls, problem: FaceProblem, found: ScanRegistration) -> Self:
        """Return the rows of a scan at its registered pose."""
        R, t = found.pose
        cast_faces(problem.grid, problem.faces, R, t, problem.buffers)
        evidence = add_face_points(no_sums(), problem, found.pose, problem.scales_m[-1])
        on_face = evidence.rows[:, 6] > 0.0
        rows, points_m = evidence.rows[on_face], problem.points_m[on_face]
        face = problem.buffers.triangle.reshape(-1)[problem.rays[on_face]]
        normals, places_m = rows[:, :3], (points_m - t) @ R
        along = np.einsum("ij,ij->i", normals, points_m @ R)
        cosine2 = along**2 / np.einsum("ij,ij->i", points_m, points_m)
        variance = problem.errors.sigma_m**2 * cosine2 + problem.errors.slack_m**2
        residuals_m = np.einsum("ij,ij->i", normals, places_m) - problem.faces.offsets_m[face]
        whole = evidence.inliers / max(evidence.faded, 1e-6)
        whole /= excess(found.faces.squares_m2, found.faces.inliers, problem.errors.sigma_m)
        return cls(rows[:, :6], rows[:, 6], rows[:, 6] * variance, residuals_m, places_m, whole)

    @property
    def information(self) -> FloatArray:
        """Information matrix of the rows: the weighted sum of J^T J, shape (6, 6)."""
        found: FloatArray = (self.derivatives * self.weights[:, None]).T @ self.derivatives
        return found


def noise_information(rows: FaceRows, found: ScanRegistration, weak: FloatArray) -> FloatArray:
    """Return the information matrix of (dtau, dtheta) for errors that are independent in each scan, (6, 6).

    With weights w, M = sum of w J^T J, and variances v of the residuals, the pose has the covariance
    M^-1 (sum of w^2 v J^T J) M^-1 (H. White, Econometrica 48, 1980). The variance of a residual is estimated
    by its square. The fit reduces this square by the residual's leverage; this part is replaced by the
    assumed variance, scaled to all residuals. With robust weights, the derivative of a weighted residual is
    smaller than its weight (P. J. Huber, Robust Statistics, 1981, section 7.6). The information from the
    outline is added unchanged.

    Args:
        rows: returns on faces.
        found: the registration.
        weak: weak prior information that keeps the matrices regular, shape (6, 6).
    """
    J, w, whole_sum = rows.derivatives, rows.weights, rows.information
    inverse = np.linalg.inv(whole_sum + weak)
    leverages = np.einsum("ij,jk,ik->i", J, inverse, J) * w
    kept = leverages <= INFLUENTIAL
    slopes = rows.fading * (4.0 * np.sqrt(rows.fading) - 3.0)
    response = max(float(slopes.sum()) / max(float(rows.fading.sum()), 1e-12), LEAST_RESPONSE)
    assumed = rows.fading / np.maximum(w, 1e-300)
    left = max(float((1.0 - leverages)[kept].sum()), 1.0)
    scale = float((rows.residuals_m**2 / np.maximum(assumed, 1e-300))[kept].sum()) / left
    variance = rows.residuals_m**2 + leverages * scale * assumed
    J, w, variance = J[kept], w[kept], variance[kept]
    answer = (J * w[:, None]).T @ J * response + weak
    scatter = (J * (w**2 * variance)[:, None]).T @ J + weak
    by_faces: FloatArray = answer @ np.linalg.solve(scatter, answer)
    if not np.array_equal(found.information, found.faces.information):  # equal only if the outline was used
        return by_faces
    every = np.column_stack((rows.derivatives, rows.weights))
    return by_faces + _positive(found.information - without_influential(whole_sum, every) * rows.whole)


def model_covariance(rows: FaceRows, covariance: FloatArray, error: ModelError, parts: Parts) -> FloatArray:
    """Return the covariance of (dtau, dtheta) caused by the errors of the target's model alone, shape (6, 6).

    Displacements of the target's parts move the returns on faces; the outline counts as exact.

    Args:
        rows: returns on faces.
        covariance: inverse of the registration's information, shape (6, 6).
        error: declared errors of the model.
        parts: the target's parts.
    """
    cells = parts.cells(rows.places_m, parts.at(rows.places_m))
    informations, centres_m = [], []
    for cell in range(int(cells.max(initial=-1)) + 1):
        mine = cells == cell
        J, weights = rows.derivatives[mine], rows.whole * rows.weights[mine]
        informations.append((J * weights[:, None]).T @ J)
        centres_m.append(rows.places_m[mine].mean(axis=0))
    if not informations:
        return np.zeros((6, 6))
    return error.considered(covariance, np.array(informations), np.array(centres_m)) - covariance


def _positive(information: FloatArray) -> FloatArray:
    """Return an information matrix with negative eigenvalues set to zero, shape (6, 6)."""
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    found: FloatArray = (vectors * values.clip(0.0)) @ vectors.T
    return found
