"""Tracking in scans by casting the target at a predicted pose: projective point-to-plane ICP.

A few steps in the target's distance field, on some of the returns, bring the pose near the solution; a few
steps to the faces, on all returns, refine it (``scan_alignment``). Where the faces leave a motion open, the
outline determines it (``outline``). The likelihood of the scan at the pose is the self-check (``scan_fit``).
"""

from dataclasses import replace
from math import radians

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_pose.lidar.scan_alignment import (
    FaceProblem,
    ScanErrors,
    add_face_points,
    excess,
    pose_covariance,
)
from rpod_pose.lidar.scan_fit import ScanFit, ScanModel
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.lidar.scan_registration import (
    CHANCE,
    ScanRegistration,
    is_sure,
    neighbourhood,
    reach_of,
    refined,
    settled,
    tracked,
)
from rpod_pose.lidar.scan_view import ScanView, SeenScan
from rpod_pose.ports import Registration
from rpod_pose.registration.field_alignment import FieldProblem, Points
from rpod_pose.registration.lie_group import PoseArrays, stepped
from rpod_pose.registration.model_error import ModelError
from rpod_pose.registration.normal_equations import no_sums
from rpod_pose.registration.surface_model import SurfaceModel, cast_faces
from rpod_pose.search.turns import Placed
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar_search import ProjectiveIcpConfig
from rpod_schemas.poses import pose_of
from rpod_schemas.types import LidarScan, Source
from rpod_target import Target


