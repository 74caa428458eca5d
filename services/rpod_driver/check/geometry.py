"""Lines that compare points with the target where truth has it: instant of the stamp, range, mount, mirror.

One fit of all kept frames gives the time by which stamps are off, a range error that all points share, and
how far the mount is off. Each point is paired with the nearest sample of the target's surface. The truth
gives its velocity, and so the derivative by time. Values that the motion does not separate have large
standard deviations and are not judged.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_driver.check.observations import Observations
from rpod_driver.check.surface import Surface
from rpod_driver.check.verdict import Level, Verdict, fail, ok, unchecked
from rpod_geometry.errors import DistortionError
from rpod_geometry.lens import undistort
from rpod_runtime.errors import ExtrinsicsError
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import chained, make_pose
from rpod_schemas.types import Float32Array, LidarInfo, PmdFrame, PmdInfo, SensorFrame

_FRAMES, _POINTS, _STEPS = 40, 400, 8
_LEAST_FRAMES, _LEAST_POINTS = 6, 60
_GATES_M = (0.4, 0.4, 0.3, 0.2, 0.15, 0.1, 0.1, 0.1)
"""Farthest surface point that counts as a point's own, m, in each step."""
_PRIOR = np.array([0.1, 0.3, 0.2, 0.2, 0.2, 0.1, 0.1, 0.1])
"""Prior standard deviations: s, m of range, m and rad of the mount; wider than any calibration error."""
_EDGE_M = 0.05
"""Step between two pixels that is an edge, m."""
_FACING = -0.4
"""Cosine between ray and normal from which on a surface faces the sensor."""
_SIGMAS = 4.0
_RANGE_M = 0.05
"""Greatest range error: an uncalibrated PMD camera has some centimetres (wiggling)."""
_MOUNT_M, _MOUNT_DEG = 0.02, 1.0
"""Greatest error of a mount across the boresight. Robots state 1.6 mm and 0.2 deg of truth; the rest is what
an uncalibrated lens makes of the edge of an image."""
_MIRROR_SHARE = 0.6
"""Residual of the mirrored over that of the plain points from which on they are mirrored."""


@dataclass(frozen=True)
class Sighting:
    """One frame's points on the target, and where truth has the target."""

    points_m: FloatArray
    """Sensor axes, shape (N, 3)."""
    poses: tuple[RigidTransform, RigidTransform, RigidTransform]
    """T_chaser_target 10 ms before the stamp, at it, and 10 ms after it."""


