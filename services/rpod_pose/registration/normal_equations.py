"""Sums over residuals for all methods: the information and the gradient of a least-squares step.

The unknowns are a right perturbation R <- R Exp(dtheta), t <- t + R dtau in target axes, ordered
(dtau, dtheta). If all ranges of a sensor may be too long by the same length, that length is a seventh
unknown. A residual r with the row J of derivatives and the weight w adds w J^T J to the information and w J^T
r to the gradient; the step that minimises the sum of w (r + J step)^2 solves information step = -gradient.

Every residual of the methods here is a length (or an angle) along a normal n at a place q in target axes:
r = n . (q - what it is compared with), where q = R^T (p - t) is where a measured point p lies. A step moves q
by -dtau - dtheta x q, so that J = (-n, -(q x n)) = (-n, n x q).

The sums are kept in one flat array, shape (35,): for each of the six unknowns in turn the upper half of its
row of the information, then its entry of the gradient, 27 numbers; then the entries of the seventh, its
column of the information and its entry of the gradient, 8 numbers. Compilers vectorise writes to constant
places of one array.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_pose.registration.lie_group import Vector
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.methods import DepthErrorConfig
from rpod_target.equivalence import with_variance_about

DAMPING = 1e-6
"""Information added per residual. Numerics: a step then has no component in an unobservable direction."""
DEGENERATE = 1e-4
"""Least information in the worst direction, relative to a direction that every residual determines. Hand: the
standard deviation is then a hundred times as large."""
UNKNOWNS = 7
"""Number of unknowns. Physics: six of the pose, and the length by which all ranges are too long."""
LEAST_PIVOT = 1e-14
"""Least share of a diagonal element that must remain after the elimination of the previous unknowns.
Numerics: a smaller remainder is only rounding."""
SUMS = 35
"""Number of entries of the sums. Physics: 7 + 6 + 5 + 4 + 3 + 2 of the pose, 8 of the seventh unknown."""
OF_POSE = 27
"""Number of entries of the pose, which come first; those of the seventh unknown follow. Physics: 7 + 6 + 5 +
4 + 3 + 2."""


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Sums over the residuals of one iteration."""

    information: FloatArray
    """Sum of w J^T J, shape (6, 6)."""
    gradient: FloatArray
    """Sum of w J^T r, shape (6,)."""
    weight: float
    """Sum of w."""
    squares_m2: float
    """Sum of the inliers' squared residuals."""
    inliers: int
    """Number of residuals within the Geman-McClure scale."""

    @classmethod
    def of(cls, sums: FloatArray, *, weight: float, squares_m2: float, inliers: int) -> Self:
        """Return the sums of a kernel, shape (35,), over residuals that six unknowns explain."""
        return cls(information_of(sums, 6), gradient_of(sums, 6), weight, squares_m2, inliers)

    @classmethod
    def none(cls) -> Self:
        """Return the sums over no residual."""
        return cls(np.zeros((6, 6)), np.zeros(6), 0.0, 0.0, 0)

    def __add__(self, other: "NormalEquations") -> "NormalEquations":
        return NormalEquations(
            self.information + other.information,
            self.gradient + other.gradient,
            self.weight + other.weight,
            self.squares_m2 + other.squares_m2,
            self.inliers + other.inliers,
        )

    @property
    def cost_m2(self) -> float:
        """Mean squared residual of the inliers; NaN if there is none."""
        return self.squares_m2 / self.inliers if self.inliers else float("nan")

    def step(self) -> FloatArray:
        """Return the step (dtau, dtheta), shape (6,), m and rad."""
        damped = self.information + (DAMPING * self.weight + 1e-12) * np.eye(6)
        step: FloatArray = np.linalg.solve(damped, -self.gradient).astype(np.float64, copy=False)
        return step

    def without_turn(self, axes: FloatArray) -> Self:
        """Return the sums with known angles about axes through the origin, target axes, shape (F, 3).

        It is used for a target's free axes: the residuals do not determine these angles.
        """
        if not len(axes):
            return self
        known = float(self.information[3:, 3:].trace())
        return replace(self, information=with_variance_about(self.information, axes, known, first=3))

    def degenerate(self, radius_m: float) -> bool:
        """Return whether a motion of a target of this radius is undetermined in any direction."""
        if not self.inliers:
            return True
        scale = np.repeat((1.0, 1.0 / radius_m), 3)
        scaled = self.information * np.outer(scale, scale) / self.weight
        return bool(np.linalg.eigvalsh(scaled)[0] < DEGENERATE)

    def covariance(self, T_sensor_target: RigidTransform, errors: DepthErrorConfig) -> FloatArray:
        """Return the covariance of (dp, dtheta) in the sensor's fixed axes (ICD section 1), shape (6, 6).

        It is the inverse information, with at most ``effective_points`` residuals counted, plus the errors
        that all pixels share, since these do not average out.
        """
        variance_m2 = max(self.cost_m2, errors.noise_m**2)
        counted = min(1.0, errors.effective_points / self.inliers)
        spread = np.linalg.inv(self.information * counted / variance_m2)
        to_sensor = np.kron(np.eye(2), T_sensor_target.rotation.as_matrix())
        covariance: FloatArray = to_sensor @ spread @ to_sensor.T
        sight = T_sensor_target.translation / np.linalg.norm(T_sensor_target.translation)
        covariance[:3, :3] += errors.bias_m**2 * np.outer(sight, sight)
        covariance[3:, 3:] += errors.bias_rad**2 * np.eye(3)
        return covariance


