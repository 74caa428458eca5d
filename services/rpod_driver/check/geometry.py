"""Lines that compare points with the target where truth has it: instant of the stamp, range, mount, mirror.

One fit of all kept frames gives the time by which stamps are off, a range error that all points share, and
how far the mount is off. Each point is paired with the nearest sample of the target's surface. The truth
gives its velocity, and so the derivative by time. Values that the motion does not separate have large
standard deviations and are not checked.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_driver.check.observations import Observations
from rpod_driver.check.result import CheckResult, Level, fail, ok, unchecked
from rpod_driver.check.sightings import Sighting, sightings_of
from rpod_driver.check.surface import Surface
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_schemas.poses import chained, make_pose
from rpod_schemas.types import SensorInfo

_LEAST_POSES = 3
"""Least number of poses of the truth."""
_GATES_M = (0.4, 0.4, 0.3, 0.2, 0.15, 0.1, 0.1, 0.1)
"""Farthest surface point that counts as a point's own, m, one for each step of the fit."""
_PRIOR = np.array([0.1, 0.3, 0.2, 0.2, 0.2, 0.1, 0.1, 0.1])
"""Prior standard deviations of ``Fitted.values``, wider than any calibration error."""
_IMPLAUSIBLE = 3.0
"""Magnitude of a value, in prior standard deviations, above which the fit has not found the target."""
_FACING = -0.4
"""Least cosine between ray and normal of a surface that faces the sensor."""
SIGMAS = 4.0
_RANGE_M = 0.05
"""Greatest range error: an uncalibrated PMD camera has some centimetres (wiggling)."""
_MOUNT_M, _MOUNT_DEG = 0.02, 1.0
"""Greatest error of a mount across the boresight. Robots state errors of 1.6 mm and 0.2 deg for the truth;
the rest is the error of an uncalibrated lens at the edge of an image."""
_CLOCK_S = 0.01
"""Greatest offset of stamps for a sensor without a long exposure, s: five standard deviations of the clock
that the estimator assumes by default."""
_TRUTH_GAP_S = 0.05
"""Longest time between two poses of the truth between which it is interpolated."""
MOST_DISTANCE = SIGMAS + 1.0
"""Greatest Mahalanobis distance between the fitted mount and the published one; beyond, the mount is off."""
MOST_IMPROVEMENT = 0.8
"""Ratio ``Fitted.improvement`` up to which a mount counts as off. Where the points lie on the target as well
at the published mount, the fit has followed the errors of the ranges. Hand: of mounts that are 3 deg off it
was 0.34 to 0.44, of right ones 1.0 (three seeds, ideal camera and LIDAR)."""
UNDETERMINED = (
    "the motion does not determine time, range and mount; let the target turn more, or watch longer"
)
_MIRROR_SHARE = 0.6
"""Ratio of the mirrored points' residual to that of the points as sent at which they count as mirrored."""


@dataclass(frozen=True)
class Fitted:
    """Result of a fit."""

    values: FloatArray
    """Shape (8,): the instant of the points less their stamp, s; the error that all ranges share, m; the step
    from the published mount to the fitted one, sensor axes: translation, m, and rotation vector, rad."""
    covariance: FloatArray
    """Covariance of the values, shape (8, 8)."""
    residual_m: float
    """Median distance of all points from the surface, m."""
    improvement: float
    """RMS distance of the points from the surface at the fitted mount over that at the published one; none
    counts as more than the last gate."""

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of the values."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def is_implausible(self) -> bool:
        """Whether values are larger than any error of a calibration: the motion does not determine them."""
        return bool((np.abs(self.values) > _IMPLAUSIBLE * _PRIOR).any())


def with_truth(seen: Observations, results: list[CheckResult]) -> list[CheckResult]:
    """Return the results, with the lines that truth decides in place of those that were not checked."""
    surface = seen.options.surface
    if surface is None or len(seen.truth) < _LEAST_POSES:
        given = surface is not None
        return _without_truth(
            results, "no truth came" if given else "needs the target's surface and truth: give --target"
        )
    if reason := _other_time(results):
        return _without_truth(results, reason)
    reason, sightings, T_chaser_sensor = sightings_of(seen, surface, seen.truth, gap_s=_TRUTH_GAP_S)
    if reason:
        return _without_truth(results, reason)
    plain = fitted(sightings, surface, T_chaser_sensor)
    mirror = fitted([_mirrored(each) for each in sightings], surface, T_chaser_sensor)
    ratio = mirror.residual_m / max(plain.residual_m, 1e-6)
    new = {each.line: each for each in (_undetermined() if plain.is_implausible else _checked(seen, plain))}
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
        new.pop(each.line) if each.line in new and _supersedes(new[each.line], each) else each
        for each in results
    ]
    return merged + [each for line, each in new.items() if line in ("range", "mount_truth")]


