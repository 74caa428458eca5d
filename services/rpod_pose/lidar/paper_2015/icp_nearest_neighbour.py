"""ICP of measured points with the target's surface, from a predicted pose.

Source: P. J. Besl, N. D. McKay, A Method for Registration of 3-D Shapes, IEEE PAMI 14 (1992), as
Opromolla et al., Sensors 15(3), 2015, section 4.2 use it. Each measured point is matched, exactly and among
the faces that the sensor can see, by one of two matchers:

``nearest_neighbour`` takes the closest point of the surface.

``normal_shooting`` takes the closest foot of a normal of the surface that passes through the point; a point
above no face has no match. From a rough start, points beside their own face are matched with another face
behind it, so that this matcher fails more often (section 4.4).

There are two metrics:

``point_to_point`` is the paper's: the rigid motion that minimises the squared distances of the pairs,
in closed form. Points hardly slide along a face, so that it converges slowly and may stop early.

``point_to_plane`` counts only the distance along the line that joins a pair, which on a face is the face's
normal and at an edge points to the edge: faces slide, and a few Gauss-Newton steps converge. A small weight
on the points' own motion keeps motions that no face determines at the prediction.
"""

from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.kernels import kernel
from rpod_pose.acceptance import accepted_by_residuals
from rpod_pose.lidar.paper_2015.scan_check import ScanComparison
from rpod_pose.lidar.paper_2015.scan_lengths import ScanLengths
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.ports import Registration
from rpod_pose.registration.closest_point import Surface
from rpod_pose.registration.lie_group import Vector
from rpod_pose.registration.normal_equations import (
    NormalEquations,
    add_residual,
    information_of,
    no_sums,
)
from rpod_schemas.arrays import MAD_TO_SIGMA, FloatArray
from rpod_schemas.config.lidar.methods import IcpNearestNeighbourConfig
from rpod_schemas.types import LidarScan, Source
from rpod_target import Target

ON_SURFACE_M = 1e-6
"""Distance below which the face's normal replaces the direction to the closest point. Numerics: a thousandth
of any range error."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Points with their closest points on the surface, in target axes."""

    points_m: FloatArray
    """Measured points, shape (N, 3)."""
    closest_m: FloatArray
    """Closest points on the surface, shape (N, 3)."""
    normals: FloatArray
    """Normals of the faces of the closest points, shape (N, 3)."""
    inlier: NDArray[np.bool_]
    """Mask of the inliers, shape (N,); points without a match are not inliers."""

    @property
    def inliers(self) -> int:
        """Number of inliers."""
        return int(np.count_nonzero(self.inlier))

    @property
    def cost_m2(self) -> float:
        """f_CONV: mean squared distance of the inliers."""
        offsets_m = (self.points_m - self.closest_m)[self.inlier]
        return float((offsets_m**2).sum(axis=1).mean())

    def point_to_point(self) -> RigidTransform:
        """Return the motion of the target that minimises the inliers' squared distances (Kabsch)."""
        points, closest = self.points_m[self.inlier], self.closest_m[self.inlier]
        mean, closest_mean = points.mean(axis=0), closest.mean(axis=0)
        U, _, Vt = np.linalg.svd((points - mean).T @ (closest - closest_mean))
        R = Rotation.from_matrix(U @ np.diag((1.0, 1.0, np.linalg.det(U @ Vt))) @ Vt)
        return RigidTransform.from_components(mean - R.apply(closest_mean), R)

    def point_to_plane(self, resistance: float) -> RigidTransform:
        """Return the Gauss-Newton step of the inliers' distances along the lines that join the pairs."""
        offsets_m = self.points_m - self.closest_m
        distance_m = np.linalg.norm(offsets_m, axis=1, keepdims=True)
        lines = np.where(
            distance_m > ON_SURFACE_M, offsets_m / np.maximum(distance_m, ON_SURFACE_M), self.normals
        )
        sums = plane_equations(self.points_m, offsets_m, lines, self.inlier, resistance)
        equations = NormalEquations.of(sums, weight=self.inliers, squares_m2=0.0, inliers=self.inliers)
        step = equations.step()
        return RigidTransform.from_components(step[:3], Rotation.from_rotvec(step[3:]))

    def information(self) -> FloatArray:
        """Return the information about (dtau, dtheta) of distances along the normals, unit sigma, (6, 6)."""
        zeros = np.zeros_like(self.points_m)
        return information_of(plane_equations(self.points_m, zeros, self.normals, self.inlier, 0.0), 6)


@kernel
def plane_equations(
    points: FloatArray, offsets: FloatArray, lines: FloatArray, inlier: NDArray[np.bool_], resistance: float
) -> FloatArray:
    """Return the sums, shape (35,), of the offsets along lines.

    Args:
        points: measured points, target axes, shape (N, 3), m.
        offsets: vectors from the closest points to them, shape (N, 3), m.
        lines: unit vectors, shape (N, 3).
        inlier: mask of the points that count, shape (N,).
        resistance: weight of each point's own motion, along any axis, which a step minimises too.
    """
    sums = no_sums()
    x_axis, y_axis, z_axis = Vector(1.0, 0.0, 0.0), Vector(0.0, 1.0, 0.0), Vector(0.0, 0.0, 1.0)
    for n in range(points.shape[0]):
        if not inlier[n]:
            continue
        place = Vector(points[n, 0], points[n, 1], points[n, 2])
        line = Vector(lines[n, 0], lines[n, 1], lines[n, 2])
        residual = line.x * offsets[n, 0] + line.y * offsets[n, 1] + line.z * offsets[n, 2]
        add_residual(sums, x_axis, place, 0.0, resistance)
        add_residual(sums, y_axis, place, 0.0, resistance)
        add_residual(sums, z_axis, place, 0.0, resistance)
        add_residual(sums, line, place, residual, 1.0)
    return sums