@kernel
def no_sums() -> FloatArray:
    """Return the sums over no residual, shape (35,)."""
    return np.zeros(SUMS)


@inner_kernel
def add_residual(sums: FloatArray, normal: Vector, place: Vector, residual: float, weight: float) -> None:
    """Add a residual along a normal at a place to the sums, shape (35,); its row is derived above.

    Args:
        sums: information and gradient, input and output.
        normal: direction of the residual, target axes, in its unit per metre.
        place: position of the measured point, target axes, m.
        residual: value of the residual in its unit (m or px).
        weight: weight of the squared residual.
    """
    n0, n1, n2 = normal.x, normal.y, normal.z
    x, y, z = place.x, place.y, place.z
    j0, j1, j2 = -n0, -n1, -n2
    j3, j4, j5 = n1 * z - n2 * y, n2 * x - n0 * z, n0 * y - n1 * x
    w0, w1, w2, w3, w4, w5 = weight * j0, weight * j1, weight * j2, weight * j3, weight * j4, weight * j5
    sums[0] += w0 * j0
    sums[1] += w0 * j1
    sums[2] += w0 * j2
    sums[3] += w0 * j3
    sums[4] += w0 * j4
    sums[5] += w0 * j5
    sums[6] += w0 * residual
    sums[7] += w1 * j1
    sums[8] += w1 * j2
    sums[9] += w1 * j3
    sums[10] += w1 * j4
    sums[11] += w1 * j5
    sums[12] += w1 * residual
    sums[13] += w2 * j2
    sums[14] += w2 * j3
    sums[15] += w2 * j4
    sums[16] += w2 * j5
    sums[17] += w2 * residual
    sums[18] += w3 * j3
    sums[19] += w3 * j4
    sums[20] += w3 * j5
    sums[21] += w3 * residual
    sums[22] += w4 * j4
    sums[23] += w4 * j5
    sums[24] += w4 * residual
    sums[25] += w5 * j5
    sums[26] += w5 * residual


