"""The Gauss-Newton step that all depth methods share, and what it says of its own accuracy.

The unknowns are a right perturbation R <- R Exp(dtheta), t <- t + R dtau in target axes, ordered
(dtau, dtheta). A residual r with the row J adds w J^T J to the information and w J^T r to the gradient.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numba import njit
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_methods import DepthErrorConfig

DAMPING = 1e-6
"""Information added a residual, so that an unobservable direction stays where it is."""
DEGENERATE = 1e-4
"""Least information of the worst direction, as a share of what one fully determined by every residual has."""


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
    """Residuals within the Geman-McClure scale."""

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
        """Mean squared residual of the inliers, NaN where there is none."""
        return self.squares_m2 / self.inliers if self.inliers else float("nan")

    def step(self) -> FloatArray:
        """Return (dtau, dtheta), shape (6,)."""
        step: FloatArray = solve(self.information, self.gradient, self.weight)
        return step

    def degenerate(self, radius_m: float) -> bool:
        """Return whether some motion of a target of this size is left undetermined."""
        if not self.inliers:
            return True
        scale = np.repeat((1.0, 1.0 / radius_m), 3)
        scaled = self.information * np.outer(scale, scale) / self.weight
        return bool(np.linalg.eigvalsh(scaled)[0] < DEGENERATE)

    def covariance(self, T_sensor_target: RigidTransform, errors: DepthErrorConfig) -> FloatArray:
        """Return the covariance of (dp, dtheta) in the sensor's fixed axes (ICD section 1), shape (6, 6).

        The inverse information, with at most ``effective_points`` residuals counted, plus the errors that all
        pixels share: they do not average out.
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


@njit(cache=True, nogil=True)
def solve(information, gradient, weight):  # type: ignore[no-untyped-def]
    """Return the damped Gauss-Newton step."""
    return np.linalg.solve(information + (DAMPING * weight + 1e-12) * np.eye(6), -gradient)


@njit(cache=True, nogil=True)
def add_residual(information, gradient, row, residual, weight):  # type: ignore[no-untyped-def]
    """Add one residual and its derivatives, shape (6,), to the sums."""
    for i in range(6):
        gradient[i] += weight * row[i] * residual
        for j in range(6):
            information[i, j] += weight * row[i] * row[j]
