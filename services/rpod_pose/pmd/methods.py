"""The PMD camera's methods under their names in the registry, each with the preparation of its depth."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.errors import DistortionError
from rpod_geometry.rays import RayGrid, cast
from rpod_pose.pmd.depth_preparation import (
    DepthPreparation,
    PreparedAcquirer,
    PreparedTracker,
    prepared_likelihoods,
)
from rpod_pose.pmd.depth_view import DepthView
from rpod_pose.pmd.joint.tracker import JointTracker
from rpod_pose.pmd.other_things import PmdFrames
from rpod_pose.pmd.paper_2018.epnp import EpnpTracker
from rpod_pose.pmd.paper_2018.hybrid import HybridTracker
from rpod_pose.pmd.paper_2018.icp_reverse_calibration import ReverseCalibrationIcp
from rpod_pose.pmd.signed_distance import SignedDistanceTracker
from rpod_pose.pmd.view_search import ViewSearch
from rpod_pose.ports import (
    Acquirer,
    ComparingAcquirer,
    ComparingTracker,
    KindMethods,
    Methods,
    Task,
    Tracker,
)
from rpod_pose.surroundings.acquirer import AcquirerAmongThings
from rpod_pose.surroundings.tracker import TrackerAmongThings
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.config.pmd.amplitude import EpnpConfig, HybridConfig
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.config.pmd.methods import IcpReverseCalibrationConfig, SignedDistanceConfig
from rpod_schemas.config.pmd.search import PmdAcquisitionConfig
from rpod_schemas.sensors import method
from rpod_schemas.types import Camera, Float32Array, PmdFrame, PmdInfo
from rpod_target import Target

_WRAPPING = PmdInfo(
    modulation_frequency_hz=np.array([20e6]),
    integration_time_s=0.016,
    electrons_per_count=1.0,
    saturation_count=4096.0,
)
"""Info of a camera whose distances must be unwrapped, for the warm-up."""
_STRIDE = 4
"""Stride of the view from which the rays of all pixels are read. Numerics: any value gives the same rays."""
LEAST_BIAS_M = 0.001
"""Least standard deviation of the bias after a calibration, m. Hand: no calibration stays more accurate for
long."""


def view_search(config: PmdAcquisitionConfig, task: Task) -> Acquirer[PmdFrame]:
    """Return the facility's own search; the joint tracker refines its result with any configured tracker."""
    if isinstance(task.tracker, ComparingTracker) and isinstance(task.sensor.tracking, JointConfig):
        return ViewSearch(config, task.target, task.tracker)
    finisher = joint(JointConfig(), task)
    return ViewSearch(config, task.target, TrackerAmongThings(finisher, frames_of(task.sensor), task.target))


def joint(config: JointConfig, task: Task) -> Tracker[PmdFrame]:
    """Return the facility's own tracker; it assumes the remaining range bias that the calibration states."""
    calibration = task.sensor.calibration
    if calibration is not None:
        tuning = config.tuning
        bias_m = max(tuning.depth.shared_bias_m(calibration), LEAST_BIAS_M)
        left = tuning.depth.calibrated.model_copy(update={"bias_m": bias_m})
        depth = tuning.depth.model_copy(update={"calibrated": left})
        config = config.model_copy(update={"tuning": tuning.model_copy(update={"depth": depth})})
    return JointTracker(config, task.target, calibrated=calibration is not None)


def frames_of(sensor: PmdInput) -> PmdFrames:
    """Return the functions that separate a camera's frames into the target and other things."""
    return PmdFrames(max(sensor.range_offset_sigma_m, LEAST_BIAS_M))


def signed_distance(config: SignedDistanceConfig, task: Task) -> Tracker[PmdFrame]:
    """Return the tracker that uses depth alone, in the distance field."""
    return SignedDistanceTracker(config, task.target)


def icp_reverse_calibration(config: IcpReverseCalibrationConfig, task: Task) -> Tracker[PmdFrame]:
    """Return the 2018 paper's tracker by depth."""
    return ReverseCalibrationIcp(config, task.target)


def epnp(config: EpnpConfig, task: Task) -> Tracker[PmdFrame]:
    """Return the 2018 paper's tracker by amplitude."""
    return EpnpTracker(config, task.target)