def _other_time(results: list[CheckResult]) -> str:
    """Return why frames cannot be compared with truth at their stamps; empty if they can."""
    for each in results:
        if each.line == "clock" and each.level is Level.FAIL:
            off_s = abs(each.figures["least_age_s"])
            if off_s > _IMPLAUSIBLE * _PRIOR[0]:
                return f"the stamps are {off_s:.1f} s off: correct the clock first"
    return ""


def _supersedes(new: CheckResult, old: CheckResult) -> bool:
    """Return whether a result with truth replaces the old one: it was unchecked, or only the new fails."""
    return old.level is Level.UNCHECKED or (new.level is Level.FAIL and old.level is not Level.FAIL)


def _undetermined() -> list[CheckResult]:
    return [unchecked(line, UNDETERMINED) for line in ("instant", "range", "mount_truth")]


def _without_truth(results: list[CheckResult], reason: str) -> list[CheckResult]:
    return [*results, unchecked("range", reason), unchecked("mount_truth", reason)]


def _mirrored(sighting: Sighting) -> Sighting:
    return replace(sighting, points_m=sighting.points_m * np.array([-1.0, 1.0, 1.0]))


def fitted(sightings: list[Sighting], surface: Surface, mount: RigidTransform) -> Fitted:
    """Return the time, range and mount that bring the points of all frames to the surface.

    Gauss-Newton over points and planes of their nearest samples, with Tukey weights. The covariance takes
    the points of a frame as one observation, because their errors are correlated.
    """
    values = np.zeros(8)
    for gate_m in _GATES_M:
        found = [_equations(each, values, surface, mount, gate_m) for each in sightings]
        variance_m2 = _variance_m2(found)
        gradient = sum((J.T * w) @ r for J, r, w in found) + values / _PRIOR**2 * variance_m2
        values = values - np.linalg.solve(_normal(found, variance_m2), gradient)
    found = [_equations(each, values, surface, mount, _GATES_M[-1]) for each in sightings]
    variance_m2 = _variance_m2(found)
    inverse = np.linalg.inv(_normal(found, variance_m2))
    of_frames = [(J.T * w) @ r for J, r, w in found]
    scatter = sum((np.outer(each, each) for each in of_frames), np.zeros((8, 8)))
    covariance = inverse @ scatter @ inverse + inverse * variance_m2
    residuals = np.concatenate([_distances(each, values, surface, mount) for each in sightings])
    published = values * [1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    before = np.concatenate([_distances(each, published, surface, mount) for each in sightings])
    improvement = _rms_m(residuals) / max(_rms_m(before), 1e-9)
    return Fitted(values, covariance, float(np.median(residuals)), improvement)


def _rms_m(distances_m: FloatArray) -> float:
    """Return the RMS of distances, m, each of which counts as the last gate at most."""
    return float(np.sqrt(np.mean(np.minimum(distances_m, _GATES_M[-1]) ** 2))) if distances_m.size else 0.0


_Equations = tuple[FloatArray, FloatArray, FloatArray]
"""Jacobian, shape (N, 8), residuals, m, and weights, shape (N,), of the points of a frame."""


def _normal(found: list[_Equations], variance_m2: float) -> FloatArray:
    """Return the matrix of the normal equations with the prior, shape (8, 8)."""
    normal: FloatArray = sum((J.T * w) @ J for J, _, w in found) + np.diag(_PRIOR**-2.0) * variance_m2
    return normal


def _variance_m2(found: list[_Equations]) -> float:
    """Return the variance of a residual, m2, which is the weight of the prior."""
    residuals = np.concatenate([r for _, r, _ in found] or [np.zeros(1)])
    return max(float(MAD_TO_SIGMA * np.median(np.abs(residuals))) ** 2, 1e-8) if residuals.size else 1.0


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
    in_target = in_target + velocity * sighting.times_s[:, None]
    return in_target, velocity, T_target_sensor


def _equations(
    sighting: Sighting, values: FloatArray, surface: Surface, mount: RigidTransform, gate_m: float
) -> _Equations:
    """Return the equations of the points with a surface point nearby."""
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
    scale = max(MAD_TO_SIGMA * float(np.median(np.abs(residuals))), 1e-4) if residuals.size else 1.0
    weights = np.maximum(1.0 - (residuals / (4.0 * scale)) ** 2, 0.0) ** 2
    return J, residuals, weights


def _distances(sighting: Sighting, values: FloatArray, surface: Surface, mount: RigidTransform) -> FloatArray:
    return np.asarray(surface.tree.query(_moved(sighting, values, mount)[0])[0])


def _checked(seen: Observations, fit: Fitted) -> list[CheckResult]:
    """Return the results that follow from a fit."""
    dt_s, range_m = fit.values[:2]
    sigmas = fit.sigmas
    return [
        _instant(seen, float(dt_s), float(sigmas[0])),
        _range(float(range_m), float(fit.values[4]), sigmas),
        checked_mount(fit),
    ]


def _duration_s(seen: Observations) -> float:
    return seen.info.duration_s if isinstance(seen.info, SensorInfo) else 0.0


def _instant(seen: Observations, dt_s: float, sigma_s: float) -> CheckResult:
    """Check the time between stamps and motion; an offset of the clock and another instant look alike."""
    half_s = 0.5 * _duration_s(seen)
    text = f"motion fits {1e3 * dt_s:+.2f} ms after the stamps, standard deviation {1e3 * sigma_s:.2f} ms"
    figures = {"offset_s": dt_s, "sigma_s": sigma_s}
    if half_s:
        text += f", half the exposure is {1e3 * half_s:.2f} ms"
    off_s = max(0.5 * half_s, _CLOCK_S)
    if abs(dt_s) > off_s + SIGMAS * sigma_s:
        if half_s and abs(dt_s - half_s) < 0.5 * half_s + SIGMAS * sigma_s:
            return fail("instant", text, "stamp_start", **figures)
        return fail("instant", text, "clock_behind" if dt_s > 0.0 else "clock_ahead", **figures)
    if not half_s:
        return unchecked("instant", f"{text}; the sensor does not state its exposure", **figures)
    if SIGMAS * sigma_s > half_s:
        return unchecked("instant", f"{text}: too close", **figures)
    if abs(dt_s) > 0.5 * half_s:
        return fail("instant", text, "stamp_start", **figures)
    return ok("instant", f"{text}: the middle of the exposure", **figures)


def _range(range_m: float, along_m: float, sigmas: FloatArray) -> CheckResult:
    """Check the error that all ranges share; a mount that is off along the boresight looks the same."""
    total_m = range_m - along_m
    sigma_m = float(min(sigmas[1], sigmas[4]))
    text = f"{1e3 * total_m:+.1f} mm along the boresight, mount and range together"
    figures = {"range_error_m": total_m}
    if abs(total_m) > _RANGE_M + sigma_m:
        return fail("range", text, "biased", **figures)
    return ok("range", text, **figures)


def checked_mount(fit: Fitted) -> CheckResult:
    """Check the mount that a fit gives against the published one."""
    text, figures, distance = mount_error(fit)
    if distance > MOST_DISTANCE and fit.improvement < MOST_IMPROVEMENT:
        return fail("mount_truth", text, "mount_off", **figures)
    beyond = figures["turned_deg"] > MOST_DISTANCE / SIGMAS * _MOUNT_DEG
    if beyond or distance > MOST_DISTANCE or mount_is_undetermined(fit):
        return unchecked("mount_truth", f"{text}: the motion does not show more", **figures)
    return ok("mount_truth", text, **figures)


def mount_error(
    fit: Fitted, sigma_m: float = 0.0, sigma_rad: float = 0.0
) -> tuple[str, dict[str, float], float]:
    """Return how far a mount is off, in words, in figures and over its standard deviation.

    Args:
        fit: result of the fit.
        sigma_m: standard deviation of the position of the poses that the points are compared with, m.
        sigma_rad: that of their attitude, rad.
    """
    aside_m = float(np.linalg.norm(fit.values[2:4]))
    turned_deg = float(np.rad2deg(np.linalg.norm(fit.values[5:8])))
    text = (
        f"{1e3 * aside_m:.1f} mm across the boresight and {turned_deg:.2f} deg off, standard deviations "
        f"{1e3 * float(np.linalg.norm(fit.sigmas[2:4])):.1f} mm, "
        f"{float(np.rad2deg(np.linalg.norm(fit.sigmas[5:8]))):.2f} deg"
    )
    # Across the boresight a shift and a turn look alike, so that only both together are checked.
    checked = [2, 3, 5, 6, 7]
    allowed = np.diag([_MOUNT_M] * 2 + [np.deg2rad(_MOUNT_DEG)] * 3) ** 2 / SIGMAS**2
    allowed += np.diag([sigma_m] * 2 + [sigma_rad] * 3) ** 2
    off = fit.values[checked]
    distance = float(np.sqrt(off @ np.linalg.solve(fit.covariance[np.ix_(checked, checked)] + allowed, off)))
    return text, {"aside_m": aside_m, "turned_deg": turned_deg}, distance


def mount_is_undetermined(fit: Fitted) -> bool:
    """Return whether the motion shows neither shift nor turn of the mount well enough to call it in order."""
    shift_m, turn_rad = np.linalg.norm(fit.sigmas[2:4]), np.linalg.norm(fit.sigmas[5:8])
    return bool(SIGMAS * shift_m > 2.0 * _MOUNT_M and SIGMAS * turn_rad > 2.0 * np.deg2rad(_MOUNT_DEG))
