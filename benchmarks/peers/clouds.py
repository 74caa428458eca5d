"""Points with normals, as the peers take them: of the target's surface, and of a scan."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import open3d as o3d
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import LidarScan
from rpod_target import Target
from rpod_target.build.sampling import sample_evenly
from rpod_target.mesh.topology import areas_m2

NEIGHBOURS = 8
"""Neighbours of a return, for its normal: those around it in the grid of the scan."""


class Cloud(NamedTuple):
    """Points and their outward normals."""

    points_m: FloatArray
    """Shape (N, 3)."""
    normals: FloatArray
    """Unit, shape (N, 3)."""

    def facing(self, sensor_m: FloatArray) -> "Cloud":
        """Return the points whose surface faces the sensor: the back of a thin part would attract."""
        seen = ((sensor_m - self.points_m) * self.normals).sum(axis=1) > 0.0
        return Cloud(self.points_m[seen], self.normals[seen])

    def open3d(self) -> o3d.geometry.PointCloud:
        """Return the cloud as Open3D has it."""
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(self.points_m))
        cloud.normals = o3d.utility.Vector3dVector(self.normals)
        return cloud


@lru_cache(maxsize=8)
def model_cloud(target: Target, spacing_m: float) -> Cloud:
    """Return even samples of the target's surface, one in a square of the spacing, target axes."""
    count = round(float(areas_m2(target.triangles_m).sum()) / spacing_m**2)
    return Cloud(*sample_evenly(target.triangles_m, count, hidden=_none))


def scan_cloud(scan: LidarScan) -> Cloud:
    """Return a scan's returns with normals by their neighbours, turned to the sensor; sensor axes."""
    points_m = scan.returns_m.astype(np.float64)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_m))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS + 1))
    cloud.orient_normals_towards_camera_location(np.zeros(3))
    return Cloud(points_m, np.asarray(cloud.normals))


def seen_from(cloud: Cloud, T_sensor_target: RigidTransform) -> Cloud:
    """Return the part of a model, target axes, that faces the sensor at a pose."""
    return cloud.facing(T_sensor_target.inv().translation)


def _none(points_m: FloatArray, _: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.zeros(len(points_m), np.bool_)
