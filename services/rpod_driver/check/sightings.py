"""A sensor's points on the target, with the target's poses around the time of each frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_driver.check.observations import Observations
from rpod_driver.check.surface import Surface
from rpod_geometry.errors import DistortionError
from rpod_geometry.lens import undistort
from rpod_runtime.errors import ExtrinsicsError
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import between, chained, make_pose
from rpod_schemas.types import Float32Array, Odometry, SensorFrame

_FRAMES, _POINTS = 40, 400
_LEAST_FRAMES, _LEAST_POINTS = 12, 60
"""The scatter of the frames is the fit's covariance: fewer than eight do not determine eight values."""
_AROUND_M = 0.4
"""Distance from the target's sphere within which a point may be its own, m: the fit's first gate."""
_EDGE_M = 0.05
"""Step between two pixels that is an edge, m."""


@dataclass(frozen=True)
class Sighting:
    """One frame's points on the target, and where truth has the target."""

    points_m: FloatArray
    """Sensor axes, shape (N, 3)."""
    times_s: FloatArray
    """Times of the points from the stamp, shape (N,); 0 where the sensor states none."""
    poses: tuple[RigidTransform, RigidTransform, RigidTransform]
    """T_chaser_target 10 ms before the stamp, at it, and 10 ms after it."""


def sightings_of(
    seen: Observations, surface: Surface, poses: list[Odometry], *, gap_s: float
) -> tuple[str, list[Sighting], RigidTransform]:
    """Return why points cannot be compared with a target's poses, or the points and the published mount.

    Args:
        seen: what came of the sensor.
        surface: surface of the target.
        poses: poses T_chaser_target, by rising stamps.
        gap_s: longest time between two poses between which they are interpolated.
    """
    nothing: list[Sighting] = []
    if not seen.kept:
        return "no frame could be read", nothing, make_pose()
    try:
        mount = seen.extrinsics().mount(seen.name, seen.kept[-1].frame.frame_id)
    except ExtrinsicsError as error:
        return str(error), nothing, make_pose()
    mount = seen.options.source.boresight_mount(mount)
    times_ns = np.array([each.stamp_ns for each in poses])
    found = []
    for each in seen.kept[:: len(seen.kept) // _FRAMES + 1]:
        stamps_ns = [each.frame.stamp_ns + step for step in (-(10**7), 0, 10**7)]
        before, now, after = (_at(poses, times_ns, stamp_ns, gap_s) for stamp_ns in stamps_ns)
        if before is None or now is None or after is None:
            continue
        points_m, times_s = _near(points_of(each.frame), each.frame.return_times_s, now, mount, surface)
        if len(points_m) >= _LEAST_POINTS:
            found.append(Sighting(points_m, times_s, (before, now, after)))
    if len(found) < _LEAST_FRAMES:
        reason = f"{len(found)} frames show the target where its pose is known, {_LEAST_FRAMES} are needed"
        return reason, nothing, mount
    return "", found, mount


def _at(
    poses: list[Odometry], times_ns: NDArray[np.int64], stamp_ns: int, gap_s: float
) -> RigidTransform | None:
    """Return T_chaser_target at a time, interpolated between two poses; None in a gap or beyond the ends."""
    after = int(np.searchsorted(times_ns, stamp_ns))
    if not 0 < after < len(times_ns) or times_ns[after] - times_ns[after - 1] > 1e9 * gap_s:
        return None
    share = float(stamp_ns - times_ns[after - 1]) / float(times_ns[after] - times_ns[after - 1])
    return between(poses[after - 1].pose, poses[after].pose, share)


def points_of(frame: SensorFrame) -> FloatArray:
    """Return the returns of a frame, sensor axes, shape (N, 3), m."""
    camera, image_m = frame.lens, frame.range_image_m
    if camera is None or image_m is None:
        return frame.returns_m.astype(np.float64)
    rows, columns = np.nonzero(_inner(image_m))
    distorted = np.stack(((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy))
    try:
        x, y = undistort(distorted.astype(np.float64), camera)
    except DistortionError:
        return np.zeros((0, 3))
    depth_m = image_m[rows, columns].astype(np.float64)
    return np.stack((x * depth_m, y * depth_m, depth_m), axis=1)


def _inner(depth_m: Float32Array) -> NDArray[np.bool_]:
    """Return the pixels whose neighbours have nearly the same depth: pixels at edges mix two depths."""
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(depth_m) & (depth_m > 0.0)
        for axis in (0, 1):
            for step in (-1, 1):
                valid = valid & (np.abs(np.roll(depth_m, step, axis) - depth_m) < _EDGE_M)
    inner: NDArray[np.bool_] = valid
    return inner


def _near(
    points_m: FloatArray,
    times_s: Float32Array | None,
    pose: RigidTransform,
    mount: RigidTransform,
    surface: Surface,
) -> tuple[FloatArray, FloatArray]:
    """Return some of the points around the target, and their times."""
    in_target = chained(pose.inv(), mount).apply(points_m)
    near = np.flatnonzero(np.linalg.norm(in_target, axis=1) < surface.radius_m + _AROUND_M)
    kept = near[np.random.default_rng(len(near)).permutation(len(near))[:_POINTS]]
    return points_m[kept], np.zeros(len(kept)) if times_s is None else np.nan_to_num(
        times_s[kept].astype(np.float64)
    )
