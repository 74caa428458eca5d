"""Random poses in front of a camera, and the limits of a right estimate."""

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.sizes import Limits, longest_side_m
from rpod_schemas.poses import make_pose
from rpod_target import Target, is_shipped

SUCCESS_DEG, SUCCESS_M, SUCCESS_SHARE = 4.0, 0.08, 0.04
"""Largest errors of a success: attitude, deg, and position: m for a shipped target, over the longest side for
another one."""
_MOCKUP_M = 1.2
"""Longest side of the mock-up, m."""
FRONT_DEG = 45.0
"""Half angle of the cone about the target's x axis from which its front is seen, deg."""
_ASIDE_M = 0.1
"""Largest random offset of the mock-up's middle from the boresight, along each image axis, m."""


def limits_of(target: Target) -> Limits:
    """Return the largest errors of a success."""
    size_m = longest_side_m(target)
    return Limits(SUCCESS_DEG, SUCCESS_M if is_shipped(target) else SUCCESS_SHARE * size_m)


def in_proportion(length_m: float, target: Target) -> float:
    """Return a length that fits the mock-up, m, in proportion to the size of a target that is not shipped."""
    return length_m if is_shipped(target) else length_m * longest_side_m(target) / _MOCKUP_M


def drawn(target: Target, view: str, range_m: tuple[float, float], generator: Generator) -> RigidTransform:
    """Return a random T_sensor_target with the middle of the target in view."""
    R_sensor_target = _front(generator) if view == "front" else Rotation.random(rng=generator)
    corners_m = target.triangles_m.reshape(-1, 3)
    middle_m = (corners_m.min(axis=0) + corners_m.max(axis=0)) / 2.0
    most_m = in_proportion(_ASIDE_M, target)
    aside_m = generator.uniform(-most_m, most_m, 2)
    place_m = np.array((*aside_m, generator.uniform(*range_m)))
    return make_pose(rotation=R_sensor_target, translation_m=place_m - R_sensor_target.apply(middle_m))


def _front(generator: Generator) -> Rotation:
    """Return an attitude of any roll with the x axis to the camera within FRONT_DEG, uniform on that cap."""
    z = generator.uniform(np.cos(np.deg2rad(FRONT_DEG)), 1.0)
    azimuth, roll = generator.uniform(0.0, 2.0 * np.pi, 2)
    tilt = Rotation.from_rotvec(np.arccos(z) * np.array((np.cos(azimuth), np.sin(azimuth), 0.0)))
    facing = Rotation.from_euler("y", 90.0, degrees=True)  # x to -z, at the camera
    return tilt * facing * Rotation.from_euler("x", roll)
