"""Measured and true distances of a logged PMD camera, at pixels on the target's faces.

The target is rendered at the true pose along every pixel's ray. A pixel counts if the pixels around it show
the same plane, not at a grazing angle, in sufficient light and below saturation. At outlines the light of two
surfaces mixes, and dark pixels measure the lens's stray light.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial.transform import RigidTransform

from rpod_analysis.calibration.cameras import pmd_camera
from rpod_analysis.errors import CalibrationError, NoTruthError
from rpod_analysis.log import Log
from rpod_analysis.log.sensors import configured_sensors, pmd_frames, pmd_info
from rpod_analysis.log.targets import logged_targets
from rpod_analysis.scoring.score import BoolArray, Track, calibration_gap_ns, interpolate
from rpod_geometry.errors import DistortionError
from rpod_geometry.rays import Hits, RayGrid, cast
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.config.pmd.depth_calibration import unambiguous_range_m
from rpod_schemas.config.sensor import SensorInput
from rpod_schemas.topics import CHASER, TRUTH
from rpod_schemas.types import Camera, PmdFrame
from rpod_target import Target, TargetError, load_target

_MOST_IN_FRAME = 400
"""Greatest number of pixels of a frame, taken evenly, so that near frames with many do not outweigh far
ones."""
_SAME_PLANE_PX = 5
"""Side of the square around a pixel in which all rays must hit its plane."""
_LEAST_COSINE = 0.35
"""Least cosine of the angle of incidence; beyond 70 deg a pose error has three times the effect."""
_LEAST_AMPLITUDE = 0.3
"""Least amplitude, as a share of the median amplitude of the target's pixels."""
_MOST_SATURATION = 0.9
"""Greatest amplitude, as a share of the saturated amplitude."""
_OF_LIDAR = "for a LIDAR, 'rpod driver check' with --target and truth reports the range error"


@dataclass(frozen=True, eq=False)
class DepthSamples:
    """Measured and true distances of N pixels of a camera."""

    modulation_frequency_hz: tuple[float, ...]
    target: str
    logs: tuple[str, ...]
    true_m: FloatArray
    """Radial distance of the surface, shape (N,)."""
    error_m: FloatArray
    """Measured minus true radial distance, modulo c / 2f around 0, shape (N,)."""
    frame: NDArray[np.int64]
    """Number of each pixel's frame, counted over all logs, rising, shape (N,)."""

    @property
    def frames(self) -> int:
        """Number of frames that contribute."""
        return int(np.unique(self.frame).size)


def collect(logs: list[Log], camera: str, config: EstimatorConfig | None = None) -> DepthSamples:
    """Return the pixels of a camera in one or several runs.

    Args:
        logs: logs with frames of the camera and the truth.
        camera: name of the camera.
        config: configuration of an estimator, whose target and mount of the camera go before those of the
            logs; its frequency counts where a log has no info of the camera.

    Raises:
        CalibrationError: a log lacks the camera, its mount, its frequency, the target or the truth; or two
            logs have different cameras or targets.
    """
    parts = [_of_log(log, camera, config) for log in logs]
    for field in ("modulation_frequency_hz", "target"):
        values = {getattr(part, field) for part in parts}
        if len(values) > 1:
            raise CalibrationError(f"the logs differ in {field}: {' and '.join(map(str, sorted(values)))}")
    firsts = np.cumsum([0, *(part.frame.max() + 1 for part in parts)])
    return DepthSamples(
        modulation_frequency_hz=parts[0].modulation_frequency_hz,
        target=parts[0].target,
        logs=tuple(name for part in parts for name in part.logs),
        true_m=np.concatenate([part.true_m for part in parts]),
        error_m=np.concatenate([part.error_m for part in parts]),
        frame=np.concatenate([part.frame + first for part, first in zip(parts, firsts, strict=False)]),
    )


