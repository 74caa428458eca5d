"""Frames of a target of any size that fills a share of the image, in any light."""

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.sizes import longest_side_m, with_middle_at
from rpod_campaign.pmd.scene import camera_of
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.base import check
from rpod_schemas.config.motion import SunConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.scenario import Scenario
from rpod_schemas.types import Camera
from rpod_target import Target

FILLED = (0.2, 0.8)
"""Least and greatest longest projected side over the image's height, where none is chosen; uniform."""
LEAST_PIXELS = 200
"""Number of the target's pixels with depth, below which a frame is counted apart."""
_REACH = 0.93
"""Share of the unambiguous range in which a target is placed."""
_ASIDE = 0.1
"""Largest random offset of the target's middle along each image axis, over its longest side."""
_ROUNDS = 4
"""Number of corrections of a range for perspective."""


def lit(scenario: Scenario, generator: Generator) -> Scenario:
    """Return a scenario with the sun in any direction."""
    direction = generator.standard_normal(3)
    light = SunConfig(direction=direction / np.linalg.norm(direction))
    return scenario.model_copy(update={"motion": scenario.motion.model_copy(update={"sun": light})})


def reaching(scenario: Scenario, farthest_m: float) -> Scenario:
    """Return a scenario whose camera measures with two frequencies if one is ambiguous at a range, m."""
    fast = camera_of(scenario).model_copy(update={"profile": "fast"})
    profile = "fast" if farthest_m < _REACH * fast.unambiguous_range_m else "dual"
    document = scenario.model_dump(mode="json")
    for sensor in document["sensors"]:
        if sensor["kind"] == "pmd":
            sensor |= {"profile": profile, "rate_hz": 15.0}
    return check(Scenario, document, source=scenario.name)


def ranges_filling(target: Target, camera: PmdConfig) -> tuple[float, float]:
    """Return the ranges at which a target fills most and least of the image, m.

    Both are unambiguous with two frequencies; a target that is too large for that fills more of the image.
    """
    reach_m = _REACH * camera.model_copy(update={"profile": "dual"}).unambiguous_range_m
    least, most = FILLED
    far_m = min(range_filling(target, least, camera), reach_m)
    return min(range_filling(target, most, camera), 0.6 * far_m), far_m


def range_filling(target: Target, filled: float, camera: PmdConfig) -> float:
    """Return the range at which the target's longest side fills a share of the image's height, m."""
    return _range_m(longest_side_m(target), filled, camera.camera)


def framed(
    target: Target, camera: PmdConfig, *, filled: tuple[float, float], generator: Generator
) -> RigidTransform:
    """Return T_sensor_target at a random attitude.

    The range is that at which the target fills a random share of the image. It is shorter if this would be
    beyond the unambiguous range of the camera.
    """
    attitude = Rotation.random(rng=generator)
    share, aside = generator.uniform(*filled), generator.uniform(-_ASIDE, _ASIDE, 2)
    size_m, model = longest_side_m(target), camera.camera
    range_m, farthest_m = _range_m(size_m, share, model), _REACH * camera.unambiguous_range_m
    for _ in range(_ROUNDS):
        place_m = np.array((*(aside * size_m), min(range_m, farthest_m)))
        pose = with_middle_at(attitude, place_m, target)
        range_m = max(range_m * filled_share(pose, target, model) / share, size_m)
    return with_middle_at(attitude, np.array((*(aside * size_m), min(range_m, farthest_m))), target)


def filled_share(T_sensor_target: RigidTransform, target: Target, camera: Camera) -> float:
    """Return the longest side of the target's bounding box in the image, over the image's height."""
    corners_m: FloatArray = T_sensor_target.apply(target.triangles_m.reshape(-1, 3))
    in_front_m = corners_m[:, 2].clip(0.05 * longest_side_m(target), None)
    sides_px = (
        np.ptp(camera.fx * corners_m[:, 0] / in_front_m),
        np.ptp(camera.fy * corners_m[:, 1] / in_front_m),
    )
    return float(max(sides_px)) / camera.height


def _range_m(size_m: float, filled: float, camera: Camera) -> float:
    return camera.fy * size_m / (filled * camera.height)