@dataclass(frozen=True)
class Fitted:
    """Result of a fit: dt s, range m, mount m and rad, shape (8,)."""

    values: FloatArray
    covariance: FloatArray
    """Shape (8, 8)."""
    residual_m: float
    """Median distance of all points from the surface, m."""

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of the values."""
        return np.sqrt(np.diag(self.covariance))


def with_truth(seen: Observations, verdicts: list[Verdict]) -> list[Verdict]:
    """Return the verdicts with those that truth adds, in place of lines that were not checked without it."""
    reason, sightings, T_chaser_sensor = _sightings(seen)
    surface = seen.options.surface
    if reason or surface is None:
        return [*verdicts, unchecked("range", reason), unchecked("mount_truth", reason)]
    plain = fitted(sightings, surface, T_chaser_sensor)
    mirror = fitted([_mirrored(each) for each in sightings], surface, T_chaser_sensor)
    ratio = mirror.residual_m / max(plain.residual_m, 1e-6)
    new = {each.line: each for each in _judged(seen, plain)}
    if ratio < _MIRROR_SHARE:
        text = f"mirrored points fit the target {1.0 / ratio:.1f} times better"
        new = {"grid": fail("grid", text, "mirrored", mirror_ratio=ratio)}
        for line in ("range", "mount_truth"):
            new[line] = unchecked(line, "the points are mirrored")
    elif ratio > 1.0 / _MIRROR_SHARE:
        new["grid"] = ok(
            "grid", f"mirrored points fit the target {ratio:.1f} times worse", mirror_ratio=ratio
        )
    merged = [
        new.pop(each.line) if each.line in new and each.level is Level.UNCHECKED else each
        for each in verdicts
    ]
    return merged + [each for line, each in new.items() if line in ("range", "mount_truth")]


def _sightings(seen: Observations) -> tuple[str, list[Sighting], RigidTransform]:
    """Return why points cannot be compared with truth, or the points and the mount."""
    nothing: list[Sighting] = []
    away = make_pose()
    if seen.options.surface is None:
        return "needs the target's surface and truth: give --target", nothing, away
    if len(seen.truth) < 3 or not seen.kept:
        return "no truth came" if seen.kept else "no frame could be read", nothing, away
    try:
        mount = seen.extrinsics().mount(seen.name, seen.kept[-1].frame.frame_id)
    except ExtrinsicsError as error:
        return str(error), nothing, away
    mount = seen.options.source.boresight_mount(mount)
    times_ns = np.array([each.stamp_ns for each in seen.truth])
    kept = seen.kept[:: len(seen.kept) // _FRAMES + 1]
    for each in kept:
        poses = tuple(_at(seen, times_ns, each.frame.stamp_ns + step) for step in (-(10**7), 0, 10**7))
        if any(pose is None for pose in poses):
            continue
        points_m = _near(points_of(each.frame), poses[1], mount, seen.options.surface)  # type: ignore[arg-type]
        if len(points_m) >= _LEAST_POINTS:
            nothing.append(Sighting(points_m, poses))  # type: ignore[arg-type]
    if len(nothing) < _LEAST_FRAMES:
        return (
            f"{len(nothing)} frames show the target where truth has it, {_LEAST_FRAMES} are needed",
            [],
            away,
        )
    return "", nothing, mount


def _at(seen: Observations, times_ns: FloatArray, stamp_ns: int) -> RigidTransform | None:
    """Return T_chaser_target at a time, interpolated over at most 50 ms; None in a gap."""
    after = int(np.searchsorted(times_ns, stamp_ns))
    if not 0 < after < len(times_ns) or times_ns[after] - times_ns[after - 1] > 50_000_000:
        return None
    first, second = seen.truth[after - 1].pose, seen.truth[after].pose
    share = float(stamp_ns - times_ns[after - 1]) / float(times_ns[after] - times_ns[after - 1])
    step = chained(first.inv(), second)
    return chained(first, RigidTransform.from_exp_coords(share * step.as_exp_coords()))


def points_of(frame: SensorFrame) -> FloatArray:
    """Return the returns of a frame, sensor axes, shape (N, 3), m."""
    if not isinstance(frame, PmdFrame):
        return frame.returns_m.astype(np.float64)
    camera = frame.camera
    rows, columns = np.nonzero(_inner(frame.depth_m))
    distorted = np.stack(((columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy))
    try:
        x, y = undistort(distorted.astype(np.float64), camera)
    except DistortionError:
        return np.zeros((0, 3))
    depth_m = frame.depth_m[rows, columns].astype(np.float64)
    return np.stack((x * depth_m, y * depth_m, depth_m), axis=1)


def _inner(depth_m: Float32Array) -> NDArray[np.bool_]:
    """Return the pixels whose neighbours are as far: pixels at edges mix two distances."""
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(depth_m) & (depth_m > 0.0)
        for axis in (0, 1):
            for step in (-1, 1):
                valid = valid & (np.abs(np.roll(depth_m, step, axis) - depth_m) < _EDGE_M)
    inner: NDArray[np.bool_] = valid
    return inner


def _near(points_m: FloatArray, pose: RigidTransform, mount: RigidTransform, surface: Surface) -> FloatArray:
    """Return some of the points around the target."""
    in_target = chained(pose.inv(), mount).apply(points_m)
    found: FloatArray = points_m[np.linalg.norm(in_target, axis=1) < surface.radius_m + _GATES_M[0]]
    random = np.random.default_rng(len(found))
    return found[random.permutation(len(found))[:_POINTS]]


def _mirrored(sighting: Sighting) -> Sighting:
    return replace(sighting, points_m=sighting.points_m * np.array([-1.0, 1.0, 1.0]))


def fitted(sightings: list[Sighting], surface: Surface, mount: RigidTransform) -> Fitted:
    """Return the time, range and mount that bring the points of all frames to the surface.

    Gauss-Newton over points and planes of their nearest samples, with Tukey weights. The covariance takes
    the points of a frame as one observation, because their errors are correlated.
    """
    values = np.zeros(8)
    for gate_m in _GATES_M[:_STEPS]:
        scores = [_equations(each, values, surface, mount, gate_m) for each in sightings]
        normal = sum((J.T * w) @ J for J, _, w in scores) + np.diag(_PRIOR**-2.0) * _unit(scores)
        gradient = sum((J.T * w) @ r for J, r, w in scores) + values / _PRIOR**2 * _unit(scores)
        values = values - np.linalg.solve(normal, gradient)
    scores = [_equations(each, values, surface, mount, _GATES_M[-1]) for each in sightings]
    inverse = np.linalg.inv(sum((J.T * w) @ J for J, _, w in scores) + np.diag(_PRIOR**-2.0) * _unit(scores))
    frames = [(J.T * w) @ r for J, r, w in scores]
    scatter = sum((np.outer(each, each) for each in frames), np.zeros((8, 8)))
    points = inverse * _unit(scores)
    covariance = inverse @ scatter @ inverse + points
    residuals = np.concatenate([_distances(each, values, surface, mount) for each in sightings])
    return Fitted(values, covariance, float(np.median(residuals)))


def _unit(scores: list[tuple[FloatArray, FloatArray, FloatArray]]) -> float:
    """Return the variance of a residual, m2: the weight of the prior."""
    residuals = np.concatenate([r for _, r, _ in scores] or [np.zeros(1)])
    return max(float(1.4826 * np.median(np.abs(residuals))) ** 2, 1e-8) if residuals.size else 1.0


def _moved(
    sighting: Sighting, values: FloatArray, mount: RigidTransform
) -> tuple[FloatArray, FloatArray, RigidTransform]:
    """Return points in target axes, their velocity there, and T_target_sensor, for given values."""
    before, now, after = sighting.poses
    rate = chained(before.inv(), after).as_exp_coords() / 0.02
    pose = chained(now, RigidTransform.from_exp_coords(values[0] * rate))
    moved = chained(mount, make_pose(translation_m=values[2:5], rotation=Rotation.from_rotvec(values[5:8])))
    T_target_sensor = chained(pose.inv(), moved)
    points_m = sighting.points_m
    rays = points_m / np.linalg.norm(points_m, axis=1, keepdims=True)
    in_target = T_target_sensor.apply(points_m - values[1] * rays)
    velocity = -(np.cross(rate[:3], in_target) + rate[3:])
    return in_target, velocity, T_target_sensor


def _equations(
    sighting: Sighting, values: FloatArray, surface: Surface, mount: RigidTransform, gate_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Jacobian, shape (N, 8), residuals and weights of the points with a surface point nearby."""
    in_target, velocity, T_target_sensor = _moved(sighting, values, mount)
    distances, nearest = surface.tree.query(in_target)
    normals = surface.normals[nearest]
    turn = T_target_sensor.rotation
    rays = turn.apply(sighting.points_m / np.linalg.norm(sighting.points_m, axis=1, keepdims=True))
    seen = (distances < gate_m) & (np.einsum("ij,ij->i", normals, rays) < _FACING)
    normals, rays = normals[seen], rays[seen]
    residuals = np.einsum("ij,ij->i", normals, in_target[seen] - surface.points_m[nearest][seen])
    in_sensor = turn.inv().apply(normals)
    J = np.column_stack((
        np.einsum("ij,ij->i", normals, velocity[seen]),
        -np.einsum("ij,ij->i", normals, rays),
        in_sensor,
        np.cross(sighting.points_m[seen], in_sensor),
    ))  # fmt: skip
    scale = max(1.4826 * float(np.median(np.abs(residuals))), 1e-4) if residuals.size else 1.0
    weights = np.maximum(1.0 - (residuals / (4.0 * scale)) ** 2, 0.0) ** 2
    return J, residuals, weights