class Progress:
    """Decides when the iterations end: converged, without progress, or out of steps."""

    def __init__(self, config: IcpNearestNeighbourConfig, settled_m: float) -> None:
        self._config, self._settled_m = config, settled_m
        self._step_m, self._least_m2, self._least_at = np.inf, np.inf, 0
        self.steps = 0

    def add(self, step_m: float) -> None:
        """Count a step that moved the target's surface by a length."""
        self.steps, self._step_m = self.steps + 1, step_m

    def ended(self, cost_m2: float) -> bool:
        """Return whether to stop at a pose of this cost; at wrong poses the iterations often cycle."""
        if cost_m2 < self._least_m2:
            self._least_m2, self._least_at = cost_m2, self.steps
        converged = self._step_m < self._settled_m
        stuck = self.steps - self._least_at >= self._config.patience
        return converged or stuck or self.steps == self._config.iterations


class NearestNeighbourIcp:
    """Registers scans by ICP: ports.Tracker[LidarScan]."""

    def __init__(self, config: IcpNearestNeighbourConfig, target: Target, pattern: ScanPattern) -> None:
        self._config, self._radius_m = config, target.radius_m
        self._lengths = ScanLengths.of(config, target, pattern)
        self._surface = Surface.of(target.triangles_m, target.normals)
        shooting = config.matcher == "normal_shooting"
        self._match_on_surface = self._surface.projected if shooting else self._surface.closest
        self._comparison = ScanComparison(config.comparison, target, pattern)

    def track(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the scan gives none."""
        config, T = self._config, T_sensor_target
        points_m = measurement.returns_m.astype(np.float64)
        if len(points_m) < config.min_points:
            return _failed(f"{len(points_m)} returns, {config.min_points} needed")
        nearest = np.zeros(len(points_m), np.int32)
        progress = Progress(config, self._lengths.step_m)
        while True:
            matches = self._match(points_m, T, nearest)
            if matches is None:
                return _failed("no face of the target is seen from the sensor", progress.steps)
            if matches.inliers < config.min_points:
                return _failed(f"{matches.inliers} inliers, {config.min_points} needed", progress.steps)
            if progress.ended(matches.cost_m2):
                break
            step = self._step(matches)
            T = T * step
            progress.add(float(np.linalg.norm(step.translation) + self._radius_m * step.rotation.magnitude()))
        registration = Registration(
            Source.LIDAR,
            T_sensor_target=T,
            cost_m2=matches.cost_m2,
            inliers=matches.inliers,
            inlier_share=matches.inliers / len(points_m),
            explained_share=self._comparison.explained_share(measurement, T),
            covariance=self._covariance(matches, T),
            iterations=progress.steps,
        )
        return accepted_by_residuals(registration, config.acceptance, max_cost_m2=self._lengths.max_cost_m2)

    def _match(
        self, points_m: FloatArray, T_sensor_target: RigidTransform, nearest: NDArray[np.int32]
    ) -> Matches | None:
        """Return the matches of points, sensor axes; None if no face is visible. ``nearest`` is updated."""
        T_target_sensor = T_sensor_target.inv()
        facing = self._surface.facing(T_target_sensor.translation)
        if not facing.any():
            return None
        local_m = T_target_sensor.apply(points_m)
        closest_m = self._match_on_surface(local_m, facing, nearest)
        matched, distance_m = nearest >= 0, np.linalg.norm(local_m - closest_m, axis=1)
        spread_m = MAD_TO_SIGMA * float(np.median(distance_m[matched])) if matched.any() else 0.0
        gate_m = max(self._lengths.gate_m, self._config.gate_spread * spread_m)
        return Matches(local_m, closest_m, self._surface.normals[nearest], matched & (distance_m <= gate_m))

    def _step(self, matches: Matches) -> RigidTransform:
        if self._config.metric == "point_to_point":
            return matches.point_to_point()
        return matches.point_to_plane(self._config.resistance)

    def _covariance(self, matches: Matches, T_sensor_target: RigidTransform) -> FloatArray:
        """Return the covariance of (dp, dtheta) in the sensor's fixed axes (ICD section 1), shape (6, 6)."""
        config, lengths = self._config, self._lengths
        variance_m2 = max(lengths.sigma_range_m**2, matches.cost_m2)
        weak = np.repeat((lengths.unobserved_m, radians(config.unobserved_deg)), 3)
        spread = np.linalg.inv(matches.information() / variance_m2 + np.diag(weak**-2))
        to_sensor = np.kron(np.eye(2), T_sensor_target.rotation.as_matrix())
        covariance: FloatArray = to_sensor @ spread @ to_sensor.T
        return covariance


def _failed(reason: str, iterations: int = 0) -> Registration:
    return Registration.none(Source.LIDAR, reason, iterations=iterations)
