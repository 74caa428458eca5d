"""Poses and their steps: right perturbations (dtau, dtheta), in Python and for compiled code."""

from typing import NamedTuple, Self

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_schemas.arrays import FloatArray


class PoseArrays(NamedTuple):
    """A pose of the target relative to the sensor, in the form that the kernels take."""

    R: FloatArray
    """R_sensor_target, shape (3, 3)."""
    t: FloatArray
    """Position of the target's origin, sensor axes, shape (3,), m."""

    @classmethod
    def of(cls, T_sensor_target: RigidTransform) -> Self:
        """Return the arrays of a pose, contiguous copies."""
        matrix = T_sensor_target.as_matrix()
        return cls(matrix[:3, :3].copy(), matrix[:3, 3].copy())


class Vector(NamedTuple):
    """Three components of a vector; the axes are those that the function names."""

    x: float
    y: float
    z: float


@kernel
def turned(R: FloatArray, rotation_vector: FloatArray) -> FloatArray:
    """Return R Exp(rotation_vector), shape (3, 3), for a rotation vector, shape (3,), rad.

    Rodrigues' formula, since SciPy's rotations do not compile: with K the cross-product matrix of the vector
    and a its length, Exp = I + sin(a) / a K + (1 - cos(a)) / a^2 K^2.
    """
    angle = np.sqrt((rotation_vector**2).sum())
    a, b = 1.0, 0.5
    if angle > 1e-6:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    x, y, z = rotation_vector
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned_R: FloatArray = R @ (np.eye(3) + a * K + b * (K @ K))
    return turned_R


@inner_kernel
def in_target(R: FloatArray, x: float, y: float, z: float) -> Vector:
    """Return R^T (x, y, z): a vector in sensor axes, turned into target axes by R_sensor_target, (3, 3)."""
    return Vector(
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@inner_kernel
def in_sensor(R: FloatArray, x: float, y: float, z: float) -> Vector:
    """Return R (x, y, z): a vector in target axes, turned into sensor axes by R_sensor_target, (3, 3)."""
    return Vector(
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@kernel
def stepped(pose: PoseArrays, step: FloatArray) -> PoseArrays:
    """Return the pose after a step (dtau, dtheta), shape (6,), m and rad: R Exp(dtheta), t + R dtau."""
    return PoseArrays(turned(pose.R, step[3:6]), pose.t + pose.R @ step[:3])


def moved(T_sensor_target: RigidTransform, step: FloatArray) -> RigidTransform:
    """Return the pose after a step (dtau, dtheta), shape (6,), m and rad."""
    return T_sensor_target * RigidTransform.from_components(step[:3], Rotation.from_rotvec(step[3:]))


def step_between(T_from: RigidTransform, T_to: RigidTransform) -> FloatArray:
    """Return the step (dtau, dtheta), shape (6,), from one pose to another: the inverse of ``moved``."""
    step = T_from.inv() * T_to
    return np.concatenate((step.translation, step.rotation.as_rotvec()))


def step_length_m(step: FloatArray, radius_m: float) -> float:
    """Return an upper bound, m, of the motion of a target's surface in a step (dtau, dtheta), shape (6,)."""
    return float(np.linalg.norm(step[:3]) + radius_m * np.linalg.norm(step[3:]))