def _distances(sighting: Sighting, values: FloatArray, surface: Surface, mount: RigidTransform) -> FloatArray:
    return np.asarray(surface.tree.query(_moved(sighting, values, mount)[0])[0])


def _judged(seen: Observations, fit: Fitted) -> list[Verdict]:
    """Return the lines that a fit judges."""
    dt_s, range_m = fit.values[:2]
    sigmas = fit.sigmas
    return [
        _instant(seen, float(dt_s), float(sigmas[0])),
        _range(float(range_m), float(fit.values[4]), sigmas),
        _mount(fit),
    ]


def _duration_s(seen: Observations) -> float:
    if isinstance(seen.info, PmdInfo):
        return float(seen.info.integration_time_s)
    return float(seen.info.scan_time_s) if isinstance(seen.info, LidarInfo) else 0.0


def _instant(seen: Observations, dt_s: float, sigma_s: float) -> Verdict:
    half_s = 0.5 * _duration_s(seen)
    text = f"motion fits {1e3 * dt_s:+.2f} ms after the stamps, standard deviation {1e3 * sigma_s:.2f} ms"
    figures = {"offset_s": dt_s, "sigma_s": sigma_s}
    if not half_s:
        return unchecked("instant", f"{text}; the sensor does not state its exposure", **figures)
    if _SIGMAS * sigma_s > half_s:
        return unchecked(
            "instant", f"{text}, half the exposure is {1e3 * half_s:.2f} ms: too close", **figures
        )
    if abs(dt_s) > 0.5 * half_s:
        return fail(
            "instant", f"{text}, half the exposure is {1e3 * half_s:.2f} ms", "stamp_start", **figures
        )
    return ok("instant", f"{text}: the middle of the exposure", **figures)


