"""Tracking in scans by casting the target at a predicted pose: projective point-to-plane ICP.

First, some steps in the target's distance field, on a part of the returns, bring the pose near the solution.
Then some steps to the faces, on all returns, refine it (``scan_alignment``). If the faces do not determine a
direction, the outline does (``outline``). If there are few returns, or if the scan is less likely than at a
right pose, the result is the mean of the posterior, computed from samples near the pose (``posterior``). The
likelihood of the scan at the pose is the self-check (``scan_fit``).

A body that is nearly one of revolution has many optima about its axis, since few rays meet the details that
determine the rotation about it. Therefore the likelihood is evaluated at turns about such an axis. The
likeliest one is taken, and the covariance contains the spread of the others.
"""

from dataclasses import replace
from math import hypot, radians

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import softmax

from rpod_geometry.rays import Hits
from rpod_pose.belief import worst_sigma
from rpod_pose.lidar.outline.other_size import OtherSizes
from rpod_pose.lidar.posterior.sampled_posterior import SPREAD, SampledPosterior
from rpod_pose.lidar.posterior.scan_uncertainty import FaceRows, model_covariance, noise_information
from rpod_pose.lidar.scan_alignment import FaceProblem, ScanErrors, pose_covariance
from rpod_pose.lidar.scan_fit import ScanFit, ScanModel
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.lidar.scan_registration import (
    CHANCE,
    RESUMED,
    ScanRegistration,
    is_sure,
    neighbourhood,
    outline_mean,
    reach_of,
    refined,
    tracked,
)
from rpod_pose.lidar.scan_view import ScanView, SeenScan
from rpod_pose.ports import Registration
from rpod_pose.pose_evidence import ErrorParts
from rpod_pose.registration.field_alignment import FieldProblem, Points
from rpod_pose.registration.lie_group import PoseArrays, stepped
from rpod_pose.registration.model_error import ModelError, Parts
from rpod_pose.registration.surface_model import SurfaceModel
from rpod_pose.search.turns import Placed
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar.search import ProjectiveIcpConfig
from rpod_schemas.poses import pose_of
from rpod_schemas.types import BeliefLevel, LidarScan, Source
from rpod_target import Target

