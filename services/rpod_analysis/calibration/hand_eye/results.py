"""A hand-eye calibration in words and figures, and as the files that drivers and the estimator take."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.calibration.hand_eye.logged import LoggedPoses
from rpod_analysis.calibration.hand_eye.parameters import (
    DEPTH,
    HOLDER,
    HOLDER_M,
    HOLDER_RAD,
    MOUNT,
    MOUNT_M,
    MOUNT_RAD,
    HandEye,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.mount_calibration import MountCalibration, MountEvidence
from rpod_schemas.config.source import FORWARD_BORESIGHT, SourceConfig
from rpod_schemas.poses import pose_of

AIM_M, AIM_DEG, AIM_S = 0.3e-3, 0.02, 0.2e-3
"""Standard deviations that a minute at 45 Hz with sub-millimetre truth should reach; if they are larger, the
text names the missing motion."""
_CONFOUNDED = 0.9
_LASTING = 0.5
"""Correlation of successive blocks above which the stated deviations are too small."""
_MISFIT = 2.0
_SIGNIFICANT = 3.0


def mount_of(found: HandEye, poses: LoggedPoses) -> RigidTransform:
    """Return the mount of the sensor's frame as its driver has it."""
    boresight = pose_of(found.state.R_X, found.state.t_X)
    return boresight * FORWARD_BORESIGHT.inv() if poses.source.axes == "forward" else boresight


def mount_calibration(found: HandEye, poses: LoggedPoses, *, log: str) -> MountCalibration:
    """Return the mount's file; the mount is that of the sensor's frame as its driver has it."""
    return MountCalibration(
        T_chaser_sensor=mount_of(found, poses),
        evidence=MountEvidence(
            log=log,
            sensor=poses.sensor.name,
            covariance=found.covariance[MOUNT, MOUNT],
            T_holder_target=pose_of(found.state.R_Y, found.state.t_Y),
            holder_covariance=found.covariance[HOLDER, HOLDER],
            depth_offset_m=found.state.depth_m,
            depth_offset_sigma_m=found.sigma(DEPTH),
            depth_correlation=found.depth_correlation,
            pairs=found.pairs,
            residual_m=found.residual_m,
            residual_deg=float(np.degrees(found.residual_rad)),
        ),
    )


def clock_source(found: HandEye, poses: LoggedPoses) -> SourceConfig:
    """Return the sensor's source with its clock's offset: what was corrected before, and what is left."""
    whole_s = poses.source.clock_offset_s + found.state.offset_s
    return poses.source.model_copy(update={"clock_offset_s": whole_s})


def mount_findings(found: HandEye, poses: LoggedPoses) -> Iterator[str]:
    """Yield the mount of the file with its deviations, and its difference from that in the log."""
    mount = mount_of(found, poses)
    yield _pose_line("mount", mount.rotation.as_matrix(), mount.translation)
    yield _sigma_line(found, MOUNT_M, MOUNT_RAD, "chaser")
    before = poses.sensor.T_chaser_sensor
    if before is not None:
        turn = Rotation.from_matrix(found.state.R_X) * before.rotation.inv()
        moved_mm = 1e3 * (found.state.t_X - before.translation)
        yield (
            f"  against the log's mount: {_vector(moved_mm, 2)} mm, "
            f"{_vector(np.degrees(turn.as_rotvec()), 3)} deg (chaser axes)"
        )
    if found.sigma(DEPTH) > 0.0:
        yield (
            f"depth offset  {1e3 * found.state.depth_m:.2f} mm, sigma {1e3 * found.sigma(DEPTH):.2f} mm; "
            "correlation "
            f"with the mount along the boresight {found.depth_correlation:.3f}. With the offset known, the "
            f"mount along the boresight has sigma {1e3 * found.boresight_sigma_m:.2f} mm"
        )


def holder_findings(found: HandEye) -> Iterator[str]:
    """Yield the transform from the holder, whose pose the truth gives, to the target."""
    yield _pose_line("holder", found.state.R_Y, found.state.t_Y)
    yield _sigma_line(found, HOLDER_M, HOLDER_RAD, "holder")