def _range(range_m: float, along_m: float, sigmas: FloatArray) -> Verdict:
    """Judge the error that all ranges share; a mount that is off along the boresight looks the same."""
    total_m = range_m - along_m
    sigma_m = float(min(sigmas[1], sigmas[4]))
    text = f"{1e3 * total_m:+.1f} mm along the boresight, mount and range together"
    figures = {"range_error_m": total_m}
    if abs(total_m) > _RANGE_M + sigma_m:
        return fail("range", text, "biased", **figures)
    return ok("range", text, **figures)


def _mount(fit: Fitted) -> Verdict:
    aside_m = float(np.linalg.norm(fit.values[2:4]))
    turned_deg = float(np.rad2deg(np.linalg.norm(fit.values[5:8])))
    sigma_m = float(np.linalg.norm(fit.sigmas[2:4]))
    sigma_deg = float(np.rad2deg(np.linalg.norm(fit.sigmas[5:8])))
    text = (
        f"{1e3 * aside_m:.1f} mm across the boresight and {turned_deg:.2f} deg off, standard deviations "
        f"{1e3 * sigma_m:.1f} mm, {sigma_deg:.2f} deg"
    )
    figures = {"aside_m": aside_m, "turned_deg": turned_deg}
    # Across the boresight a shift and a turn look alike, so that only both together are judged.
    judged = [2, 3, 5, 6, 7]
    allowed = np.diag([_MOUNT_M] * 2 + [np.deg2rad(_MOUNT_DEG)] * 3) ** 2 / _SIGMAS**2
    off = fit.values[judged]
    distance = float(np.sqrt(off @ np.linalg.solve(fit.covariance[np.ix_(judged, judged)] + allowed, off)))
    if distance > _SIGMAS + 1.0:
        return fail("mount_truth", text, "mount_off", **figures)
    if _SIGMAS * sigma_m > 2.0 * _MOUNT_M and _SIGMAS * sigma_deg > 2.0 * _MOUNT_DEG:
        return unchecked("mount_truth", f"{text}: the motion does not show more", **figures)
    return ok("mount_truth", text, **figures)
