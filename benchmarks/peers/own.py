"""Our own methods, as the estimator builds them from its configuration."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from peers.benchmark import Register, Scene
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.methods import ready_methods
from rpod_pose.ports import Methods
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator import LidarInput
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarScan

FINISH: Mapping[str, Any] = {"tracking": {"kind": "icp_nearest_neighbour"}}
"""The ICP that refines every acquisition's pose."""


def acquisition(document: Mapping[str, Any], scene: Scene) -> Register[LidarScan]:
    """Return the acquisition of a LIDAR's configuration."""
    acquirer = _methods(document, scene).acquirer

    def register(scan: LidarScan, _: RigidTransform) -> RigidTransform | None:
        return acquirer.acquire(scan).pose

    return register


def tracking(document: Mapping[str, Any], scene: Scene) -> Register[LidarScan]:
    """Return the tracker of a LIDAR's configuration."""
    tracker = _methods(document, scene).tracker

    def register(scan: LidarScan, start: RigidTransform) -> RigidTransform | None:
        return tracker.track(scan, start).T_sensor_target

    return register


finish = partial(tracking, FINISH)


def from_centroid(_: Scene) -> Register[LidarScan]:
    """Return the centroid of the scan with the target's axes along the sensor's: ICP does the rest."""

    def register(scan: LidarScan, _: RigidTransform) -> RigidTransform | None:
        points_m = scan.returns_m
        return make_pose(translation_m=points_m.mean(axis=0, dtype=np.float64)) if len(points_m) else None

    return register


def _methods(document: Mapping[str, Any], scene: Scene) -> Methods:
    pattern = ScanPattern(scene.lidar.azimuth_rad, scene.lidar.elevation_rad)
    return ready_methods(check(LidarInput, document, source="peers"), scene.target, pattern)