def hybrid(config: HybridConfig, task: Task) -> Tracker[PmdFrame]:
    """Return the tracker that combines both techniques of the 2018 paper."""
    return HybridTracker(config, task.target)


def _tracker(task: Task) -> Tracker[PmdFrame]:
    tracker: Tracker[PmdFrame] = method("pmd", task.sensor.tracking.kind).built(task.sensor.tracking, task)
    return tracker


def make(task: Task) -> Methods:
    """Return the configured methods for a PMD camera."""
    sensor, alone, separation = task.sensor, _tracker(task), frames_of(task.sensor)
    tracker = TrackerAmongThings(alone, separation, task.target, touching=True)
    task = task.with_tracker(TrackerAmongThings(alone, separation, task.target))
    acquirer = method("pmd", sensor.acquisition.kind).built(sensor.acquisition, task)
    preparation = DepthPreparation(sensor, task.target)
    return Methods(
        PreparedAcquirer(AcquirerAmongThings(acquirer, tracker), preparation),
        PreparedTracker(tracker, preparation),
        likelihoods=prepared_likelihoods(acquirer.log_likelihoods, preparation)
        if isinstance(acquirer, ComparingAcquirer)
        else None,
    )


def make_tracker(task: Task) -> Tracker[PmdFrame]:
    """Return the configured tracker for a PMD camera."""
    tracker = TrackerAmongThings(_tracker(task), frames_of(task.sensor), task.target, touching=True)
    return PreparedTracker(tracker, DepthPreparation(task.sensor, task.target))


def ideal_frames(target: Target, T_optical_target: RigidTransform, _: object) -> tuple[PmdFrame, PmdFrame]:
    """Return a frame without noise twice: without and with the info from which distances are unwrapped."""
    camera = Camera(width=352, height=287, fx=682.75, fy=691.42, cx=175.5, cy=143.0)
    grid = RayGrid.pinhole(camera)
    hits = cast(grid, target.triangles_m, T_optical_target)
    range_m = np.where(np.isfinite(hits.range_m), hits.range_m, np.nan)
    depth_m = (range_m * grid.directions[..., 2]).astype(np.float32)
    amplitude = np.where(depth_m > 0.0, 1000, 0).astype(np.uint16)
    for image in (depth_m, amplitude):
        image.setflags(write=False)  # as from the bus: kernels are compiled separately for read-only arrays
    frame = PmdFrame(stamp_ns=0, frame_id="", depth_m=depth_m, amplitude=amplitude, camera=camera)
    return frame, frame.model_copy(update={"info": _WRAPPING})


def masked(frame: PmdFrame, hit: Callable[[Float32Array], NDArray[np.bool_]]) -> PmdFrame:
    """Return a frame without depth and amplitude in the pixels for whose points a function is true."""
    places_m = _places_m(frame)
    if places_m is None:
        return frame
    on_part = hit(places_m)
    images = {"depth_m": np.where(on_part, np.float32(np.nan), frame.depth_m)}
    if frame.amplitude is not None:
        images["amplitude"] = np.where(on_part, frame.amplitude.dtype.type(0), frame.amplitude)
    for image in images.values():
        image.setflags(write=False)  # as from the bus
    return frame.model_copy(update=images)


def _places_m(frame: PmdFrame) -> Float32Array | None:
    """Return the point of each pixel, optical axes, shape (H, W, 3), m; NaN without depth.

    None if the lens cannot be inverted or has another image size; the methods then report the reason.
    """
    try:
        slopes = DepthView.of(frame.camera, _STRIDE).slopes
    except (DistortionError, ValueError):
        return None
    if slopes.shape[:2] != frame.depth_m.shape:
        return None
    depth_m = frame.depth_m[..., None]
    return np.concatenate((depth_m * slopes.astype(np.float32), depth_m), axis=-1)


def points(frame: PmdFrame) -> Float32Array:
    """Return the points of a frame's pixels with depth, optical axes, shape (N, 3), m."""
    places_m = _places_m(frame)
    if places_m is None:
        return np.zeros((0, 3), np.float32)
    return places_m[np.isfinite(frame.depth_m) & (frame.depth_m > 0.0)]


PMD_METHODS = KindMethods(
    make=make,
    frames=ideal_frames,
    masked=masked,
    separation=lambda sensor, _setup: frames_of(sensor),
    tracker=make_tracker,
    points=points,
)
