"""Expected accuracy of a pose from one frame, by range: what the default tracker states of emulated frames.

A tracker's covariance is the inverse of the information that it takes from a frame: ranges, outlines, edges
and what it knows of the sensor's systematic errors. The frames are those of the emulators with their default
configuration, without sun, and the tracker starts at the true pose. So the values hold for a pose that was
found, with a model that is right.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rpod_analysis.target_check.emulated import EmulatedKind, default_tracker, measured_points
from rpod_pose.ports import Registration
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import make_pose
from rpod_schemas.sensors import sensor_kind
from rpod_target import Equivalence, Target

_ATTITUDES = 5
_SHARES = (1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0)
"""Ranges that are examined, over the target's radius."""
_FEWEST = 6
"""Least number of points that can fix a pose."""


@dataclass(frozen=True)
class RangeAccuracy:
    """Accuracy of one frame of a sensor at one range; medians over attitudes."""

    range_m: float
    points: int
    """Number of points on the target."""
    sigma_position_m: float | None
    """Standard deviation along the least known direction, m; None if most frames give no pose."""
    sigma_attitude_deg: float | None
    """Standard deviation about the least known axis but a free one, deg; None if most frames give no pose."""


@dataclass(frozen=True)
class SensorAccuracy:
    """Accuracy of a sensor's frames, by range."""

    sensor: str
    ranges: tuple[RangeAccuracy, ...]


def expected_accuracy(target: Target) -> tuple[SensorAccuracy, ...]:
    """Return the expected accuracy of a pose from one frame of each sensor in its default configuration."""
    found = []
    for name in ("lidar", "pmd"):
        emulated = EmulatedKind(sensor_kind(name), target, seed=1)
        found.append(SensorAccuracy(name, _by_range(emulated, default_tracker(emulated), target)))
    return tuple(found)


def _by_range(emulated: EmulatedKind, tracker: Any, target: Target) -> tuple[RangeAccuracy, ...]:
    attitudes = Rotation.random(_ATTITUDES, rng=np.random.default_rng(1))
    found = []
    for share in _SHARES:
        range_m, results = share * target.radius_m, []
        for number, attitude in enumerate(attitudes, start=1):
            pose = make_pose(rotation=attitude, translation_m=[0.0, 0.0, range_m])
            frame = emulated.frame(pose, sun_W_m2=np.zeros(3), number=number)
            points = 0 if frame is None else measured_points(frame)
            stated = tracker.track(frame, pose) if points >= _FEWEST else None
            results.append((points, *_stated(stated, target.equivalence)))
        points, position_m, attitude_deg = np.median(np.array(results), axis=0).tolist()
        if points < _FEWEST:
            break
        found.append(RangeAccuracy(range_m, int(points), _known(position_m), _known(attitude_deg)))
    return tuple(found)


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _stated(found: Registration | None, alike: Equivalence) -> tuple[float, float]:
    """Return the largest standard deviations of position, m, and attitude, deg; inf without a usable pose.

    The angle about a free axis does not count.
    """
    if found is None or found.T_sensor_target is None or not found.continues_track:
        return np.inf, np.inf
    R = found.T_sensor_target.rotation.as_matrix()
    covariance = alike.with_free_variance(found.covariance, R, 0.0)
    return _largest(covariance[:3, :3]), float(np.degrees(_largest(covariance[3:, 3:])))


def _largest(covariance: FloatArray) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) if np.isfinite(covariance).all() else np.inf
