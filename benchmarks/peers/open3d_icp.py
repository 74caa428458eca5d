"""Tracking by Open3D's ICP."""

import numpy as np
import open3d as o3d
from scipy.spatial.transform import RigidTransform

from peers.benchmark import Register, Scene
from peers.clouds import Cloud, model_cloud, seen_from
from rpod_schemas.types import LidarScan

POINT_SPACING_M, PLANE_SPACING_M = 0.1, 0.2
"""Of the model's points; of 0.1, 0.2 and 0.35."""
POINT_DISTANCE_M, PLANE_DISTANCE_M = 1.0, 0.5
"""Largest distance of a pair; of 0.5, 1, 2 and 3."""
CRITERIA = o3d.pipelines.registration.ICPConvergenceCriteria(1e-6, 1e-6, 100)

SETUP = "model points that face the sensor, every {:g} m (tuned), pairs to {:g} m (tuned), 100 iterations"
POINT_SETUP = SETUP.format(POINT_SPACING_M, POINT_DISTANCE_M)
PLANE_SETUP = SETUP.format(PLANE_SPACING_M, PLANE_DISTANCE_M)
_Estimation = o3d.pipelines.registration.TransformationEstimation


def point_to_point(scene: Scene) -> Register:
    """Return ICP with the distances of the points."""
    estimation = o3d.pipelines.registration.TransformationEstimationPointToPoint(False)
    return _icp(model_cloud(scene.target, POINT_SPACING_M), POINT_DISTANCE_M, estimation)


def point_to_plane(scene: Scene) -> Register:
    """Return ICP with the distances along the model's normals."""
    estimation = o3d.pipelines.registration.TransformationEstimationPointToPlane()
    return _icp(model_cloud(scene.target, PLANE_SPACING_M), PLANE_DISTANCE_M, estimation)


def _icp(model: Cloud, distance_m: float, estimation: _Estimation) -> Register:
    def register(scan: LidarScan, start: RigidTransform) -> RigidTransform | None:
        points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(scan.returns_m.astype(np.float64)))
        result = o3d.pipelines.registration.registration_icp(
            points,
            seen_from(model, start).open3d(),
            distance_m,
            start.inv().as_matrix(),
            estimation,
            CRITERIA,
        )
        return RigidTransform.from_matrix(np.asarray(result.transformation)).inv()

    return register
