"""Poses and their steps: right perturbations (dtau, dtheta), in Python and for compiled code."""

import numpy as np
from numba import njit
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.arrays import FloatArray


@njit(cache=True, nogil=True)
def turned(R, rotation_vector):  # type: ignore[no-untyped-def]
    """Return R Exp(rotation_vector): Rodrigues' formula, since scipy's rotations do not compile."""
    angle = np.sqrt((rotation_vector**2).sum())
    a, b = 1.0, 0.5
    if angle > 1e-6:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    x, y, z = rotation_vector
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return R @ (np.eye(3) + a * K + b * (K @ K))


@njit(cache=True, nogil=True)
def in_target(R, x, y, z):  # type: ignore[no-untyped-def]
    """Return R^T (x, y, z)."""
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


def moved(T_sensor_target: RigidTransform, step: FloatArray) -> RigidTransform:
    """Return the pose after a step (dtau, dtheta)."""
    return T_sensor_target * RigidTransform.from_components(step[:3], Rotation.from_rotvec(step[3:]))


def step_between(T_from: RigidTransform, T_to: RigidTransform) -> FloatArray:
    """Return the step (dtau, dtheta) from one pose to another, the inverse of ``moved``."""
    step = T_from.inv() * T_to
    return np.concatenate((step.translation, step.rotation.as_rotvec()))


def step_length_m(step: FloatArray, radius_m: float) -> float:
    """Return how far a step moves the surface of a target of this size."""
    return float(np.linalg.norm(step[:3]) + radius_m * np.linalg.norm(step[3:]))
