"""Parts of a target that give no evidence: flexible foil, or an array whose angle is unknown.

The methods get the target without these parts, so they expect no point, edge or pixel of them. The points of
these parts are removed from the frame first. These are the points whose nearest surface is one of these
parts, at a pose of the whole target: the predicted pose, or for a first pose the result of a search with all
parts. If such a part hides another one, the rays that end on it count as rays without a return.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_pose.ports import Acquirer, Acquisition, Methods, Registration, Tracker
from rpod_schemas.poses import pose_error
from rpod_schemas.types import Float32Array
from rpod_target import DistanceField, Target

_REACH = 0.25
"""Largest distance of a point from such a part at which it may belong to it, over the part's longest side.
Hand: the part is turned by 15 deg."""

Masked = Callable[[Any, Callable[[Float32Array], NDArray[np.bool_]]], Any]
"""Function that returns a frame without its points, sensor axes, shape (..., 3), for which a function of them
is true."""


class UnreliableParts:
    """Finds the points of the unreliable parts of a target.

    Args:
        target: the whole target, with a distance field.
        reliable: the target without these parts, with a distance field.

    Raises:
        rpod_target.TargetError: one of them has no distance field.
    """

    def __init__(self, target: Target, reliable: Target) -> None:
        unreliable = ~np.isin(np.array(target.parts), reliable.parts)[target.triangle_part]
        size_m = float(np.ptp(target.triangles_m[unreliable], axis=(0, 1)).max())
        self._whole, self._reliable = target.require_field(), reliable.require_field()
        self._margin_m = max(self._whole.spacing_m, self._reliable.spacing_m)
        self._radius_m = target.radius_m
        self._reach_m = max(_REACH * size_m, 2.0 * self._whole.spacing_m)

    def hit(self, points_m: Float32Array, T_sensor_target: RigidTransform) -> NDArray[np.bool_]:
        """Return which points, sensor axes, shape (..., 3), lie on an unreliable part; False for NaN."""
        on_part = np.zeros(points_m.shape[:-1], np.bool_)
        measured = np.isfinite(points_m).all(axis=-1)
        in_target_m = T_sensor_target.inv().apply(points_m[measured])
        whole_m, reliable_m = (_nearest(field, in_target_m) for field in (self._whole, self._reliable))
        nearest = whole_m < reliable_m - self._margin_m
        on_part[measured] = nearest & (np.abs(whole_m) <= self._reach_m)
        return on_part

    def moved(self, first: RigidTransform, second: RigidTransform) -> bool:
        """Return whether two poses are so far apart that other points may belong to these parts."""
        angle_rad, position_m = pose_error(first, second)
        farthest_m = np.linalg.norm(position_m) + self._radius_m * np.linalg.norm(angle_rad)
        return bool(farthest_m > self._margin_m)


def _nearest(field: DistanceField, points_m: NDArray[np.floating]) -> Float32Array:
    """Return the distances at the nodes nearest to points, (N, 3), shape (N,), m; infinite off the grid."""
    node = np.rint((points_m - field.origin_m) / field.spacing_m).astype(np.int64)
    inside = ((node >= 0) & (node < field.values.shape)).all(axis=1)
    distance_m = np.full(len(points_m), np.inf, np.float32)
    distance_m[inside] = field.values[tuple(node[inside].T)]
    return distance_m


def ignoring(methods: Methods, whole: Methods, parts: UnreliableParts, masked: Masked) -> Methods:
    """Return methods that ignore the unreliable parts.

    Args:
        methods: methods of the target without these parts.
        whole: methods of the whole target.
        parts: the unreliable parts.
        masked: function of the sensor kind that removes points from a frame.
    """

    def without(frame: Any, pose: RigidTransform) -> Any:
        return masked(frame, lambda points_m: parts.hit(points_m, pose))

    acquirer = _Acquirer(methods.acquirer, whole.acquirer, without)
    return Methods(acquirer, _Tracker(methods.tracker, parts, without), methods.deskew)


_Without = Callable[[Any, RigidTransform], Any]


class _Tracker:
    """Tracks without the points of these parts, first at the prediction, then at the pose that was found."""

    def __init__(self, tracker: Tracker[Any], parts: UnreliableParts, without: _Without) -> None:
        self._tracker, self._parts, self._without = tracker, parts, without

    def track(self, measurement: Any, T_sensor_target: RigidTransform) -> Registration:
        found = self._tracker.track(self._without(measurement, T_sensor_target), T_sensor_target)
        pose = found.T_sensor_target
        if pose is None or not self._parts.moved(T_sensor_target, pose):
            return found
        return self._tracker.track(self._without(measurement, pose), pose)


class _Acquirer:
    """Searches without the points of these parts, which a search with all parts locates."""

    def __init__(self, acquirer: Acquirer[Any], whole: Acquirer[Any], without: _Without) -> None:
        self._acquirer, self._whole, self._without = acquirer, whole, without

    def acquire(self, measurement: Any) -> Acquisition:
        pose = self._whole.acquire(measurement).pose
        return self._acquirer.acquire(measurement if pose is None else self._without(measurement, pose))

    def near(self, measurement: Any, T_sensor_target: RigidTransform) -> Acquisition:
        pose = self._whole.near(measurement, T_sensor_target).pose or T_sensor_target
        return self._acquirer.near(self._without(measurement, pose), T_sensor_target)