class ProjectiveIcp:
    """Registers scans: ports.Tracker[LidarScan].

    Args:
        config: parameters of the tracker.
        target: the target to track.
        pattern: directions of the sensor's rays, and the range error that it states.

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(self, config: ProjectiveIcpConfig, target: Target, pattern: ScanPattern) -> None:
        tuning = config.tuning
        self._tuning = tuning
        weak = np.repeat((target.radius_m, radians(tuning.unobserved_deg)), 3)
        self._weak = np.diag(weak**-2)
        self.view = ScanView.of(pattern.azimuth_rad, pattern.elevation_rad)
        self.surface = SurfaceModel.of(target)
        self.model = ScanModel(
            tuning.model, tuning.verdict, self.view, self.surface, sigma_range_m=pattern.sigma_range_m
        )
        self._errors = ScanErrors(
            self.model.sigma_range_m,
            self.model.assumed.slack_m,
            tuning.steep_cosine**2,
            1.0 / (tuning.outline_sigmas * self.model.sigma_range_m),
        )
        self._model_error = ModelError.of(target)
        self._reach = reach_of(self.view, config, target.radius_m)
        narrowest_m = tuning.narrowest_sigmas * self.model.sigma_range_m
        widest_m = max(tuning.widest_share * target.radius_m, narrowest_m)
        middle_m = np.sqrt(widest_m * narrowest_m)
        self._far = np.geomspace(widest_m, middle_m, tuning.coarse_steps)
        self._near = np.geomspace(middle_m, narrowest_m, tuning.fine_steps)

    def track(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the scan gives none."""
        seen = self.view.seen(measurement)
        if seen.returns < self._tuning.min_points:
            return _failed(f"{seen.returns} returns, {self._tuning.min_points} needed")
        points = Points.equal(seen.downsampled(self._tuning.points))
        far = FieldProblem(points, self.surface.coarse_field, self._far)
        start = PoseArrays.of(T_sensor_target)
        problem = self._problem(seen)
        found = tracked(far, problem, start, seen.range_m, self.model.assumed, self._reach)
        usable = bool(seen.range_m.any() and np.isfinite(found.information).all())
        if usable and not is_sure(found, seen.returns, self._reach):
            found = self._resumed(seen, problem, found)
        return self._registration(seen, found)

    def _resumed(self, seen: SeenScan, problem: FaceProblem, found: ScanRegistration) -> ScanRegistration:
        """Return a registration from the likeliest of samples around one that may be beside the solution."""
        rough = neighbourhood(found.information, found.pose, self._reach)
        posterior = self.model.posterior(seen, found.pose, rough)
        start = stepped(found.pose, posterior.likeliest)
        other = settled(problem, start, seen.range_m, self.model.assumed, self._reach)
        least = found.statistics.agreement.log_likelihood + CHANCE
        return other if other.statistics.agreement.log_likelihood > least else found

    def finish(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> Registration:
        """Return the registration from a pose R, t, sensor axes, that is close to the solution."""
        problem, start = self._problem(seen), PoseArrays(R, t)
        return self._registration(
            seen, refined(problem, start, seen.range_m, self.model.assumed, self._reach)
        )

    def placed(self, registration: Registration, pose: Placed, information: FloatArray) -> Registration:
        """Return a registration with another pose of the same scan, and the information about it, (6, 6)."""
        covariance = pose_covariance(information + self._weak, pose.R)
        return replace(registration, T_sensor_target=pose_of(pose.R, pose.t), covariance=covariance)

    def _problem(self, seen: SeenScan) -> FaceProblem:
        return FaceProblem(
            seen.points_m,
            seen.rays,
            self.view.grid.arrays,
            self.surface.faces,
            self.surface.coarse_field,
            self._errors,
            self._near,
            self.view.hits.arrays,
        )

    def _registration(self, seen: SeenScan, found: ScanRegistration) -> Registration:
        inliers, squares, (R, t) = found.faces.inliers, found.faces.squares_m2, found.pose
        if inliers < self._tuning.min_points:
            return _failed(f"{inliers} returns on faces, {self._tuning.min_points} needed")
        fit = ScanFit.of(found.statistics)
        covariance = pose_covariance(found.information + self._weak, R)
        if self._model_error.matters:
            covariance = self._considered(seen, found)
        return Registration(
            Source.LIDAR,
            T_sensor_target=pose_of(R, t),
            belief=self.model.belief(seen, R, t, fit),
            cost_m2=squares / inliers,
            inliers=inliers,
            inlier_share=inliers / seen.returns,
            explained_share=fit.agreement.share,
            log_likelihood=fit.log_likelihood,
            covariance=covariance,
            iterations=len(self._far) + len(self._near),
        )

    def _considered(self, seen: SeenScan, found: ScanRegistration) -> FloatArray:
        """Return the covariance of a registration with the errors of the target's model, (6, 6).

        The displacements move the returns on faces; the outline counts as exact within its blur.
        """
        pose, faces = found.pose, found.faces
        problem = self._problem(seen)
        cast_faces(problem.grid, problem.faces, pose.R, pose.t, problem.buffers)
        evidence = add_face_points(no_sums(), problem, pose, self._near[-1])
        whole = evidence.inliers / max(evidence.faded, 1e-6)
        whole /= excess(faces.squares_m2, faces.inliers, problem.errors.sigma_m)
        on_face = evidence.rows[:, 6] > 0.0
        rows, places_m = evidence.rows[on_face], ((seen.points_m - pose.t) @ pose.R)[on_face]
        cells = self._model_error.cells(places_m)
        parts, centres_m = [], []
        for cell in range(int(cells.max(initial=-1)) + 1):
            mine = rows[cells == cell]
            parts.append((mine[:, :6] * (whole * mine[:, 6:])).T @ mine[:, :6])
            centres_m.append(places_m[cells == cell].mean(axis=0))
        covariance: FloatArray = np.linalg.inv(found.information + self._weak).astype(np.float64)
        if parts:
            covariance = self._model_error.considered(covariance, np.array(parts), np.array(centres_m))
        turn = np.kron(np.eye(2), pose.R)
        turned: FloatArray = turn @ covariance @ turn.T
        return turned


def _failed(reason: str) -> Registration:
    return Registration.none(Source.LIDAR, reason)
