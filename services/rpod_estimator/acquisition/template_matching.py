"""On-line template matching: which attitude would give a scan most like the measured one?

Source: Opromolla et al., Sensors 15(3), 2015, section 2. The scan's centroid stands for the position;
a template, the ideal scan of the target there, is cast for each attitude of a grid of Euler angles
(321: R_sensor_target = Rz(yaw) Ry(pitch) Rx(roll)), laid on the scan by its centroid, and correlated
by the mean squared distance of nearest neighbours (Eq. 1).
"""

from math import floor, radians

import numpy as np
from numba import njit
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_estimator.ports import Candidate, Candidates
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar_methods import TemplateMatchingConfig
from rpod_schemas.types import LidarScan
from rpod_sim_sensor.geometry import Hits, RayGrid, cast
from rpod_target import Target

BOUND_MARGIN_DEG = 1e-6
"""The bounds of the angles are left out by this, so that both ends of a range are templates."""


class OnlineTemplateMatching:
    """Finds the target in a scan: ports.Search[LidarScan]."""

    def __init__(
        self,
        config: TemplateMatchingConfig,
        target: Target,
        *,
        azimuth_rad: FloatArray,
        elevation_rad: FloatArray,
    ) -> None:
        self._config, self._target = config, target
        self._grid = RayGrid.azimuth_elevation(azimuth_rad, elevation_rad)
        self._attitudes = euler_grid(config.step_deg)

    def search(self, measurement: LidarScan) -> Candidates:
        """Return candidates of distinct attitudes, least mean squared distance first.

        Empty where the scan has too few returns, or where no template has any.
        """
        return self._matched(measurement, self._attitudes, self._config.distinct_deg)

    def near(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Candidates:
        """Return the candidates among the templates within ``near_deg`` of an attitude, neighbours too."""
        away_rad = (T_sensor_target.rotation.inv() * self._attitudes).magnitude()
        close = np.flatnonzero(away_rad <= radians(self._config.near_deg))
        distinct_deg = self._config.step_deg / 2.0
        return (
            self._matched(measurement, self._attitudes[close], distinct_deg) if close.size else Candidates()
        )

    def _matched(self, measurement: LidarScan, attitudes: Rotation, distinct_deg: float) -> Candidates:
        config = self._config
        points_m = measurement.returns_m.astype(np.float64)
        if len(points_m) < config.min_points:
            return Candidates()
        centroid_m = points_m.mean(axis=0)
        spread_m = boresight_distance_m(points_m)
        poses = RigidTransform.from_components(centroid_m, attitudes)
        costs_m2, offsets_m = np.full(len(poses), np.inf), np.zeros((len(poses), 3))
        centred_m, hits = points_m - centroid_m, Hits.of(self._grid)
        for index, pose in enumerate(poses):
            template_m = self._template_m(pose, hits)
            if not len(template_m) or (config.fast and self._unlike(template_m, spread_m)):
                continue
            offsets_m[index] = template_m.mean(axis=0) - centroid_m
            costs_m2[index] = mean_squared_distance(centred_m, template_m - template_m.mean(axis=0))
        if config.centroid_offset:
            poses = RigidTransform.from_components(centroid_m - offsets_m, attitudes)
        best = self._best_distinct(costs_m2, attitudes, distinct_deg)
        found = tuple(Candidate(poses[index], float(costs_m2[index])) for index in best)
        return Candidates(found, templates=len(poses), excluded_share=float(np.mean(~np.isfinite(costs_m2))))

    def _template_m(self, T_sensor_target: RigidTransform, hits: Hits) -> FloatArray:
        """Return the points of the ideal scan, shape (M, 3)."""
        cast(self._grid, self._target.triangles_m, T_sensor_target, out=hits, cull_back_faces=True)
        met = hits.triangle >= 0
        template_m: FloatArray = self._grid.directions[met] * hits.range_m[met, None]
        return template_m

    def _unlike(self, template_m: FloatArray, spread_m: float) -> bool:
        """Return whether the template is spread about the boresight unlike the scan (Eq. 3)."""
        return abs(spread_m - boresight_distance_m(template_m)) > self._config.tau * spread_m

    def _best_distinct(self, costs_m2: FloatArray, attitudes: Rotation, distinct_deg: float) -> list[int]:
        """Return indices of templates, cheapest first, passing over those close to a cheaper one."""
        quaternions = attitudes.as_quat()
        alike = np.cos(radians(distinct_deg) / 2.0)
        chosen: list[int] = []
        for index in np.argsort(costs_m2, kind="stable"):
            if len(chosen) == self._config.candidates or not np.isfinite(costs_m2[index]):
                break
            if not (np.abs(quaternions[chosen] @ quaternions[index]) > alike).any():
                chosen.append(int(index))
        return chosen


def euler_grid(step_deg: float) -> Rotation:
    """Return R_sensor_target over yaw and roll in +-180 and pitch in +-90 deg.

    Both ends are in where the step divides the range; else the grid is centred, so that 40 deg give a
    pitch of -80, -40, 0, 40 and 80 deg.
    """
    full, half = _centred_steps_deg(180.0, step_deg), _centred_steps_deg(90.0, step_deg)
    yaw, pitch, roll = np.meshgrid(full, half, full, indexing="ij")
    return Rotation.from_euler("ZYX", np.stack((yaw, pitch, roll), axis=-1).reshape(-1, 3), degrees=True)


def _centred_steps_deg(bound_deg: float, step_deg: float) -> FloatArray:
    count = floor(2.0 * bound_deg / step_deg + 1e-9) + 1
    steps_deg = (np.arange(count, dtype=np.float64) - (count - 1) / 2.0) * step_deg
    limit_deg = bound_deg - BOUND_MARGIN_DEG
    return np.clip(steps_deg, -limit_deg, limit_deg)


def boresight_distance_m(points_m: FloatArray) -> float:
    """Return D_BOR, the mean distance of points, shape (N, 3), from the boresight (Eq. 2)."""
    return float(np.hypot(points_m[:, 0], points_m[:, 1]).mean())


def mean_squared_distance(points_m: FloatArray, template_m: FloatArray) -> float:
    """Return C, the mean squared distance of points, shape (N, 3), to their nearest ones (Eq. 1)."""
    points = np.ascontiguousarray(points_m.T, dtype=np.float32)
    return float(nearest_squares(points, template_m.astype(np.float32)).mean(dtype=np.float64))


@njit(cache=True, nogil=True)
def nearest_squares(points, template):  # type: ignore[no-untyped-def]
    """Return the squared distance of each point, shape (3, N), to its nearest in the template, shape (M, 3).

    All pairs, in single precision: the inner loop has no branch and no carried minimum, so that it is
    vectorised, which outruns a search tree at these sizes by far.
    """
    x, y, z = points[0], points[1], points[2]
    nearest = np.full(x.size, np.inf, np.float32)
    for m in range(template.shape[0]):
        tx, ty, tz = template[m, 0], template[m, 1], template[m, 2]
        for n in range(x.size):
            square = (x[n] - tx) ** 2 + (y[n] - ty) ** 2 + (z[n] - tz) ** 2
            nearest[n] = square if square < nearest[n] else nearest[n]
    return nearest
