"""Tracking by Open3D's ICP."""

import numpy as np
import open3d as o3d
from scipy.spatial.transform import RigidTransform

from peers.benchmark import Register, Returns, Scene
from peers.clouds import Cloud, model_cloud, seen_from

POINT_SPACING_M, PLANE_SPACING_M = 0.1, 0.2
"""Spacing of the model's points; the best of 0.1, 0.2 and 0.35."""
POINT_DISTANCE_M, PLANE_DISTANCE_M = 1.0, 0.5
"""Largest distance of a pair; of 0.5, 1, 2 and 3."""
CRITERIA = o3d.pipelines.registration.ICPConvergenceCriteria(1e-6, 1e-6, 100)

SETUP = "model points that face the sensor, every {:g} m (tuned), pairs to {:g} m (tuned), 100 iterations"
POINT_SETUP = SETUP.format(POINT_SPACING_M, POINT_DISTANCE_M)
PLANE_SETUP = SETUP.format(PLANE_SPACING_M, PLANE_DISTANCE_M)
Estimation = o3d.pipelines.registration.TransformationEstimation
POINTS: Estimation = o3d.pipelines.registration.TransformationEstimationPointToPoint(False)
PLANES: Estimation = o3d.pipelines.registration.TransformationEstimationPointToPlane()


def point_to_point(scene: Scene) -> Register[Returns]:
    """Return ICP with the distances of the points."""
    return icp(model_cloud(scene.target, POINT_SPACING_M), POINT_DISTANCE_M, POINTS)


def point_to_plane(scene: Scene) -> Register[Returns]:
    """Return ICP with the distances along the model's normals."""
    return icp(model_cloud(scene.target, PLANE_SPACING_M), PLANE_DISTANCE_M, PLANES)


def icp(model: Cloud, distance_m: float, estimation: Estimation) -> Register[Returns]:
    """Return ICP to what of a model faces the sensor, with pairs up to a distance."""

    def register(scan: Returns, start: RigidTransform) -> RigidTransform | None:
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
