"""Tracking by small_gicp (Koide, JOSS 2024)."""

from functools import partial

import numpy as np
import small_gicp  # pyright: ignore[reportMissingImports] - of the peers' own environment
from scipy.spatial.transform import RigidTransform

from peers.benchmark import Register, Scene
from peers.clouds import model_cloud
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import LidarScan

MODEL_SPACING_M = 0.1
"""Of the model's points; of 0.1, 0.2 and 0.35."""
NEIGHBOURS = 10
"""Of a point, for normals and covariances."""
DISTANCE_M = 1.0
"""Largest distance of a pair; of 0.5, 1 and 2."""
VOXEL_M = 1.5
"""Of VGICP; of 0.5, 1, 1.5, 2 and 3."""
ITERATIONS = 100
ROTATION_STEP_RAD, TRANSLATION_STEP_M = 1e-4, 1e-4
"""Where the iterations end."""

SETUP = (
    f"the whole model once, a point every {MODEL_SPACING_M:g} m (tuned; what faces the sensor alone, "
    f"prepared for each scan, is ten times slower), {NEIGHBOURS} neighbours, "
    f"pairs to {DISTANCE_M:g} m (tuned), {ITERATIONS} iterations"
)
VGICP_SETUP = f"{SETUP}, voxels of {VOXEL_M:g} m (tuned)"


def icp(scene: Scene) -> Register:
    """Return point-to-point ICP."""
    return _by_points(scene, "ICP")


def plane_icp(scene: Scene) -> Register:
    """Return point-to-plane ICP."""
    return _by_points(scene, "PLANE_ICP")


def gicp(scene: Scene) -> Register:
    """Return generalised ICP."""
    return _by_points(scene, "GICP")


def vgicp(scene: Scene) -> Register:
    """Return generalised ICP with voxels."""
    voxels = small_gicp.GaussianVoxelMap(VOXEL_M)
    voxels.insert(_model(scene))

    def register(scan: LidarScan, start: RigidTransform) -> RigidTransform | None:
        source = _cloud(scan.returns_m.astype(np.float64), described=True)
        return _pose(_align(voxels, source, init_T_target_source=start.inv().as_matrix()))

    return register


_align = partial(
    small_gicp.align,
    max_correspondence_distance=DISTANCE_M,
    num_threads=1,
    max_iterations=ITERATIONS,
    rotation_epsilon=ROTATION_STEP_RAD,
    translation_epsilon=TRANSLATION_STEP_M,
)


def _by_points(scene: Scene, kind: str) -> Register:
    model = _model(scene)
    tree = small_gicp.KdTree(model)

    def register(scan: LidarScan, start: RigidTransform) -> RigidTransform | None:
        source = _cloud(scan.returns_m.astype(np.float64), described=kind == "GICP")
        begin = start.inv().as_matrix()
        return _pose(_align(model, source, tree, init_T_target_source=begin, registration_type=kind))

    return register


def _model(scene: Scene) -> small_gicp.PointCloud:
    return _cloud(model_cloud(scene.target, MODEL_SPACING_M).points_m, described=True)


def _cloud(points_m: FloatArray, *, described: bool) -> small_gicp.PointCloud:
    """Return points, ``described`` with their normals and covariances."""
    cloud = small_gicp.PointCloud(points_m)
    if described:
        small_gicp.estimate_normals_covariances(cloud, num_neighbors=NEIGHBOURS)
    return cloud


def _pose(result: small_gicp.RegistrationResult) -> RigidTransform | None:
    matrix = np.asarray(result.T_target_source)
    return RigidTransform.from_matrix(matrix).inv() if np.isfinite(matrix).all() else None
