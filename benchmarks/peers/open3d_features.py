"""Acquisition by Open3D: fast point feature histograms, matched by RANSAC or by fast global registration."""

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from scipy.spatial.transform import RigidTransform

from peers.benchmark import Register, Scene
from peers.clouds import Cloud, model_cloud, scan_cloud
from rpod_schemas.types import LidarScan

FEATURE_RADIUS = 5.0
"""In spacings of the returns; of 3, 5 and 8."""
RANSAC_DISTANCE, FGR_DISTANCE = 0.75, 0.75
"""Largest distance of a match, in spacings; of 0.75 and 1.5."""
SIDE_SIMILARITY = 0.9
RANSAC_POINTS = 3
RANSAC_CRITERIA = o3d.pipelines.registration.RANSACConvergenceCriteria(100_000, 0.999)
MIN_POINTS = 10
"""Fewer returns have no features."""

SETUP = (
    f"scan normals by 8 neighbours, turned to the sensor; model at the scan's spacing; FPFH radius "
    f"{FEATURE_RADIUS:g} spacings (tuned)"
)
RANSAC_SETUP = f"{SETUP}; 3 points, sides 0.9, distance {RANSAC_DISTANCE:g} (tuned), 100,000 at 0.999"
FGR_SETUP = f"{SETUP}; distance {FGR_DISTANCE:g} spacings (nothing tuned made a difference)"


@dataclass(frozen=True, eq=False)
class _Described:
    cloud: o3d.geometry.PointCloud
    features: o3d.pipelines.registration.Feature


def _described(cloud: Cloud, spacing_m: float) -> _Described:
    points = cloud.open3d()
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=FEATURE_RADIUS * spacing_m, max_nn=100)
    return _Described(points, o3d.pipelines.registration.compute_fpfh_feature(points, search))  # type: ignore[call-arg]


def ransac(scene: Scene) -> Register[LidarScan]:
    """Return FPFH with RANSAC."""
    registration, distance_m = o3d.pipelines.registration, RANSAC_DISTANCE * scene.spacing_m
    model = _described(model_cloud(scene.target, scene.spacing_m), scene.spacing_m)
    checkers = [
        registration.CorrespondenceCheckerBasedOnEdgeLength(SIDE_SIMILARITY),
        registration.CorrespondenceCheckerBasedOnDistance(distance_m),
    ]

    def register(scan: LidarScan, _: RigidTransform) -> RigidTransform | None:
        if len(scan.returns_m) < MIN_POINTS:
            return None
        o3d.utility.random.seed(0)
        seen = _described(scan_cloud(scan), scene.spacing_m)
        result = registration.registration_ransac_based_on_feature_matching(
            seen.cloud,
            model.cloud,
            seen.features,
            model.features,
            False,
            distance_m,
            registration.TransformationEstimationPointToPoint(False),
            RANSAC_POINTS,
            checkers,
            RANSAC_CRITERIA,
        )
        return _sensor_target(result)

    return register


def fast_global(scene: Scene) -> Register[LidarScan]:
    """Return FPFH with fast global registration (Zhou, Park, Koltun, ECCV 2016)."""
    registration = o3d.pipelines.registration
    model = _described(model_cloud(scene.target, scene.spacing_m), scene.spacing_m)
    option = registration.FastGlobalRegistrationOption(
        maximum_correspondence_distance=FGR_DISTANCE * scene.spacing_m, iteration_number=64
    )

    def register(scan: LidarScan, _: RigidTransform) -> RigidTransform | None:
        if len(scan.returns_m) < MIN_POINTS:
            return None
        o3d.utility.random.seed(0)
        seen = _described(scan_cloud(scan), scene.spacing_m)
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):  # few matches: not news
            result = registration.registration_fgr_based_on_feature_matching(
                seen.cloud, model.cloud, seen.features, model.features, option
            )
        return _sensor_target(result)

    return register


def _sensor_target(result: o3d.pipelines.registration.RegistrationResult) -> RigidTransform | None:
    """Return the pose of a result that maps the scan onto the model; None where nothing matched."""
    if not len(result.correspondence_set) or np.array_equal(result.transformation, np.eye(4)):
        return None
    return RigidTransform.from_matrix(np.asarray(result.transformation)).inv()
