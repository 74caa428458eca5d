"""On-line template matching: search of the attitude whose ideal scan is most similar to the measured one.

Source: Opromolla et al., Sensors 15(3), 2015, section 2. The scan's centroid is the estimate of the position.
A template, the ideal scan of the target there, is cast for each attitude of a grid of Euler angles
(321: R_sensor_target = Rz(yaw) Ry(pitch) Rx(roll)), aligned with the scan by its centroid, and correlated
by the mean squared distance of nearest neighbours (Eq. 1).

``plain`` casts and correlates all templates. ``fast`` casts all, and correlates those spread about
the boresight like the scan (Eqs. 2, 3). ``cued`` casts and correlates only a share of them, chosen by the
scan's own covariance before anything is cast (``covariance_cue``).
"""

from dataclasses import dataclass
from math import floor, radians

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.lidar.paper_2015.correlation import PackedScan, match_templates, packed
from rpod_pose.lidar.paper_2015.covariance_cue import CovarianceCue
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.ports import Candidate, Candidates
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar.methods import TemplateMatchingConfig
from rpod_schemas.types import LidarScan
from rpod_target import Target

BOUND_MARGIN_DEG = 1e-6
"""Distance of the templates from the bounds of the angles, so that both ends of a range are distinct.
Numerics: far below the step of any grid of templates."""
LEAST_SPREAD_M = 1e-9
"""Least spread of a scan in a division, for one that lies on the boresight. Numerics: it avoids a division by
zero."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A scan compared with templates at its centroid."""

    costs_m2: FloatArray
    """Costs C of Eq. 1, shape (K,); inf for a template that was left out, was abandoned or has no point."""
    centroids_m: FloatArray
    """Centroids of the templates' points, sensor axes, shape (K, 3)."""
    spread_differences: FloatArray
    """|D_BOR of the template - D_BOR of the scan| over the latter (Eq. 3), shape (K,); NaN without points."""


class OnlineTemplateMatching:
    """Finds the target in a scan: ports.Search[LidarScan]."""

    def __init__(self, config: TemplateMatchingConfig, target: Target, pattern: ScanPattern) -> None:
        self._config, self._target = config, target
        self._grid = pattern.grid
        self._attitudes = euler_grid(config.step_deg)
        self._rotations = self._attitudes.as_matrix()
        self._tau = config.tau if config.variant == "fast" else np.inf
        self._cue: CovarianceCue | None = None
        if config.variant == "cued":
            self._cue = CovarianceCue.of(self._grid, target, self._rotations)

    def search(self, measurement: LidarScan) -> Candidates:
        """Return candidates of distinct attitudes, least mean squared distance first.

        The result is empty if the scan has too few returns, or if no template has a point.
        """
        return self._matched(measurement, np.arange(len(self._attitudes)), self._config.distinct_deg)

    def near(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Candidates:
        """Return the candidates among the templates within ``near_deg`` of an attitude, neighbours too."""
        away_rad = (T_sensor_target.rotation.inv() * self._attitudes).magnitude()
        close = np.flatnonzero(away_rad <= radians(self._config.near_deg))
        return self._matched(measurement, close, self._config.step_deg / 2.0)

    def compare(
        self, points_m: FloatArray, which: NDArray[np.intp] | None = None, *, best_only: bool = False
    ) -> Comparison:
        """Compare returns, shape (N, 3), with templates of some attitudes of the grid, or with all.

        Templates that the variant ``fast`` leaves out are not correlated; the cue is not used. With
        ``best_only``, a template is abandoned as soon as it is worse than one before it.
        """
        centroid_m, spread_m = points_m.mean(axis=0), boresight_distance_m(points_m)
        costs_m2, centroids_m, spreads_m = match_templates(
            self._grid.arrays,
            self._target.triangles_m,
            self._rotations if which is None else self._rotations[which],
            PackedScan(centroid_m, packed(points_m - centroid_m), len(points_m), spread_m),
            self._tau,
            best_only,
        )
        differences = np.abs(spreads_m - spread_m) / max(spread_m, LEAST_SPREAD_M)
        return Comparison(costs_m2, centroids_m, differences)

    def _matched(self, measurement: LidarScan, which: NDArray[np.intp], distinct_deg: float) -> Candidates:
        points_m = measurement.returns_m.astype(np.float64)
        if len(points_m) < self._config.min_points or not which.size:
            return Candidates()
        chosen = which
        if self._cue is not None:
            chosen = which[self._cue.most_similar(points_m, which, self._config.cued_share)]
        compared = self.compare(points_m, chosen, best_only=self._config.candidates == 1)
        positions_m = np.broadcast_to(points_m.mean(axis=0), compared.centroids_m.shape)
        if self._config.centroid_offset:
            positions_m = 2.0 * positions_m - compared.centroids_m
        attitudes = self._attitudes[chosen]
        poses = RigidTransform.from_components(positions_m, attitudes)
        best = self._best_distinct(compared.costs_m2, attitudes, distinct_deg)
        correlated = np.count_nonzero(compared.spread_differences <= self._tau)
        return Candidates(
            tuple(Candidate(poses[index], float(compared.costs_m2[index])) for index in best),
            templates=which.size,
            excluded_share=1.0 - correlated / which.size,
        )

    def _best_distinct(self, costs_m2: FloatArray, attitudes: Rotation, distinct_deg: float) -> list[int]:
        """Return indices of templates, least cost first, without those close to a better one."""
        quaternions = attitudes.as_quat()
        least_cosine = np.cos(radians(distinct_deg) / 2.0)
        chosen: list[int] = []
        for index in np.argsort(costs_m2, kind="stable"):
            if len(chosen) == self._config.candidates or not np.isfinite(costs_m2[index]):
                break
            if not (np.abs(quaternions[chosen] @ quaternions[index]) > least_cosine).any():
                chosen.append(int(index))
        return chosen


def euler_grid(step_deg: float) -> Rotation:
    """Return R_sensor_target over yaw and roll in +-180 and pitch in +-90 deg.

    Both ends are included if the step divides the range; if not, the grid is centred, so that 40 deg give a
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
