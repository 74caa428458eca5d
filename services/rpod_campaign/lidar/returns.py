"""Scans of a target of any size with a wanted number of returns: step, window and range of the LIDAR."""

from dataclasses import dataclass
from functools import lru_cache
from math import asin, ceil, degrees, radians, sin, sqrt

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_campaign.engine.trial.sizes import middle_m, with_middle_at
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.lidar.methods import lidar_config
from rpod_campaign.lidar.scene import CLEARANCE_M, scan_of
from rpod_geometry.rays import RayGrid, cast
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera, LidarScan
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import Target, is_shipped

RETURNS = (30.0, 500.0)
"""Least and greatest number of returns of a scan, where none is chosen; the logarithm is uniform."""
COMMON_RETURNS = (500.0, 250.0, 120.0, 60.0, 30.0)
"""Mean numbers of returns that give the ranges of a target for which none are given."""
ELLIPSE_M, ELLIPSE_RETURNS = (25.0, 53.0), 120.0
"""Least and greatest range of the safety ellipse for a shipped target, m; for another one, mean number of
returns at the least range."""
_STEPS_DEG = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02)
_TYPICAL = 0.4
"""Number of returns that the chosen step gives at the nearest range or beyond, over the greatest one that is
wanted."""
_VIEWS, _PIXELS = 12, 64
"""Number of attitudes, and of pixels along each side of an image, that measure a silhouette."""
_ATTITUDES = 8
"""Number of attitudes over which returns are averaged."""
_REACH = 1.5
"""Distance from the target's origin, over its radius, up to which returns count: that of range outliers."""
_ROUNDS = 6
"""Number of corrections of a range."""


@dataclass(frozen=True)
class Window:
    """A scan that holds a target at every range from the nearest on."""

    step_deg: float
    span_deg: float
    nearest_m: float
    """Least range of the target's middle, m: it is in the window, and no surface nearer than 2 m."""
    silhouette_m2: float
    """Mean area of the target's silhouette, m2."""

    def range_m(self, returns: float) -> float:
        """Return the range, m, at which a number of rays meets the mean silhouette; at least the least."""
        return max(self.nearest_m, sqrt(self.silhouette_m2 / returns) / radians(self.step_deg))

    def config(self) -> LidarConfig:
        """Return the 2015 paper's LIDAR with this window."""
        return lidar_config(step_deg=self.step_deg, span_deg=self.span_deg)


@lru_cache(maxsize=64)
def window_of(name: str, greatest: float = RETURNS[1]) -> Window:
    """Return the window for a target: the paper's step of 1 deg, or a finer one for enough returns.

    Args:
        name: name of the target.
        greatest: greatest number of returns that is wanted; below that of ``RETURNS`` it changes nothing.
    """
    target = cached_target(name)
    corners_m = target.triangles_m.reshape(-1, 3)
    radius_m = float(np.linalg.norm(corners_m - middle_m(target), axis=1).max())
    nearest_m = max(2.0 * radius_m, radius_m + CLEARANCE_M)
    area_m2 = silhouette_m2(target, radius_m)
    typical = _TYPICAL * max(greatest, RETURNS[1])
    wanted_deg = degrees(sqrt(area_m2 / typical) / nearest_m)
    step_deg = next((step for step in _STEPS_DEG if step <= wanted_deg), _STEPS_DEG[-1])
    span_deg = step_deg * 2 * ceil(degrees(asin(radius_m / nearest_m)) / step_deg)
    return Window(step_deg, span_deg, nearest_m, area_m2)


def silhouette_m2(target: Target, radius_m: float) -> float:
    """Return the mean area of a target's silhouette over attitudes, m2.

    Args:
        target: the target.
        radius_m: radius of its bounding sphere about the middle, m.
    """
    range_m = 20.0 * radius_m
    focal = 0.5 * _PIXELS * sqrt(range_m**2 - radius_m**2) / radius_m
    camera = Camera(
        width=_PIXELS, height=_PIXELS, fx=focal, fy=focal, cx=0.5 * _PIXELS - 0.5, cy=0.5 * _PIXELS - 0.5
    )
    rays, place_m = RayGrid.pinhole(camera), np.array((0.0, 0.0, range_m))
    met = 0
    for attitude in Rotation.random(_VIEWS, rng=np.random.default_rng(0)):
        pose = with_middle_at(attitude, place_m, target)
        met += int(np.isfinite(cast(rays, target.triangles_m, pose).range_m).sum())
    return met / _VIEWS * (range_m / focal) ** 2


def scan_with_returns(
    emulator: LidarEmulator,
    target: str,
    R_sensor_target: Rotation,
    *,
    returns: float,
    trial: int,
    greatest: float = RETURNS[1],
) -> tuple[RigidTransform, LidarScan]:
    """Return a pose on the boresight and its scan, with about the wanted returns if the window allows it.

    The range is corrected by the number of returns there, since inclined or dark surfaces return few rays
    from afar. The emulator has the window of the greatest number of returns.
    """
    window, loaded = window_of(target, greatest), cached_target(target)

    def taken(range_m: float) -> tuple[RigidTransform, LidarScan]:
        pose = with_middle_at(R_sensor_target, np.array((0.0, 0.0, range_m)), loaded)
        return pose, scan_of(emulator, pose, trial=trial)

    range_m = window.range_m(returns)
    pose, scan = taken(range_m)
    for _ in range(_ROUNDS):
        share = max(returns_on(loaded, pose, scan) / returns, 0.1)
        next_m = max(window.nearest_m, range_m * sqrt(share))
        if abs(share - 1.0) < 0.1 or next_m == range_m:
            break
        range_m = next_m
        pose, scan = taken(range_m)
    return pose, scan


def returns_on(target: Target, pose: RigidTransform, scan: LidarScan) -> int:
    """Return the number of returns of a scan that may be on the target: false ones lie mostly elsewhere."""
    away_m = np.linalg.norm(pose.inv().apply(scan.returns_m.astype(np.float64)), axis=1)
    return int(np.count_nonzero(away_m <= _REACH * target.radius_m))


@lru_cache(maxsize=256)
def range_of_returns(name: str, returns: float) -> float:
    """Return the range, m, at which the 2015 paper's LIDAR has a number of returns on average, with 3 digits.

    It is not less than that at which the target is in the LIDAR's window of 40 deg at any attitude.
    """
    target, config = cached_target(name), lidar_config()
    nearest_m = target.radius_m / sin(radians(0.5 * config.pattern.azimuth_span_deg))
    emulator = LidarEmulator(config, target, seed=0)
    attitudes = Rotation.random(_ATTITUDES, rng=np.random.default_rng(0))
    area_m2 = silhouette_m2(target, target.radius_m)
    range_m = max(nearest_m, sqrt(area_m2 / returns) / radians(config.pattern.step_deg))
    for _ in range(_ROUNDS):
        poses = [make_pose(rotation=turn, translation_m=(0.0, 0.0, range_m)) for turn in attitudes]
        counts = [len(scan_of(emulator, pose, trial=k).returns_m) for k, pose in enumerate(poses)]
        range_m = max(nearest_m, range_m * sqrt(max(float(np.mean(counts)) / returns, 0.1)))
    return float(f"{range_m:.3g}")


def ellipse_m(target: str) -> tuple[float, float]:
    """Return the least and the greatest range of the safety ellipse, m."""
    least_m, greatest_m = ELLIPSE_M
    if is_shipped(cached_target(target)):
        return ELLIPSE_M
    nearest_m = range_of_returns(target, ELLIPSE_RETURNS)
    return nearest_m, nearest_m * greatest_m / least_m
