"""The self-check of a scan's registration: the target is cast at the pose and compared with each ray.

Returns that the pose does not predict count against it, and so do predicted returns that are missing: a pose
that aligns few points with the wrong faces predicts returns that the scan does not have.
"""

from math import radians

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import NEAREST_M, Hits, RayGrid, cast
from rpod_pose.lidar.paper_2015.scan_lengths import agreeing_m
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.registration.brightness import albedos
from rpod_schemas.config.lidar.methods import ScanComparisonConfig
from rpod_schemas.types import LidarScan
from rpod_target import Target


class ScanComparison:
    """Compares organised scans of one pattern with the model.

    Each ray is cast with four neighbours at a margin. A return is predicted with certainty if all five meet
    the target, a miss if none does; ranges may lie anywhere between those of the five.
    """

    def __init__(self, config: ScanComparisonConfig, target: Target, pattern: ScanPattern) -> None:
        self._config, self._target = config, target
        self._tolerance_m = agreeing_m(config, pattern)
        azimuth_rad, elevation_rad = pattern.azimuth_rad, pattern.elevation_rad
        self._shape = (elevation_rad.size, azimuth_rad.size)
        self._albedo = albedos(target)
        margin_rad = radians(config.margin_deg)
        self._grid = pattern.grid
        self._beside = [
            RayGrid.azimuth_elevation(
                azimuth_rad + across * margin_rad, elevation_rad + down * margin_rad, pattern.row_azimuth_rad
            )
            for across, down in ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))
        ]

    def explained_share(self, scan: LidarScan, T_sensor_target: RigidTransform) -> float:
        """Return the share of agreeing rays among those with a measured or predicted return.

        It is NaN for a scan that is not organised in the pattern's rows and columns.
        """
        if scan.points_m.shape[:-1] != self._shape:
            return float("nan")
        tolerance_m, triangles_m = self._tolerance_m, self._target.triangles_m
        hits = cast(self._grid, triangles_m, T_sensor_target)
        beside_m = [cast(grid, triangles_m, T_sensor_target).range_m for grid in self._beside]
        range_m = np.stack((hits.range_m, *beside_m))
        nearest_m, farthest_m = range_m.min(axis=0), np.where(range_m < np.inf, range_m, 0.0).max(axis=0)
        measured_m = np.linalg.norm(scan.points_m, axis=-1)
        measured_m[~(measured_m > NEAREST_M)] = np.nan
        agrees = (measured_m > nearest_m - tolerance_m) & (measured_m < farthest_m + tolerance_m)
        missing = np.isnan(measured_m) & (range_m < np.inf).all(axis=0) & self._bright(hits, T_sensor_target)
        counted = np.count_nonzero(np.isfinite(measured_m) | missing)
        return np.count_nonzero(agrees) / counted if counted else float("nan")

    def _bright(self, hits: Hits, T_sensor_target: RigidTransform) -> NDArray[np.bool_]:
        """Return which rays meet a surface that certainly gives a return, shape (rows, columns)."""
        normals = T_sensor_target.rotation.apply(self._target.normals)
        cos_incidence = np.abs((normals[hits.triangle] * self._grid.directions).sum(axis=-1))
        echo = self._albedo[hits.triangle] * cos_incidence / hits.range_m.astype(np.float64) ** 2
        bright: NDArray[np.bool_] = echo > self._config.sure_range_m**-2
        return bright
