"""Acquisition in one scan, without a guess: all attitudes are tried, and the likeliest pose is verified.

1. Thousands of attitudes, spread over all of SO(3), are positioned by the centroid that the sensor should
   measure, and compared roughly (``energy``): all of them on a few points, the best ones on more.
2. The best ones are aligned with the scan (``scan_alignment``) and ranked by the likelihood of every ray, hit
   or missed (``scan_fit``). If there are many returns, the first pose that surely explains them ends this
   step.
3. Poses with which the best one may be confused are tried too: its near-symmetries and quarter turns about
   its axes. If the returns are few, or give little information about a small target, all turns of the best
   pose are refined like the pose itself, on the outline and by samples. The poses are then weighted by their
   posterior mass.
4. If the scan is less likely than the best pose predicts, the search is repeated with more attitudes.

The belief in the pose needs no other pose for comparison: it compares the scan's likelihood with the
likelihood that the pose predicts. The weights of the hypotheses are proportional to their posterior masses.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import log, sqrt

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.belief import contradicted, undetermined
from rpod_pose.lidar.posterior.weak_directions import walked, weakest_motions
from rpod_pose.lidar.projective_icp import ProjectiveIcp, with_false_returns
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.lidar.scan_registration import CHANCE
from rpod_pose.lidar.scan_search import Model, Pose, Scanner, ScanSearch
from rpod_pose.lidar.scan_view import SeenScan
from rpod_pose.ports import Acquisition, Registration
from rpod_pose.registration.lie_group import PoseArrays, stepped
from rpod_pose.search.attitude_grid import attitudes_of, within
from rpod_pose.search.hypotheses import NEGLIGIBLE, belief_with_rivals, rivals
from rpod_pose.search.turns import Turns
from rpod_pose.search.view_model import ViewModel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar.search import GlobalSearchConfig
from rpod_schemas.poses import rotation_matrix
from rpod_schemas.types import LidarScan, Source
from rpod_target import Target

ROUNDS, REFINED = 3, 6
"""Largest number of rounds along weakly determined motions, and of poses that are refined in each. Numerics:
a budget of computation."""

CUT_OFF = (
    "the target extends beyond the field of view, and the scan fits it only with larger errors than sensor "
    "and target state; begin where all of it is in view, or give the pose"
)
"""Reason why a pose cannot begin a track: rays that could contradict a wrong one are not measured."""


class GlobalSearch:
    """Finds the target in a scan: ports.Acquirer[LidarScan].

    Args:
        config: parameters of the search.
        target: the target to find.
        pattern: directions of the sensor's rays, and the range error that it states.

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(self, config: GlobalSearchConfig, target: Target, pattern: ScanPattern) -> None:
        self._config, self._tuning = config, config.tuning
        self._radius_m, self._sigma_range_m = target.radius_m, pattern.sigma_range_m
        self._tracker = ProjectiveIcp(config.tracking, target, pattern)
        surface = self._tracker.surface
        sigma_m = self._tracker.model.sigma_range_m
        self._truncation_m = max(
            self._tuning.truncation_share * target.radius_m, self._tuning.truncation_sigmas * sigma_m
        )
        views = ViewModel.of(
            target,
            surface.coarse_field,
            count=self._tuning.model_points,
            truncation_m=self._truncation_m,
        )
        self._model = Model(views, surface, Turns.of(target))
        self._scanners: dict[tuple[int, tuple[int, int]], Scanner] = {}

    def acquire(self, measurement: LidarScan) -> Acquisition:
        """Return the likeliest pose with its belief, and the other poses that explain the scan."""
        return self._found(measurement, None)

    def near(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the likeliest pose among the attitudes within ``near_deg`` of a given pose."""
        return self._found(measurement, T_sensor_target.rotation.as_matrix())

    def verify(self, measurement: LidarScan, T_sensor_target: RigidTransform) -> Acquisition:
        """Return a pose of another method, refined and with its belief.

        The outcome is "failed" also if a pose with which it may be confused explains the scan much better,
        and "ambiguous" if such a pose explains the scan about as well.
        """
        whole = self._seen(measurement)
        if whole.returns < self._tuning.min_points:
            return self._too_few(whole)
        search = self._search_in(whole)
        given = search.fine_aligned(T_sensor_target.rotation.as_matrix(), T_sensor_target.translation)
        poses = search.completed([given], siblings=1)
        least = poses[0].fit.log_likelihood + log(NEGLIGIBLE)
        likely = [pose for pose in poses if pose.fit.log_likelihood >= least]
        if search.are_close(given, likely).any():
            return self._verified(whole, search, poses, 0)
        turn = np.degrees(Rotation.from_matrix(given.R.T @ poses[0].R).magnitude())
        registration = self._tracker.finish(whole, given.R, given.t)
        belief = contradicted(f"the pose turned by {turn:.0f} deg explains the scan better")
        return Acquisition(replace(registration, belief=belief))

    def log_likelihoods(self, measurement: LidarScan, found: Sequence[Registration]) -> FloatArray:
        """Return the log likelihoods of a scan near registered poses, shape (N,): ports.Likelihoods.

        They are logarithms of integrals over poses near each one, computed from samples. The likelihoods at
        the poses themselves are not comparable, since registrations stop at different distances from their
        optima.
        """
        search = self._search_in(self._seen(measurement))
        poses = (each.T_sensor_target for each in found if each.T_sensor_target is not None)
        sampled = (search.sampled_near(PoseArrays.of(pose)) for pose in poses)
        return np.array([pose.log_mass(self._radius_m) for pose in sampled])

    def _found(self, measurement: LidarScan, around: FloatArray | None) -> Acquisition:
        whole = self._seen(measurement)
        found = self._found_in(whole, around)
        cleaned = self._tracker.without_false_returns(whole, found.registration)
        if cleaned is None:
            return found
        again = self._found_in(cleaned, around)
        if not again.registration.continues_track:
            return found
        return replace(again, registration=with_false_returns(again.registration, whole, cleaned))

    def _found_in(self, whole: SeenScan, around: FloatArray | None) -> Acquisition:
        tuning = self._tuning
        if whole.returns < tuning.min_points:
            return self._too_few(whole)
        search = self._search_in(whole)
        first = 0 if search.informative >= tuning.sure_returns else min(1, len(tuning.levels) - 1)
        templates, poses = 0, list[Pose]()
        for level in tuning.levels[first:]:
            attitudes = attitudes_of(level.attitudes)
            if around is not None:
                attitudes = attitudes[within(attitudes, around, tuning.near_deg)]
            templates += len(attitudes)
            poses = search.search(attitudes, level)
            if poses and poses[0].fit.deficit <= 0.0:  # the scan is as likely as the pose predicts
                break
        return self._verified(whole, search, poses, templates)

    def _seen(self, measurement: LidarScan) -> SeenScan:
        """Return the scan with only those returns that may be on the target."""
        seen = self._tracker.view.seen(measurement)
        return seen.around(2.0 * self._radius_m) if seen.returns else seen

    def _search_in(self, whole: SeenScan) -> ScanSearch:
        """Return the search in a scan; a dense scan is reduced to every ``stride``-th row and column."""
        stride = max(1, round(sqrt(whole.returns / self._tuning.most_returns)))
        first = whole.first(stride)
        seen = whole.every(stride, first) if stride > 1 else whole
        if (stride, first) not in self._scanners:
            view = self._tracker.view if stride == 1 else self._tracker.view.every(stride, first)
            self._scanners[stride, first] = Scanner.of(
                view,
                self._config,
                self._model.surface,
                sigma_range_m=self._sigma_range_m,
                radius_m=self._radius_m,
            )
        return ScanSearch(self._config, self._model, self._scanners[stride, first], seen, self._truncation_m)

    def _beside(self, search: ScanSearch, pose: Pose) -> list[Pose]:
        """Return other poses that are as likely as the best one, along motions that the faces leave open.

        Each motion is followed while it leads to poses that may be rivals. The likeliest of them are refined
        on the outline. The next round starts from a pose that is clearly likelier.
        """
        found: list[Pose] = []
        for _ in range(ROUNDS):
            tried = self._along_weak(search, pose)
            refined = [search.outline_refined(each) for each in tried[:REFINED]]
            likely = [each for each in refined if each.fit.log_likelihood >= pose.fit.log_likelihood - CHANCE]
            near = search.are_close(pose, likely) if likely else ()
            likely = [each for each, is_near in zip(likely, near, strict=True) if not is_near]
            found += likely
            best = max(likely, key=lambda each: each.fit.log_likelihood, default=pose)
            if best.fit.log_likelihood <= pose.fit.log_likelihood + CHANCE:
                break
            pose = best
        return found

    def _along_weak(self, search: ScanSearch, pose: Pose) -> list[Pose]:
        """Return the poses along the motions that the faces determine least, likeliest first."""
        start, found = PoseArrays(pose.R, pose.t), list[Pose]()
        spacing_m = search.scanner.reach.spacing_rad * float(np.linalg.norm(pose.t))
        least = pose.fit.log_likelihood - self._tuning.rival_log_likelihood

        def is_likely(step: FloatArray) -> bool:
            there = search.unrefined(*stepped(start, step))
            if there.fit.log_likelihood < least:
                return False
            found.append(there)
            return True

        faces = search.fine_aligned(pose.R, pose.t).information
        for motion in weakest_motions(faces, self._radius_m):
            walked(motion, spacing_m, self._radius_m, is_likely)
        return sorted(found, key=lambda each: -each.fit.log_likelihood)

    def _too_few(self, seen: SeenScan) -> Acquisition:
        reason = f"{seen.returns} returns, {self._tuning.min_points} needed"
        return Acquisition(Registration.none(Source.NONE, reason))

    def _verified(
        self, whole: SeenScan, search: ScanSearch, poses: list[Pose], templates: int
    ) -> Acquisition:
        """Return the acquisition of distinct poses, likeliest first."""
        if not poses:
            nothing = Registration.none(Source.LIDAR, "no attitude shows the target to the sensor")
            return Acquisition(nothing, templates=templates)
        registration = self._tracker.finish(whole, poses[0].R, poses[0].t)
        beside = [] if search.few else self._beside(search, poses[0])
        if beside or not (search.few or search.is_settled(registration, poses)):
            poses = search.closed(search.distinct([*poses, *beside]))
            registration = self._tracker.finish(whole, poses[0].R, poses[0].t)
        belief = search.belief(poses[0])
        if search.few and registration.T_sensor_target is not None:
            poses = search.ranked(poses)
            registration = self._tracker.placed(registration, poses[0], poses[0].information)
            belief = search.belief(poses[0])
        elif not registration.continues_track:
            belief = registration.belief if belief.continues_track else belief
        if registration.T_sensor_target is not None:
            covariance = self._model.turns.exact.with_free_variance(
                registration.covariance, rotation_matrix(registration.T_sensor_target), 0.0
            )
            vague = undetermined(covariance, max_sigma_m=np.inf, max_sigma_deg=self._tuning.max_sigma_deg)
            if whole.cut_off and not search.scanner.statistics.explains(search.seen, poses[0].fit):
                vague = vague or CUT_OFF
            belief = replace(belief, insufficient=belief.insufficient or vague)
            logs = np.array([pose.log_mass(self._radius_m) for pose in poses])
            least = self._tuning.few_weight if search.few else self._tuning.ambiguous_weight
            others = rivals(poses, logs, self._model.turns.exact)
            if belief.continues_track:
                belief = belief_with_rivals(others, belief, least=least)
            else:  # if other things contradict the pose, the whole frame may still support it
                belief = replace(belief, rivals=others, needed_weight=least)
        return Acquisition(replace(registration, belief=belief), templates=templates)
