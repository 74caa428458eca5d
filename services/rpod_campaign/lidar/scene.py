"""Targets at random attitudes, and scans of them."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.engine.trial.targets import cached_target
from rpod_pose.registration.closest_point import Surface
from rpod_schemas.config.emulator import WorldName
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.surroundings import Thing
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.worlds import world_of

CLEARANCE_M = 2.0
"""Least distance of the target's surface from the sensor, m; a nearer random pose is discarded."""


class Drawn(NamedTuple):
    """A random pose."""

    T_sensor_target: RigidTransform
    discarded: int
    """Number of random poses that were discarded before it because they were too near."""


@lru_cache(maxsize=8)
def _surface(name: str) -> Surface:
    target = cached_target(name)
    return Surface.of(target.triangles_m, target.normals)


def random_attitude(sampling: str, generator: Generator) -> Rotation:
    """Return R_sensor_target: uniform on SO(3), or yaw, pitch and roll (321) each uniform in its range.

    The latter is the 2015 paper's, section 4.3; it has more attitudes near the poles of the pitch.
    """
    if sampling == "so3":
        return Rotation.random(rng=generator)
    bounds_deg = np.array((180.0, 90.0, 180.0))
    return Rotation.from_euler("ZYX", generator.uniform(-bounds_deg, bounds_deg), degrees=True)


def random_pose(target: str, *, range_m: float, sampling: str, seed: int, trial: int) -> Drawn:
    """Return a random attitude at (0, 0, range) whose surface is not nearer than the clearance."""
    generator, discarded = stream(seed, trial), 0
    while True:
        pose = make_pose(rotation=random_attitude(sampling, generator), translation_m=(0.0, 0.0, range_m))
        if clearance_m(target, pose) >= min(CLEARANCE_M, 0.5 * range_m):
            return Drawn(pose, discarded)
        discarded += 1


def clearance_m(target: str, T_sensor_target: RigidTransform) -> float:
    """Return the distance from the sensor to the target's surface, m."""
    surface = _surface(target)
    sensor_m = T_sensor_target.inv().translation[None]
    every = np.ones(len(surface.triangles_m), np.bool_)
    closest_m = surface.closest(sensor_m, every, np.zeros(1, np.int32))
    return float(np.linalg.norm(closest_m - sensor_m))


def emulator_of(
    target: str,
    config: LidarConfig,
    seed: int,
    *,
    world: WorldName = "documented",
    scale: float = 1.0,
    things: Sequence[Thing] = (),
) -> LidarEmulator:
    """Return the emulated LIDAR of a world; it sees the target, scaled over its model, and other things."""
    looked_at = cached_target(target)
    if scale != 1.0:
        looked_at = replace(looked_at, triangles_m=scale * looked_at.triangles_m)
    return LidarEmulator(config, looked_at, seed=seed, world=world_of(world), surroundings=things)


def scan_of(
    emulator: LidarEmulator, T_sensor_target: RigidTransform, *, trial: int, stamp_ns: int = 0
) -> LidarScan:
    """Return the scan of a motionless target; the number of trial or frame determines its noise."""
    returns = emulator.scan([T_sensor_target], frame=trial)
    return LidarScan(
        stamp_ns=stamp_ns, frame_id="lidar", points_m=returns.points_m, intensity=returns.intensity
    )