def clock_findings(found: HandEye) -> Iterator[str]:
    """Yield the clock's offset and drift."""
    yield (
        f"clock         ahead by {1e3 * found.state.offset_s:.3f} ms, sigma "
        f"{1e3 * found.offset_sigma_s:.3f} ms, in "
        f"the middle of the log; drift {1e6 * found.state.drift:.1f} ppm, sigma "
        f"{1e6 * found.drift_sigma:.1f} ppm"
    )


def warnings_of(found: HandEye, poses: LoggedPoses) -> Iterator[str]:
    """Yield how well sensor and truth agree, which values are uncertain, and which motion is missing."""
    yield (
        f"residuals     {1e3 * found.residual_m:.2f} mm, {np.degrees(found.residual_rad):.3f} deg (RMS of "
        f"{found.pairs - found.outliers} pairs; {found.outliers} outliers, {found.unused} poses without "
        "truth); "
        f"{found.scale:.2f} times what both covariances say"
    )
    yield from _motion_missing(found)
    if abs(found.depth_correlation) > _CONFOUNDED:
        yield (
            "note: depth offset and mount along the boresight are separated only by what is known of the "
            "depth (--depth-sigma-mm); calibrate the depth first, or measure one distance"
        )
    if found.scale > _MISFIT:
        yield (
            f"note: residuals are {found.scale:.1f} times what the covariances say: one of them is too "
            "small, or "
            "truth and sensor do not see the same body"
        )
    if found.block_correlation > _LASTING:
        yield (
            "note: errors last longer than a fifteenth of the log (correlation "
            f"{found.block_correlation:.2f}): the "
            "deviations above are too small; log for longer, with more turns"
        )
    if poses.filtered:
        yield (
            "note: the log has no frames or no estimator's configuration: its filtered estimates were used, "
            "and a filter's delay counts as the clock's"
        )
    if not poses.truth.has_covariance:
        yield "note: the truth states no covariance and counts as exact (truth/odometry, pose.covariance)"
    yield from _drifting(found)


def _motion_missing(found: HandEye) -> Iterator[str]:
    first, second, third = found.motion.turned_deg
    yield (
        f"motion        turned by {first:.3g}, {second:.3g} and {third:.3g} deg about its three axes (RMS "
        "of pairs)"
    )
    sigma_m, direction = found.worst(MOUNT_M)
    if sigma_m > AIM_M:
        yield (
            f"note: the mount's position is known worst along ({_vector(direction, 2)}) of the chaser, sigma "
            f"{1e3 * sigma_m:.2f} mm: larger turns about axes across it would determine it, or a longer log"
        )
    sigma_rad, axis = found.worst(MOUNT_RAD)
    if np.degrees(sigma_rad) > AIM_DEG:
        yield (
            f"note: the mount's attitude is known worst about ({_vector(axis, 2)}) of the chaser, sigma "
            f"{np.degrees(sigma_rad):.3f} deg: larger turns about axes across it would determine it, or a "
            "longer log"
        )
    if found.offset_sigma_s > AIM_S:
        yield (
            f"note: the clock's offset has sigma {1e3 * found.offset_sigma_s:.2f} ms: the target turned at "
            f"{np.degrees(found.rate_rad_s):.2g} deg/s and moved at {1e3 * found.speed_m_s:.3g} mm/s "
            "(RMS). Faster "
            "turns and changes of direction would determine it"
        )


def _drifting(found: HandEye) -> Iterator[str]:
    drift = abs(found.state.drift)
    if drift > _SIGNIFICANT * found.drift_sigma > 0.0:
        yield (
            f"note: the clock drifts: its offset changes by {1e3 * AIM_S:g} ms in {AIM_S / drift:.0f} s, "
            "and the offset "
            "in the file holds for the middle of the log alone. Discipline the clock (PTP, NTP)"
        )


def _pose_line(name: str, R: FloatArray, t_m: FloatArray) -> str:
    yaw, pitch, roll = Rotation.from_matrix(R).as_euler("ZYX", degrees=True)
    return f"{name:13} {_vector(1e3 * t_m, 2)} mm; yaw, pitch, roll {yaw:.3f}, {pitch:.3f}, {roll:.3f} deg"


def _sigma_line(found: HandEye, m: slice, rad: slice, axes: str) -> str:
    sigma = np.sqrt(np.diag(found.covariance))
    return f"  sigma {_vector(1e3 * sigma[m], 2)} mm, {_vector(np.degrees(sigma[rad]), 4)} deg ({axes} axes)"


def _vector(values: FloatArray, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)
