"""Lengths relative to a target: its longest side, limits of a right pose, and errors of a start."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import make_pose
from rpod_target import Target


@dataclass(frozen=True)
class Limits:
    """Largest errors of a right pose."""

    attitude_deg: float
    position_m: float

    def are_met(self, attitude_deg: float | None, position_m: float | None) -> bool:
        """Return whether both errors are below the limits; False without a pose."""
        if attitude_deg is None or position_m is None:
            return False
        return attitude_deg < self.attitude_deg and position_m < self.position_m


def in_metres(lengths: Sequence[float | str], target: Target) -> tuple[float, ...]:
    """Return lengths in m; those in the form ``5x`` are multiples of the target's longest side."""
    size_m = longest_side_m(target)
    return tuple(
        float(length[:-1]) * size_m if isinstance(length, str) else float(length) for length in lengths
    )


def longest_side_m(target: Target) -> float:
    """Return the longest side of the target's bounding box, m."""
    return float(np.ptp(target.triangles_m, axis=(0, 1)).max())


def middle_m(target: Target) -> FloatArray:
    """Return the middle of the target's bounding box, target axes, shape (3,)."""
    corners_m = target.triangles_m.reshape(-1, 3)
    middle: FloatArray = (corners_m.min(axis=0) + corners_m.max(axis=0)) / 2.0
    return middle


def with_middle_at(R_sensor_target: Rotation, place_m: FloatArray, target: Target) -> RigidTransform:
    """Return T_sensor_target with the middle of the target's bounding box at a place, shape (3,), m."""
    return make_pose(
        rotation=R_sensor_target, translation_m=place_m - R_sensor_target.apply(middle_m(target))
    )


def displaced(
    truth: RigidTransform, generator: Generator, *, angle_deg: float, distance_m: float, target: Target
) -> RigidTransform:
    """Return a pose turned about the target's middle by an angle and moved, both in random directions."""
    axis, way = (vector / np.linalg.norm(vector) for vector in generator.standard_normal((2, 3)))
    R_sensor_target = Rotation.from_rotvec(np.deg2rad(angle_deg) * axis) * truth.rotation
    return with_middle_at(R_sensor_target, truth.apply(middle_m(target)) + distance_m * way, target)