NEARLY_ROUND = 12
"""Least order of a near-symmetry whose axis counts as one of revolution. Hand: its turns are 30 deg or less;
larger turns are rivals."""
NEAR_TURNS_RAD = np.radians(np.linspace(-15.0, 15.0, 13))
"""Turns about such an axis from the prediction. Physics: up to half of the step of the least order."""
VAGUE_DEG = 3.5
"""Largest standard deviation of a believed turn about the axis, deg. Physics: an error of 10 deg then has a
probability of 0.5 %."""
MANY = 70
"""Least number of informative returns with which a scan that is as likely as at a right pose determines the
pose. Hand: with fewer, there are several optima within some standard deviations."""


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
        self._near_axes = [
            np.array(each.axis)
            for each in target.symmetries
            if not each.exact and (each.continuous or each.order >= NEARLY_ROUND)
        ]
        self.view = ScanView.of(pattern.azimuth_rad, pattern.elevation_rad, pattern.row_azimuth_rad)
        self.surface = SurfaceModel.of(target)
        self._model_error = ModelError.of(target)
        self.model = ScanModel(
            tuning.model,
            tuning.acceptance,
            self.view,
            self.surface,
            sigma_range_m=pattern.sigma_range_m,
            tolerance_m=hypot(self._model_error.tolerance_m, self._model_error.scale * target.radius_m),
        )
        self._errors = ScanErrors(
            self.model.sigma_range_m,
            self.model.assumed.slack_m,
            tuning.steep_cosine**2,
            1.0 / (tuning.outline_sigmas * self.model.sigma_range_m),
        )
        self._pieces = Parts.of(target)
        self._reach = reach_of(self.view, config, target.radius_m)
        narrowest_m = tuning.narrowest_sigmas * self.model.sigma_range_m
        widest_m = max(tuning.widest_share * target.radius_m, narrowest_m)
        middle_m = np.sqrt(widest_m * narrowest_m)
        self._far = np.geomspace(widest_m, middle_m, tuning.coarse_steps)
        self._near = np.geomspace(middle_m, narrowest_m, tuning.fine_steps)

    def _turned(
        self, seen: SeenScan, problem: FaceProblem, start: PoseArrays, found: ScanRegistration
    ) -> tuple[ScanRegistration, FloatArray]:
        """Return a registration at its likeliest turn about axes of revolution, and the turns' covariance.

        The turns are ``NEAR_TURNS_RAD`` from the prediction. The covariance is weighted by their likelihoods,
        sensor axes, shape (3, 3), rad2.
        """
        spread = np.zeros((3, 3))
        for axis in self._near_axes:
            angles_rad, logs = self._turns(seen, start, found.pose, axis)
            if logs.max() > _log_likelihood(found) + CHANCE:
                turn = Rotation.from_rotvec(angles_rad[logs.argmax()] * axis).as_matrix()
                begin = PoseArrays(found.pose.R @ turn, found.pose.t)
                other = outline_mean(problem, begin, seen.range_m, self.model.assumed, self._reach)
                usable = bool(np.isfinite(other.information).all())
                if usable and _log_likelihood(other) > _log_likelihood(found) + CHANCE:
                    found = other
                    angles_rad, logs = self._turns(seen, start, found.pose, axis)
            along = found.pose.R @ axis
            spread += float(softmax(logs) @ angles_rad**2) * np.outer(along, along)
        return found, spread

    def _turns(
        self, seen: SeenScan, start: PoseArrays, pose: PoseArrays, axis: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return turns of a pose about an axis, rad, the last one 0, and their log likelihoods, (N,) each."""
        between = Rotation.from_matrix(start.R.T @ pose.R).as_quat()
        from_start_rad = 2.0 * np.arctan2(between[:3] @ axis, between[3])
        angles_rad = np.append(NEAR_TURNS_RAD - from_start_rad, 0.0)
        turns = Rotation.from_rotvec(angles_rad[:, None] * axis).as_matrix()
        fits = (self.model.fit(seen, pose.R @ turn, pose.t) for turn in turns)
        return angles_rad, np.array([fit.log_likelihood for fit in fits])

    def track(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the scan gives none."""
        seen = self.view.seen(measurement)
        found = self._tracked(seen, T_sensor_target)
        cleaned = self.without_false_returns(seen, found)
        if cleaned is None:
            return found
        again = self._tracked(cleaned, T_sensor_target)
        return with_false_returns(again, seen, cleaned) if again.continues_track else found

    def without_false_returns(self, seen: SeenScan, found: Registration) -> SeenScan | None:
        """Return a scan without its false returns if they alone contradict a registration, otherwise None."""
        if found.T_sensor_target is None or found.belief.level is not BeliefLevel.CONTRADICTED:
            return None
        return self.model.without_false_returns(seen, *PoseArrays.of(found.T_sensor_target))

    def _tracked(self, seen: SeenScan, T_sensor_target: RigidTransform) -> Registration:
        if seen.returns < self._tuning.min_points:
            return _failed(f"{seen.returns} returns, {self._tuning.min_points} needed")
        points = Points.equal(seen.downsampled(self._tuning.points))
        far = FieldProblem(points, self.surface.coarse_field, self._far)
        start = PoseArrays.of(T_sensor_target)
        problem = self._problem(seen)
        found = tracked(far, problem, start, seen.range_m, self.model.assumed, self._reach)
        if not ((seen.range_m > 0.0).any() and np.isfinite(found.information).all()):
            return self._registration(seen, found)
        sure = self._is_sure(seen, found)
        if sure:
            found, sure = self._settled(seen, problem, found)
        posterior = None
        if not sure:
            found, posterior = self._resumed(seen, problem, found)
        if not self._near_axes:
            return self._with_sizes(seen, problem, found, self._placed(seen, found, posterior))
        turned, spread = self._turned(seen, problem, start, found)
        registration = self._placed(seen, turned, posterior if turned is found else None)
        return self._with_sizes(seen, problem, turned, _with_least_covariance(registration, spread))

    def _is_sure(self, seen: SeenScan, found: ScanRegistration) -> bool:
        """Return whether a scan surely determines a registration: it is likely, and the returns are many."""
        return is_sure(found, seen.returns, self._reach) and self.model.informative(seen) >= MANY

    def _settled(
        self, seen: SeenScan, problem: FaceProblem, found: ScanRegistration
    ) -> tuple[ScanRegistration, bool]:
        """Return a registration at an optimum, and whether it surely is at one.

        While one of some sampled poses near it is likelier, the registration starts again from that pose.
        """
        for _ in range(RESUMED):
            spread = neighbourhood(found.information, found.pose, self._reach, stretch=1.0)
            start = self.model.more_likely_pose(seen, found.pose, spread)
            if start is None:
                return found, self._is_sure(seen, found)
            other = outline_mean(problem, start, seen.range_m, self.model.assumed, self._reach)
            usable = bool(np.isfinite(other.information).all())
            if not (usable and _log_likelihood(other) > _log_likelihood(found) + CHANCE):
                break
            found = other
        return found, False

    def _with_sizes(
        self, seen: SeenScan, problem: FaceProblem, found: ScanRegistration, registration: Registration
    ) -> Registration:
        """Return a registration with the function for its poses at other sizes, if it continues a track."""
        if not registration.continues_track:
            return registration
        assumed, declared = self.model.assumed, self._model_error.scale
        # Another thread may call them while the next scan is cast.
        apart = problem._replace(buffers=Hits.of(seen.grid).arrays)
        sizes = OtherSizes(apart, found, seen.range_m, assumed, self._reach, declared)
        return replace(registration, other_sizes=sizes)

    def _resumed(
        self, seen: SeenScan, problem: FaceProblem, found: ScanRegistration
    ) -> tuple[ScanRegistration, SampledPosterior | None]:
        """Return a registration that may not have converged to the solution, and the posterior near it.

        Samples near it show which other poses explain the scan. If a few samples have all the weight and one
        of them is likelier, the registration starts again from there. The posterior is None if a few samples
        have all the weight even then.
        """
        for _ in range(RESUMED):
            rough = neighbourhood(found.information, found.pose, self._reach)
            posterior = self.model.posterior(seen, found.pose, rough)
            if posterior.effective >= SPREAD:
                return found, posterior
            start = stepped(found.pose, posterior.likeliest)
            least = _log_likelihood(found) + CHANCE
            if not self.model.fit(seen, *start).log_likelihood > least:
                break
            other = outline_mean(problem, start, seen.range_m, self.model.assumed, self._reach)
            if not _log_likelihood(other) > least:
                break
            found = other
        return found, None

    def _placed(
        self, seen: SeenScan, found: ScanRegistration, posterior: SampledPosterior | None
    ) -> Registration:
        """Return the registration at the mean of the posterior, or as it is if there is no posterior."""
        if posterior is None:
            return self._registration(seen, found)
        mean, fit, covariance = self.model.mean(seen, found.pose, posterior)
        information: FloatArray = np.linalg.inv(covariance).astype(np.float64)
        placed = found._replace(pose=mean, information=information, statistics=fit)
        return self._registration(seen, placed, sampled=True)

    def finish(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> Registration:
        """Return the registration from a pose that is close to the solution.

        Args:
            seen: the scan.
            R: R_sensor_target, shape (3, 3).
            t: position of the target's origin, sensor axes, shape (3,), m.
        """
        problem, start = self._problem(seen), PoseArrays(R, t)
        return self._registration(
            seen, refined(problem, start, seen.range_m, self.model.assumed, self._reach)
        )

    def placed(self, registration: Registration, pose: Placed, information: FloatArray) -> Registration:
        """Return a registration with another pose, whose information has the shape (6, 6)."""
        covariance = pose_covariance(information + self._weak, pose.R)
        return replace(
            registration, T_sensor_target=pose_of(pose.R, pose.t), covariance=covariance, parts=None
        )

    def _problem(self, seen: SeenScan) -> FaceProblem:
        return FaceProblem(
            seen.points_m,
            seen.rays,
            seen.grid.arrays,
            self.surface.faces,
            self.surface.coarse_field,
            self._errors,
            self._near,
            self.view.hits.arrays,
        )

    def _registration(
        self, seen: SeenScan, found: ScanRegistration, *, sampled: bool = False
    ) -> Registration:
        """Return a registration; ``sampled`` states whether its information is that of sampled poses."""
        inliers, squares, (R, t) = found.faces.inliers, found.faces.squares_m2, found.pose
        if inliers < self._tuning.min_points:
            return _failed(f"{inliers} returns on faces, {self._tuning.min_points} needed")
        fit = ScanFit.of(found.statistics)
        parts = self._parts(seen, found, sampled=sampled)
        covariance = pose_covariance(found.information + self._weak, R) + parts.of_model
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
            parts=parts,
            iterations=len(self._far) + len(self._near),
            misfit=self.model.misfit(seen, R, t),
        )

    def _parts(self, seen: SeenScan, found: ScanRegistration, *, sampled: bool) -> ErrorParts:
        """Return the errors of a registration, separated by how long they last."""
        R, rows = found.pose.R, FaceRows.of(self._problem(seen), found)
        of_noise = found.information if sampled else noise_information(rows, found, self._weak)
        white = pose_covariance(of_noise + self._weak, R)
        if not self._model_error.matters:
            return ErrorParts.lasting_model(white, np.zeros((6, 6)))
        alone: FloatArray = np.linalg.inv(found.information + self._weak).astype(np.float64)
        by_model = model_covariance(rows, alone, self._model_error, self._pieces)
        turn = np.kron(np.eye(2), R)
        return ErrorParts.lasting_model(white, turn @ by_model @ turn.T)


def _log_likelihood(found: ScanRegistration) -> float:
    return found.statistics.agreement.log_likelihood


def _with_least_covariance(registration: Registration, spread: FloatArray) -> Registration:
    """Return a registration with the covariance of the turns about its axes added, shape (3, 3), rad2.

    If the turn is too uncertain, the belief is doubtful.
    """
    if registration.T_sensor_target is None:
        return registration
    covariance = registration.covariance.copy()
    covariance[3:, 3:] += spread
    parts = registration.parts
    if parts is not None:
        white = parts.white.copy()
        white[3:, 3:] += spread
        parts = replace(parts, white=white)
    registration = replace(registration, covariance=covariance, parts=parts)
    sigma_deg = float(np.degrees(worst_sigma(spread)))
    if sigma_deg <= VAGUE_DEG or not registration.belief.continues_track:
        return registration
    reason = f"the turn about the axis is undetermined: sigma {sigma_deg:.1f} deg, limit {VAGUE_DEG:g} deg"
    belief = replace(registration.belief, level=BeliefLevel.DOUBTFUL, reason=reason)
    return replace(registration, belief=belief)


def with_false_returns(found: Registration, seen: SeenScan, cleaned: SeenScan) -> Registration:
    """Return a registration in a cleaned scan, whose evidence has the number of false returns."""
    false = {"false_returns": float(seen.returns - cleaned.returns)}
    return replace(found, belief=replace(found.belief, evidence={**found.belief.evidence, **false}))


def _failed(reason: str) -> Registration:
    return Registration.none(Source.LIDAR, reason)
