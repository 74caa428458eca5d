"""Expected accuracy of a pose from one frame, by range: the information that the surface gives a sensor.

A point with the normal n at the place p, measured with the standard deviation s along its ray, gives the
information J^T J / (s cos)^2 with J = (n, p x n) about the translation and the rotation of the target. The
sum over a frame's points, inverted, is the smallest covariance of any method without prior knowledge (Cramér
and Rao). It does not contain bias, outliers and errors of the model. The frames are those of the emulators
with their default configuration, so it contains the effects of detection, exposure and materials.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.poses import make_pose
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import Equivalence, Target

_ATTITUDES = 8
_SHARES = (1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0)
"""Ranges that are examined, over the target's radius."""
_FEWEST = 6
"""Least number of points that can fix a pose."""
_STEEPEST = 0.1
"""Least cosine of incidence in the error along the normal."""
_UNSEEN = 1e-9
"""Share of the largest information below which a motion is not measured."""


@dataclass(frozen=True)
class RangeAccuracy:
    """Accuracy of one frame of a sensor at one range; medians over attitudes."""

    range_m: float
    points: int
    """Number of points on the target."""
    sigma_position_m: float | None
    """Standard deviation along the least known direction, m; None if it is not measured."""
    sigma_attitude_deg: float | None
    """Standard deviation about the least known axis but a free one, deg; None if it is not measured."""


@dataclass(frozen=True)
class SensorAccuracy:
    """Accuracy of a sensor's frames, by range."""

    sensor: str
    ranges: tuple[RangeAccuracy, ...]


Frame = tuple[FloatArray, FloatArray, FloatArray]
"""Places in sensor axes, (N, 3), m; normals, (N, 3); standard deviations along the rays, (N,), m."""


def expected_accuracy(target: Target) -> tuple[SensorAccuracy, ...]:
    """Return the expected accuracy of a pose from one frame of each sensor in its default configuration."""
    return (
        SensorAccuracy("lidar", _by_range(target, _lidar(target))),
        SensorAccuracy("pmd", _by_range(target, _pmd(target))),
    )


def _by_range(target: Target, look: Callable[[RigidTransform, int], Frame]) -> tuple[RangeAccuracy, ...]:
    attitudes = Rotation.random(_ATTITUDES, rng=np.random.default_rng(1))
    found = []
    for share in _SHARES:
        range_m = share * target.radius_m
        results = []
        for number, attitude in enumerate(attitudes):
            pose = make_pose(rotation=attitude, translation_m=[0.0, 0.0, range_m])
            results.append(_information(look(pose, number), pose, target.equivalence))
        points = int(np.median([result[0] for result in results]))
        if points < _FEWEST:
            break
        position, attitude_deg = (_median([result[column] for result in results]) for column in (1, 2))
        found.append(RangeAccuracy(range_m, points, position, attitude_deg))
    return tuple(found)


def _median(values: list[float]) -> float | None:
    middle = float(np.median(values))
    return middle if np.isfinite(middle) else None


def _information(frame: Frame, pose: RigidTransform, alike: Equivalence) -> tuple[int, float, float]:
    """Return the number of points, and the two largest standard deviations, m and deg; inf if unknown.

    The angle about a free axis does not count.
    """
    places_m, normals, sigma_m = frame
    if len(places_m) < _FEWEST:
        return len(places_m), np.inf, np.inf
    rays = places_m / np.linalg.norm(places_m, axis=1, keepdims=True)
    cosine = np.maximum(np.abs(np.einsum("ij,ij->i", rays, normals)), _STEEPEST)
    lever_m = places_m - pose.translation
    size_m = float(np.linalg.norm(lever_m, axis=1).max())
    rows = np.hstack([normals, np.cross(lever_m / size_m, normals)]) / (sigma_m * cosine)[:, None]
    information = rows.T @ rows
    known = float(information.trace())
    information = alike.with_free_variance(information, pose.rotation.as_matrix(), known)
    values, vectors = np.linalg.eigh(information)
    unknown = values < _UNSEEN * values[-1]
    variance = 1.0 / np.where(unknown, np.inf, values)
    covariance = (vectors * variance) @ vectors.T
    position = np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    angle = np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]) / size_m)
    share = (vectors[:, unknown] ** 2).reshape(2, 3, -1).sum(axis=1)
    return (
        len(places_m),
        np.inf if (share[0] > 0.5).any() else float(position),
        np.inf if (share[1] > 0.5).any() else float(angle),
    )


def _met(grid: RayGrid, target: Target, pose: RigidTransform) -> tuple[FloatArray, FloatArray]:
    """Return the true range of each ray, inf without a hit, and the normals, sensor axes."""
    hits = cast(grid, target.triangles_m, pose, cull_back_faces=True)
    normals = pose.rotation.apply(target.normals)[np.maximum(hits.triangle, 0)]
    return hits.range_m.astype(np.float64), normals


def _lidar(target: Target) -> Callable[[RigidTransform, int], Frame]:
    config = LidarConfig()
    emulator = LidarEmulator(config, target, seed=1)
    grid = RayGrid.azimuth_elevation(config.azimuth_rad, config.elevation_rad)

    def look(pose: RigidTransform, frame: int) -> Frame:
        range_m, normals = _met(grid, target, pose)
        returned = np.isfinite(emulator.scan([pose], frame=frame).points_m[..., 0]) & np.isfinite(range_m)
        places_m = range_m[returned][:, None] * grid.directions[returned]
        return places_m, normals[returned], np.full(len(places_m), config.noise.sigma_range_m)

    return look


def _pmd(target: Target) -> Callable[[RigidTransform, int], Frame]:
    config = PmdConfig()
    emulator = PmdEmulator(config, target, seed=1)
    grid = RayGrid.pinhole(config.camera)

    def look(pose: RigidTransform, frame: int) -> Frame:
        range_m, normals = _met(grid, target, pose)
        poses = [pose] * config.sub_exposures
        first, second = (
            emulator.expose(poses, sun_W_m2=np.zeros(3), frame=2 * frame + turn).depth_m.copy()
            for turn in (0, 1)
        )
        lit = np.isfinite(first) & np.isfinite(second) & np.isfinite(range_m)
        if not lit.any():
            return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
        spread_m = np.abs(first[lit] - second[lit]) / np.sqrt(2.0)
        sigma_m = MAD_TO_SIGMA * float(np.median(spread_m))
        places_m = range_m[lit][:, None] * grid.directions[lit]
        return places_m, normals[lit], np.full(len(places_m), max(sigma_m, 1e-6))

    return look
