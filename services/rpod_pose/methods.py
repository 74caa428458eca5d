"""From configuration to methods: what each sensor is acquired and tracked with."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.lidar.global_search import GlobalSearch
from rpod_pose.lidar.paper_2015.icp_nearest_neighbour import NearestNeighbourIcp
from rpod_pose.lidar.paper_2015.template_matching import OnlineTemplateMatching
from rpod_pose.lidar.projective_icp import ProjectiveIcp
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.pmd.depth_preparation import DepthPreparation, PreparedAcquirer, PreparedTracker
from rpod_pose.pmd.joint.tracker import JointTracker
from rpod_pose.pmd.paper_2018.epnp import EpnpTracker
from rpod_pose.pmd.paper_2018.hybrid import HybridTracker
from rpod_pose.pmd.paper_2018.icp_reverse_calibration import ReverseCalibrationIcp
from rpod_pose.pmd.signed_distance import SignedDistanceTracker
from rpod_pose.pmd.view_search import ViewSearch
from rpod_pose.ports import Acquirer, Methods, Tracker
from rpod_pose.search.verified_search import VerifiedSearch
from rpod_schemas.config.estimator import LidarInput, PmdInput, SensorInput
from rpod_schemas.config.lidar_search import GlobalSearchConfig, ProjectiveIcpConfig
from rpod_schemas.config.pmd_amplitude import EpnpConfig, HybridConfig
from rpod_schemas.config.pmd_joint import JointConfig
from rpod_schemas.config.pmd_methods import IcpReverseCalibrationConfig, SignedDistanceConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera, LidarScan, PmdFrame, PmdInfo
from rpod_target import Target

_WRAPPING = PmdInfo(
    modulation_frequency_hz=np.array([20e6]),
    integration_time_s=0.016,
    electrons_per_count=1.0,
    saturation_count=4096.0,
)
"""Of a camera whose distances are to be unwrapped."""


def pmd_methods(sensor: PmdInput, target: Target) -> Methods:
    """Return the methods for a PMD camera."""
    tracker = _pmd_tracker(sensor, target)
    finisher = tracker
    if not isinstance(tracker, JointTracker):
        finisher = JointTracker(JointConfig(), target, calibrated=sensor.calibration is not None)
    acquirer = ViewSearch(sensor.acquisition, target, finisher)
    preparation = DepthPreparation(sensor, target)
    return Methods(PreparedAcquirer(acquirer, preparation), PreparedTracker(tracker, preparation))


def _pmd_tracker(sensor: PmdInput, target: Target) -> Tracker[PmdFrame]:
    match sensor.tracking:
        case JointConfig() as config:
            return JointTracker(config, target, calibrated=sensor.calibration is not None)
        case IcpReverseCalibrationConfig() as config:
            return ReverseCalibrationIcp(config, target)
        case SignedDistanceConfig() as config:
            return SignedDistanceTracker(config, target)
        case EpnpConfig() as config:
            return EpnpTracker(config, target)
        case HybridConfig() as config:
            return HybridTracker(config, target)


def lidar_methods(sensor: LidarInput, target: Target, pattern: ScanPattern) -> Methods:
    """Return the methods for a LIDAR with a known scan pattern."""
    rays = {"azimuth_rad": pattern.azimuth_rad, "elevation_rad": pattern.elevation_rad}
    tracker: Tracker[LidarScan]
    if isinstance(sensor.tracking, ProjectiveIcpConfig):
        tracker = ProjectiveIcp(sensor.tracking, target, **rays)
    else:
        tracker = NearestNeighbourIcp(sensor.tracking, target, **rays)
    acquirer: Acquirer[LidarScan]
    if isinstance(sensor.acquisition, GlobalSearchConfig):
        acquirer = GlobalSearch(sensor.acquisition, target, **rays)
    else:
        search = OnlineTemplateMatching(sensor.acquisition, target, **rays)
        acquirer = VerifiedSearch(search, tracker, sensor.acquisition.choice)
    return Methods(acquirer, tracker)


def configured_pattern(sensor: SensorInput) -> ScanPattern | None:
    """Return the scan pattern that the configuration tells."""
    if not isinstance(sensor, LidarInput) or sensor.azimuth_rad is None or sensor.elevation_rad is None:
        return None
    return ScanPattern(sensor.azimuth_rad, sensor.elevation_rad)


def warm_up(methods: Methods, target: Target, pattern: ScanPattern | None) -> None:
    """Run the methods on an ideal view, so that compiled code is loaded before the first frame."""
    away_m = 3.0 * target.radius_m + 1.0
    T_sensor_target = make_pose(translation_m=[0.0, 0.0, away_m])
    views: Sequence[LidarScan | PmdFrame]
    if pattern:
        views = (_ideal_scan(target, T_sensor_target, pattern),)
    else:
        views = _ideal_frames(target, T_sensor_target)
    methods.acquirer.acquire(views[0])
    for data in views:
        methods.tracker.track(data, T_sensor_target)


def _ideal_scan(target: Target, T_lidar_target: RigidTransform, pattern: ScanPattern) -> LidarScan:
    grid = RayGrid.azimuth_elevation(pattern.azimuth_rad, pattern.elevation_rad)
    hits = cast(grid, target.triangles_m, T_lidar_target)
    range_m = np.where(np.isfinite(hits.range_m), hits.range_m, np.nan)
    points_m = (range_m[..., None] * grid.directions).astype(np.float32)
    return LidarScan(stamp_ns=0, frame_id="", points_m=points_m)


def _ideal_frames(target: Target, T_optical_target: RigidTransform) -> tuple[PmdFrame, PmdFrame]:
    """Return a frame without and with what tells how to unwrap its distances."""
    camera = Camera(width=352, height=287, fx=682.75, fy=691.42, cx=175.5, cy=143.0)
    grid = RayGrid.pinhole(camera)
    hits = cast(grid, target.triangles_m, T_optical_target)
    range_m = np.where(np.isfinite(hits.range_m), hits.range_m, np.nan)
    depth_m = (range_m * grid.directions[..., 2]).astype(np.float32)
    amplitude = np.where(depth_m > 0.0, 1000, 0).astype(np.uint16)
    for image in (depth_m, amplitude):
        image.setflags(write=False)  # as off the bus: compiled code is another for what may be written to
    frame = PmdFrame(stamp_ns=0, frame_id="", depth_m=depth_m, amplitude=amplitude, camera=camera)
    return frame, frame.model_copy(update={"info": _WRAPPING})
