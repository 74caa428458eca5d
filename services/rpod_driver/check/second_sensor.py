"""The line that compares a sensor's mount with that of a second sensor, by an estimate from the latter.

An estimator tracks the target with the second sensor alone. The points of the checked sensor are compared
with the target at its poses, as they are with truth. The result is the difference of the two mounts: only
truth shows which of them is off.
"""

import numpy as np

from rpod_driver.check.geometry import (
    MOST_DISTANCE,
    MOST_IMPROVEMENT,
    SIGMAS,
    UNDETERMINED,
    Fitted,
    fitted,
    mount_error,
    mount_is_undetermined,
)
from rpod_driver.check.observations import Observations
from rpod_driver.check.result import CheckResult, fail, ok, unchecked
from rpod_driver.check.sightings import sightings_of
from rpod_schemas.types import Odometry

_LINE = "mount_second"
_LEAST_POSES = 3
_CLOCKS_S = 0.02
"""Greatest offset between the stamps of two sensors, s: twice the offset of one clock allowed beside
truth."""
_GAP_S = 1.1
"""Longest time between two estimates: scanners turn at 1 Hz. At 8 deg/s the interpolation is off by
(8 deg/s)^2 (1.1 s)^2 / 8 = 0.17 deg, a sixth of what a mount may be off."""


def mount_second(seen: Observations) -> CheckResult:
    """Check the mount against the poses that an estimator finds with another sensor."""
    surface, against = seen.options.surface, seen.options.against
    if surface is None or against is None:
        return unchecked(
            _LINE, "needs the estimate that follows from another sensor: give --target and --against"
        )
    measured_by = {each.stamp_ns: each.sensor for each in seen.statuses if each.accepted}
    if seen.name in measured_by.values():
        return unchecked(
            _LINE, f"{against!r} uses {seen.name!r} itself: run an estimator with the other sensor alone"
        )
    poses = sorted(
        (each for each in seen.estimates if each.stamp_ns in measured_by), key=lambda each: each.stamp_ns
    )
    if len(poses) < _LEAST_POSES:
        return unchecked(_LINE, f"{len(poses)} poses of {against!r} came that another sensor has measured")
    reason, sightings, mount = sightings_of(seen, surface, poses, gap_s=_GAP_S)
    if reason:
        return unchecked(_LINE, reason)
    others = ", ".join(sorted({measured_by[each.stamp_ns] for each in poses}))
    return _checked(fitted(sightings, surface, mount), poses, others)


def _checked(fit: Fitted, poses: list[Odometry], others: str) -> CheckResult:
    if fit.is_implausible:
        return unchecked(_LINE, UNDETERMINED)
    text, figures, distance = mount_error(fit, *_sigmas(poses))
    late_s, sigma_s = float(fit.values[0]), float(fit.sigmas[0])
    figures |= {"offset_s": late_s, "offset_sigma_s": sigma_s}
    text = f"{text}, against {others}; motion fits {1e3 * late_s:+.1f} ms after the stamps"
    if distance > MOST_DISTANCE and fit.improvement < MOST_IMPROVEMENT:
        return fail(_LINE, f"{text}: this mount, or that one; only truth shows which", "mount_off", **figures)
    if abs(late_s) > _CLOCKS_S + SIGMAS * sigma_s:
        fault = "clock_behind" if late_s > 0.0 else "clock_ahead"
        text = f"{text}, standard deviation {1e3 * sigma_s:.1f} ms: these stamps, or those of {others}"
        return fail(_LINE, text, fault, **figures)
    if distance > MOST_DISTANCE or mount_is_undetermined(fit):
        return unchecked(_LINE, f"{text}: the motion does not show more", **figures)
    return ok(_LINE, text, **figures)


def _sigmas(poses: list[Odometry]) -> tuple[float, float]:
    """Return the median standard deviations of position, m, and attitude, rad, in their worst directions."""
    covariances = np.stack([each.pose_covariance for each in poses])
    parts = (covariances[:, :3, :3], covariances[:, 3:, 3:])
    sigma_m, sigma_rad = (
        float(np.median(np.sqrt(np.linalg.eigvalsh(part)[:, -1].clip(0.0)))) for part in parts
    )
    return sigma_m, sigma_rad