def _of_log(log: Log, camera: str, config: EstimatorConfig | None) -> DepthSamples:
    name = log.paths[0].name
    sensor, truth = pmd_camera(log, camera, option="--camera", otherwise=_OF_LIDAR), _truth(log)
    given = next((item for item in (config.sensors if config else ()) if item.name == camera), None)
    mount = given.T_chaser_sensor if given is not None else None
    mount = sensor.T_chaser_sensor if mount is None else mount
    if mount is None:
        raise CalibrationError(
            f"{name}: neither tf_static nor the configuration in the log gives the mount of {camera!r}; let "
            "its driver publish tf_static, or give an estimator's configuration with --config"
        )
    frequencies_hz = _frequencies(log, camera, given)
    target = _target(log, config.target if config else logged_targets(log).shown)
    reference = _Reference(target, mount, truth, frequencies_hz)
    try:
        pixels = [
            (number, *found)
            for number, frame in enumerate(pmd_frames(log, camera))
            if (found := reference.compare(frame)) is not None
        ]
    except DistortionError as error:
        raise CalibrationError(f"{name}: {error}") from error
    if not pixels:
        raise CalibrationError(f"{name}: {reference.why_nothing(camera)}")
    number, true_m, error_m = zip(*pixels, strict=True)
    return DepthSamples(
        modulation_frequency_hz=frequencies_hz,
        target=target.name,
        logs=(name,),
        true_m=np.concatenate(true_m),
        error_m=np.concatenate(error_m),
        frame=np.repeat(np.array(number, np.int64), [part.size for part in true_m]),
    )


def _frequencies(log: Log, camera: str, given: SensorInput | None) -> tuple[float, ...]:
    info = pmd_info(log, camera)
    if info is not None and info.modulation_frequency_hz.size:
        return tuple(info.modulation_frequency_hz.tolist())
    if isinstance(given, PmdInput) and given.modulation_frequency_hz:
        return given.modulation_frequency_hz
    for entry in _configured_sensors(log, camera):
        field = "dual_frequencies_hz" if entry.get("profile") == "dual" else "modulation_frequency_hz"
        if value := entry.get(field):
            return tuple(np.atleast_1d(value).tolist())
    raise CalibrationError(
        f"{log.paths[0].name}: neither {camera}/info nor the configuration gives modulation_frequency_hz; "
        "let the camera's driver publish its info, or set it for the camera in an estimator's configuration "
        "and give that with --config"
    )


def _configured_sensors(log: Log, camera: str) -> Iterator[dict[str, Any]]:
    for service in log.configuration.values():
        yield from (entry for entry in configured_sensors(service) if entry.get("name") == camera)


def _target(log: Log, name: str | None) -> Target:
    if name is None:
        raise CalibrationError(
            f"{log.paths[0].name}: no configuration in the log names the target; give an estimator's with "
            "--config, or run the estimator beside the logger"
        )
    try:
        return load_target(name)
    except TargetError as error:
        raise CalibrationError(f"{log.paths[0].name}: {error}") from error


def _truth(log: Log) -> Track:
    odometry = sorted(log.odometry(TRUTH), key=lambda entry: entry.stamp_ns)
    if not odometry:
        raise NoTruthError(log.paths[0].name, TRUTH.name)
    if foreign := {entry.frame_id for entry in odometry} - {CHASER}:
        raise CalibrationError(
            f"{log.paths[0].name}: the truth is in frame {min(foreign)!r}, not in {CHASER!r}: let its "
            f"publisher send the target's pose in {CHASER!r}"
        )
    poses = RigidTransform.concatenate([entry.pose for entry in odometry])
    return Track(np.array([entry.stamp_ns for entry in odometry], np.int64), poses)


