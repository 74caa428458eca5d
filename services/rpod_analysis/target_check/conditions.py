"""Poses at which a check tries methods: random attitudes, at ranges that follow from what a sensor resolves.

The range is such that a camera's image is filled to a share, or that a scan has a number of returns. So the
same conditions hold for a satellite of 0.2 m and for one of 60 m.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.target_check.emulated import EmulatedKind
from rpod_geometry.wireframe import project
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_target import Target

FILLED = (0.2, 0.4, 0.8)
"""Longest side of the target in the image over the image's height."""
RETURNS = (30, 120, 500)
"""Number of returns of a scan without noise."""
_NEAREST, _FARTHEST = 1.5, 1000.0
"""Least and greatest range, over the radius of the target."""
_REACH = 0.93
"""Share of a camera's unambiguous range within which the target is placed, as in the campaigns."""
_HALVINGS = 14
_SUN_W_m2 = 1361.0
_OFF_DEG, _OFF = 3.0, 0.02
"""Error of a tracker's predicted pose: angle, deg, and distance over the longest side."""


@dataclass(frozen=True)
class Condition:
    """A pose of the target, the sun, and a prediction for trackers."""

    name: str
    """Condition that determines the range: "30 returns", "20 % filled"."""
    T_sensor_target: RigidTransform
    sun_W_m2: FloatArray
    """Unit vector to the sun times its irradiance, sensor axes, shape (3,); the sun is behind the sensor."""
    predicted: RigidTransform
    """T_sensor_target with an error of 3 deg and 2 % of the longest side."""


def conditions(emulated: EmulatedKind, target: Target, count: int, *, seed: int) -> Iterator[Condition]:
    """Yield conditions, from far to near in turn; number and seed determine each.

    A camera measures no range beyond the one that is unambiguous: a target that would be farther away is
    placed there, and fills more of the image.
    """
    reach_m = _REACH * float(getattr(emulated.sensor, "unambiguous_range_m", np.inf))
    low_m, high_m = target.triangles_m.min(axis=(0, 1)), target.triangles_m.max(axis=(0, 1))
    middle_m, size_m = 0.5 * (low_m + high_m), float((high_m - low_m).max())
    names, larger = _sizes(emulated, target)
    for number in range(count):
        generator = np.random.default_rng((seed, number))
        attitude = Rotation.random(rng=generator)
        which = number % len(names)
        pose = _placed(attitude, middle_m, partial(larger, which), target.radius_m, reach_m)
        axis, way, sun = (_direction(generator) for _ in range(3))
        sun[2] = -abs(sun[2])
        predicted = make_pose(
            rotation=Rotation.from_rotvec(np.radians(_OFF_DEG) * axis) * pose.rotation,
            translation_m=pose.translation + _OFF * size_m * way,
        )
        yield Condition(names[which], pose, _SUN_W_m2 * sun, predicted)


def _sizes(emulated: EmulatedKind, target: Target) -> tuple[list[str], Callable[[int, RigidTransform], bool]]:
    """Return the names of the conditions, and whether the target looks larger at a pose than they require."""
    ideal = emulated.ideal(make_pose(translation_m=[0.0, 0.0, 3.0 * target.radius_m + 1.0]))
    lens, corners_m = ideal.lens, target.triangles_m.reshape(-1, 3)
    if lens is not None:
        return (
            [f"{share:.0%} filled" for share in FILLED],
            lambda which, pose: _filled(corners_m, pose, lens) > FILLED[which],
        )
    return (
        [f"{returns} returns" for returns in RETURNS],
        lambda which, pose: len(emulated.ideal(pose).returns_m) > RETURNS[which],
    )


def _filled(corners_m: FloatArray, pose: RigidTransform, lens: Camera) -> float:
    """Return the longest side of the corners' image over the height of the sensor's image."""
    at_m = pose.apply(corners_m)
    if at_m[:, 2].min() <= 0.0:
        return np.inf
    straight = lens.model_copy(update={"distortion": np.zeros(5)})  # a polynomial means nothing outside
    return float(np.ptp(project(at_m, straight), axis=0).max()) / lens.height


def _placed(
    attitude: Rotation,
    middle_m: FloatArray,
    larger: Callable[[RigidTransform], bool],
    radius_m: float,
    reach_m: float,
) -> RigidTransform:
    """Return T_sensor_target with a place of the target on the boresight, where it looks as large as wanted.

    If it never looks so large, the range is the least one allowed; it is never beyond the reach.
    """

    def at(range_m: float) -> RigidTransform:
        translation_m = np.array([0.0, 0.0, range_m]) - attitude.apply(middle_m)
        return make_pose(rotation=attitude, translation_m=translation_m)

    low_m = _NEAREST * radius_m
    high_m = max(min(_FARTHEST * radius_m, reach_m), low_m)
    for _ in range(_HALVINGS):
        range_m = float(np.sqrt(low_m * high_m))
        low_m, high_m = (range_m, high_m) if larger(at(range_m)) else (low_m, range_m)
    return at(low_m)


def _direction(generator: np.random.Generator) -> FloatArray:
    vector = generator.standard_normal(3)
    unit: FloatArray = vector / np.linalg.norm(vector)
    return unit