@inner_kernel
def add_range_bias(  # noqa: PLR0917
    sums: FloatArray, normal: Vector, place: Vector, slope: float, residual: float, weight: float
) -> None:
    """Add a residual's entries for the seventh unknown to the sums, in addition to ``add_residual``.

    Args:
        sums: information and gradient, shape (35,), in and out.
        normal: as for ``add_residual``.
        place: as for ``add_residual``.
        slope: derivative of the residual with respect to the length by which all ranges are too long.
        residual: as for ``add_residual``.
        weight: as for ``add_residual``.
    """
    n0, n1, n2 = normal.x, normal.y, normal.z
    x, y, z = place.x, place.y, place.z
    w6 = weight * slope
    sums[27] -= w6 * n0
    sums[28] -= w6 * n1
    sums[29] -= w6 * n2
    sums[30] += w6 * (n1 * z - n2 * y)
    sums[31] += w6 * (n2 * x - n0 * z)
    sums[32] += w6 * (n0 * y - n1 * x)
    sums[33] += w6 * slope
    sums[34] += w6 * residual


@kernel
def information_of(sums: FloatArray, unknowns: int) -> FloatArray:
    """Return the symmetric information matrix of the first 6 or 7 unknowns, from sums of shape (35,)."""
    information, entry = np.empty((unknowns, unknowns)), 0
    for i in range(6):
        for j in range(i, 6):
            information[i, j] = information[j, i] = sums[entry]
            entry += 1
        entry += 1  # of the gradient
    if unknowns == UNKNOWNS:
        for i in range(UNKNOWNS):
            information[i, 6] = information[6, i] = sums[OF_POSE + i]
    return information


@kernel
def gradient_of(sums: FloatArray, unknowns: int) -> FloatArray:
    """Return the gradient with respect to the first 6 or 7 unknowns, from sums of shape (35,)."""
    gradient, entry = np.empty(unknowns), -1
    for i in range(6):
        entry += UNKNOWNS - i
        gradient[i] = sums[entry]
    if unknowns == UNKNOWNS:
        gradient[6] = sums[SUMS - 1]
    return gradient


@inner_kernel
def held_step(sums: FloatArray, hold: FloatArray) -> FloatArray:
    """Return the Gauss-Newton step, shape (7,), for sums of shape (35,); 0 if it is not determined.

    The system is solved by Cholesky's decomposition. Sums that are not finite, or not positive definite to
    machine precision, give a step of 0; nothing is raised.

    Args:
        sums: information and gradient.
        hold: prior information that the step is zero, above 0, added to the diagonal, shape (7,), so that
            unknowns that the residuals do not determine do not change.
    """
    L, step = information_of(sums, UNKNOWNS), -gradient_of(sums, UNKNOWNS)
    for j in range(UNKNOWNS):
        whole = L[j, j] + hold[j]
        pivot = whole
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if not LEAST_PIVOT * whole < pivot < np.inf:
            return np.zeros(UNKNOWNS)
        L[j, j] = np.sqrt(pivot)
        for i in range(j + 1, UNKNOWNS):
            for k in range(j):
                L[i, j] -= L[i, k] * L[j, k]
            L[i, j] /= L[j, j]
    for i in range(UNKNOWNS):  # L y = -gradient, then L^T step = y
        for k in range(i):
            step[i] -= L[i, k] * step[k]
        step[i] /= L[i, i]
    for i in range(UNKNOWNS - 1, -1, -1):
        for k in range(i + 1, UNKNOWNS):
            step[i] -= L[k, i] * step[k]
        step[i] /= L[i, i]
    return step


@inner_kernel
def geman_mcclure(square: float, scale2: float) -> float:
    """Return the weight of a squared residual by Geman and McClure, (c^2 / (c^2 + r^2))^2.

    Source: S. Geman, D. McClure, Statistical Methods for Tomographic Image Reconstruction, Bulletin of the
    ISI 52, 1987; as the weight of iteratively reweighted least squares of the loss c^2 r^2 / (c^2 + r^2) / 2.

    Args:
        square: r^2.
        scale2: c^2, in the same unit, above 0.
    """
    share = scale2 / (scale2 + square)
    return share * share