class _Reference:
    """Computes the true distance of every pixel."""

    def __init__(
        self, target: Target, T_chaser_sensor: RigidTransform, truth: Track, frequencies_hz: tuple[float, ...]
    ) -> None:
        self._target, self._T_sensor_chaser, self._truth = target, T_chaser_sensor.inv(), truth
        self._plane = _planes(target)
        one = len(frequencies_hz) == 1  # with two frequencies, the camera has unwrapped the distances
        self._interval_m = unambiguous_range_m(frequencies_hz[0]) if one else np.inf
        self._seen: tuple[Camera, RayGrid] | None = None
        self._most_gap_ns = calibration_gap_ns(truth)
        self._frames = self._without_truth = 0

    def compare(self, frame: PmdFrame) -> tuple[FloatArray, FloatArray] | None:
        """Return true distance and error of a frame's usable pixels; None without such pixels or truth."""
        poses, known = interpolate(self._truth, np.array([frame.stamp_ns]), self._most_gap_ns)
        self._frames += 1
        if not known[0]:
            self._without_truth += 1
            return None
        rays = self._rays(frame.camera)
        T_sensor_target = self._T_sensor_chaser * poses[0]
        hits = cast(rays, self._target.triangles_m, T_sensor_target)
        good = np.flatnonzero(self._on_a_face(hits, rays, T_sensor_target) & _well_lit(frame, hits))
        if not good.size:
            return None
        good = good[np.linspace(0, good.size - 1, min(good.size, _MOST_IN_FRAME)).astype(np.intp)]
        true_m = hits.range_m.ravel()[good].astype(np.float64)
        error_m = frame.depth_m.ravel()[good] / rays.components[2].ravel()[good] - true_m
        if np.isfinite(self._interval_m):
            error_m -= self._interval_m * np.rint(error_m / self._interval_m)
        return true_m, error_m

    def why_nothing(self, camera: str) -> str:
        """Return why none of the frames so far contributed."""
        if not self._frames:
            return f"no complete frame of {camera!r}; log its depth and its camera_info"
        between = (
            f"{self._without_truth} of its {self._frames} frames are not between two poses of the truth at "
            f"most {self._most_gap_ns / 1e6:.0f} ms apart"
        )
        if self._without_truth == self._frames:
            remedy = "log the truth without gaps and by the same clock"
            return f"no frame of {camera!r} has truth: {between}; {remedy}"
        told = f" ({between})" if self._without_truth else ""
        return f"no frame of {camera!r} shows a face of the target at the true pose{told}; check the mount"

    def _rays(self, camera: Camera) -> RayGrid:
        if self._seen is None or repr(self._seen[0]) != repr(camera):
            self._seen = camera, RayGrid.pinhole(camera)
        return self._seen[1]

    def _on_a_face(self, hits: Hits, rays: RayGrid, T_sensor_target: RigidTransform) -> BoolArray:
        met = hits.triangle >= 0
        plane = np.where(met, self._plane[hits.triangle], -1)
        least = minimum_filter(plane, _SAME_PLANE_PX, mode="constant", cval=-1)
        most = maximum_filter(plane, _SAME_PLANE_PX, mode="constant", cval=-1)
        normals = T_sensor_target.rotation.apply(self._target.normals)
        cosine = -np.einsum("kij,ijk->ij", rays.components, normals[hits.triangle])
        square_on: BoolArray = met & (least == most) & (cosine >= _LEAST_COSINE)
        return square_on


def _planes(target: Target) -> NDArray[np.intp]:
    """Return the number of each triangle's plane, shape (T,)."""
    distance_m = np.einsum("ij,ij->i", target.normals, target.triangles_m[:, 0])
    plane = np.round(np.column_stack((target.normals, distance_m)), 3)
    return np.unique(plane, axis=0, return_inverse=True)[1].reshape(-1)


def _well_lit(frame: PmdFrame, hits: Hits) -> BoolArray:
    lit: BoolArray = np.isfinite(frame.depth_m) & (frame.depth_m > 0.0)
    on_target = lit & (hits.triangle >= 0)
    if frame.amplitude is None or not on_target.any():
        return lit
    lit &= frame.amplitude >= _LEAST_AMPLITUDE * np.median(frame.amplitude[on_target])
    if frame.info is not None:
        lit &= frame.amplitude <= _MOST_SATURATION * frame.info.saturation_count
    return lit
