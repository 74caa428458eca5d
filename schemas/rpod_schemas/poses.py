"""Poses: scipy's ``RigidTransform``, with the few conventions that the ICD adds.

``T_A_B`` maps coordinates in B into A. Angles are radians, lengths metres.
"""

import math
import reprlib
from typing import Annotated, Any

import numpy as np
from pydantic import PlainSerializer, PlainValidator
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.arrays import FloatArray


def make_pose(*, rotation: Rotation | None = None, translation_m: Any = (0.0, 0.0, 0.0)) -> RigidTransform:
    """Return the pose of a rotation and a translation, shape (3,)."""
    return pose_of(np.eye(3) if rotation is None else rotation.as_matrix(), np.asarray(translation_m, float))


def pose_of(R: FloatArray, t: FloatArray) -> RigidTransform:
    """Return the pose of a rotation matrix, shape (3, 3), and a translation, shape (3,), as they are."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3], matrix[3, 3] = R, t, 1.0
    return RigidTransform(matrix, normalize=False, copy=False)


def rotation_matrix(pose: RigidTransform) -> FloatArray:
    """Return a pose's rotation matrix, shape (3, 3)."""
    return pose.as_matrix()[:3, :3]


def rotation_of(pose: RigidTransform) -> Rotation:
    """Return a pose's rotation, unchecked; ``pose.rotation`` checks it, which takes six times as long."""
    return Rotation.from_matrix(rotation_matrix(pose), assume_valid=True)


def chained(T_A_B: RigidTransform, T_B_C: RigidTransform) -> RigidTransform:
    """Return T_A_C, not normalised; the operator normalises it, which takes five times as long."""
    return RigidTransform(T_A_B.as_matrix() @ T_B_C.as_matrix(), normalize=False)


def pose_error(T_truth: RigidTransform, T_estimate: RigidTransform) -> tuple[FloatArray, FloatArray]:
    """Return attitude error Log(R_truth^T R_estimate), rad, target axes, and position error, m, parent axes.

    Source: ICD section 1.
    """
    attitude_rad = (T_truth.rotation.inv() * T_estimate.rotation).as_rotvec()
    return attitude_rad, T_estimate.translation - T_truth.translation


def covariance_at(covariance: FloatArray, arm_m: FloatArray) -> FloatArray:
    """Return the covariance of (dp, dtheta), shape (6, 6), at a place that is fixed to the body.

    A turn dtheta moves the place by dtheta x arm.

    Args:
        covariance: covariance at the body's origin, in fixed axes (ICD section 1).
        arm_m: vector from the origin to the place, in the same axes, shape (3,), m.
    """
    carried = np.eye(6)
    carried[:3, 3:] = np.cross(np.eye(3), arm_m).T
    at_place: FloatArray = carried @ covariance @ carried.T
    return 0.5 * (at_place + at_place.T)


def between(first: RigidTransform, second: RigidTransform, share: float) -> RigidTransform:
    """Return the pose at a share of the way: linear in position, on the shortest arc in attitude."""
    way = matrices_between(first.as_matrix()[None], second.as_matrix()[None], np.array([share]))
    return RigidTransform(way[0], normalize=False, copy=False)


def matrices_between(first: FloatArray, second: FloatArray, shares: FloatArray) -> FloatArray:
    """Return the matrices of many poses at shares of their ways, like ``between``, shape (N, 4, 4).

    Args:
        first: matrices of the first poses, shape (N, 4, 4).
        second: those of the second ones, same shape.
        shares: shape (N,).
    """
    R, share = first[:, :3, :3], shares[:, None]
    relative = R.transpose(0, 2, 1) @ second[:, :3, :3]
    turn = share * Rotation.from_matrix(relative, assume_valid=True).as_rotvec()
    return matrices_of(
        R @ Rotation.from_rotvec(turn).as_matrix(), (1.0 - share) * first[:, :3, 3] + share * second[:, :3, 3]
    )


def matrices_of(R: FloatArray, t_m: FloatArray) -> FloatArray:
    """Return the matrices of poses, shape (N, 4, 4), of rotation matrices (N, 3, 3) and places (N, 3)."""
    matrices = np.zeros((len(t_m), 4, 4))
    matrices[:, :3, :3], matrices[:, :3, 3], matrices[:, 3, 3] = R, t_m, 1.0
    return matrices


_OF_A_POSE = ("translation_m", "quaternion_xyzw", "euler_321_deg")
"""Fields of a pose in a file."""


def _checked_pose(value: Any) -> RigidTransform:
    if isinstance(value, RigidTransform):
        return value
    needs = "needs translation_m, and quaternion_xyzw or euler_321_deg (yaw, pitch, roll)"
    if not isinstance(value, dict):
        raise ValueError(f"is {reprlib.repr(value)}; it {needs}")
    if unknown := [name for name in value if name not in _OF_A_POSE]:
        raise ValueError(f"has the unknown field {unknown[0]!r}; it {needs}")
    if "quaternion_xyzw" in value and "euler_321_deg" in value:
        raise ValueError("has both quaternion_xyzw and euler_321_deg; give one")
    translation = _numbers(value.get("translation_m", (0.0, 0.0, 0.0)), 3, "translation_m")
    return RigidTransform.from_components(translation, _checked_rotation(value))


def _numbers(value: Any, count: int, name: str, meaning: str = "") -> FloatArray:
    """Return an array of so many finite numbers. Raises ``ValueError``, which names the field."""
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(f"{name} is {str(value)[:60]}; it needs {count} finite numbers{meaning}")
    return array


def _checked_rotation(value: dict[str, Any]) -> Rotation:
    if "euler_321_deg" in value:
        angles = _numbers(value["euler_321_deg"], 3, "euler_321_deg", ": yaw, pitch, roll")
        return Rotation.from_euler("ZYX", angles, degrees=True)
    quaternion = _numbers(value.get("quaternion_xyzw", (0.0, 0.0, 0.0, 1.0)), 4, "quaternion_xyzw")
    norm = math.hypot(*quaternion)  # of numbers beyond 1e154, too
    if not abs(norm - 1.0) < 1e-3:
        raise ValueError(
            f"quaternion_xyzw has the norm {norm:g}; it needs 1: x, y, z, w of a unit quaternion"
        )
    return Rotation.from_quat(quaternion)


def _checked_attitude(value: Any) -> Rotation:
    if isinstance(value, Rotation):
        return value
    if not isinstance(value, dict) or set(value) not in ({"quaternion_xyzw"}, {"euler_321_deg"}):
        raise ValueError("needs quaternion_xyzw, or euler_321_deg (yaw, pitch, roll)")
    return _checked_rotation(value)


def _plain_attitude(rotation: Rotation) -> dict[str, list[float]]:
    return {"quaternion_xyzw": rotation.as_quat().tolist()}


def _plain_pose(pose: RigidTransform) -> dict[str, list[float]]:
    return {"translation_m": pose.translation.tolist(), "quaternion_xyzw": pose.rotation.as_quat().tolist()}


Pose = Annotated[
    RigidTransform,
    PlainValidator(_checked_pose),
    PlainSerializer(_plain_pose, return_type=dict[str, list[float]]),
]
"""A pose in a model: a transform, or ``{translation_m, quaternion_xyzw | euler_321_deg}``."""

Attitude = Annotated[
    Rotation,
    PlainValidator(_checked_attitude),
    PlainSerializer(_plain_attitude, return_type=dict[str, list[float]]),
]
"""An attitude in a model: a rotation, or ``{quaternion_xyzw | euler_321_deg}``."""
