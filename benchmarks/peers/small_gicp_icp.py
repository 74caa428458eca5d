"""Tracking by small_gicp (Koide, JOSS 2024)."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import small_gicp  # pyright: ignore[reportMissingImports] - of the peers' own environment
from scipy.spatial.transform import RigidTransform

from peers.benchmark import Register, Returns, Scene
from peers.clouds import model_cloud
from rpod_schemas.arrays import FloatArray
from rpod_target import Target

MODEL_SPACING_M = 0.1
"""Spacing of the model's points; the best of 0.1, 0.2 and 0.35."""
NEIGHBOURS = 10
"""Neighbours of a point, for normals and covariances."""
DISTANCE_M = 1.0
"""Largest distance of a pair; of 0.5, 1 and 2."""
VOXEL_M = 1.5
"""Voxel of VGICP; the best of 0.5, 1, 1.5, 2 and 3."""
ITERATIONS = 100
ROTATION_STEP_RAD, TRANSLATION_STEP_M = 1e-4, 1e-4
"""Where the iterations end."""

SETUP = (
    f"the whole model once, a point every {MODEL_SPACING_M:g} m (tuned; what faces the sensor alone, "
    f"prepared for each scan, is ten times slower), {NEIGHBOURS} neighbours, "
    f"pairs to {DISTANCE_M:g} m (tuned), {ITERATIONS} iterations"
)
VGICP_SETUP = f"{SETUP}, voxels of {VOXEL_M:g} m (tuned)"


@dataclass(frozen=True)
class Setup:
    """What depends on the target's size and on the points' spacing; the defaults are of the LIDAR's scans."""

    spacing_m: float = MODEL_SPACING_M
    distance_m: float = DISTANCE_M
    voxel_m: float = VOXEL_M


SCANS = Setup()


def icp(scene: Scene) -> Register[Returns]:
    """Return point-to-point ICP."""
    return by_points(scene.target, "ICP")


def plane_icp(scene: Scene) -> Register[Returns]:
    """Return point-to-plane ICP."""
    return by_points(scene.target, "PLANE_ICP")


def gicp(scene: Scene) -> Register[Returns]:
    """Return generalised ICP."""
    return by_points(scene.target, "GICP")


def vgicp(scene: Scene) -> Register[Returns]:
    """Return generalised ICP with voxels."""
    return by_voxels(scene.target)


def by_voxels(target: Target, setup: Setup = SCANS) -> Register[Returns]:
    """Return generalised ICP with voxels."""
    voxels = small_gicp.GaussianVoxelMap(setup.voxel_m)
    voxels.insert(_model(target, setup))

    def register(scan: Returns, start: RigidTransform) -> RigidTransform | None:
        source = _cloud(scan.returns_m.astype(np.float64), described=True)
        begin = start.inv().as_matrix()
        return _pose(
            _align(voxels, source, init_T_target_source=begin, max_correspondence_distance=setup.distance_m)
        )

    return register


_align = partial(
    small_gicp.align,
    num_threads=1,
    max_iterations=ITERATIONS,
    rotation_epsilon=ROTATION_STEP_RAD,
    translation_epsilon=TRANSLATION_STEP_M,
)


def by_points(target: Target, kind: str, setup: Setup = SCANS) -> Register[Returns]:
    """Return ICP of a kind to the whole model: ICP, PLANE_ICP or GICP."""
    model = _model(target, setup)
    tree = small_gicp.KdTree(model)

    def register(scan: Returns, start: RigidTransform) -> RigidTransform | None:
        source = _cloud(scan.returns_m.astype(np.float64), described=kind == "GICP")
        begin = start.inv().as_matrix()
        return _pose(
            _align(
                model,
                source,
                tree,
                init_T_target_source=begin,
                registration_type=kind,
                max_correspondence_distance=setup.distance_m,
            )
        )

    return register


def _model(target: Target, setup: Setup) -> small_gicp.PointCloud:
    return _cloud(model_cloud(target, setup.spacing_m).points_m, described=True)


def _cloud(points_m: FloatArray, *, described: bool) -> small_gicp.PointCloud:
    """Return points, ``described`` with their normals and covariances."""
    cloud = small_gicp.PointCloud(points_m)
    if described:
        small_gicp.estimate_normals_covariances(cloud, num_neighbors=NEIGHBOURS)
    return cloud


def _pose(result: small_gicp.RegistrationResult) -> RigidTransform | None:
    matrix = np.asarray(result.T_target_source)
    return RigidTransform.from_matrix(matrix).inv() if np.isfinite(matrix).all() else None
