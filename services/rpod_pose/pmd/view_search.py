"""Acquisition in one PMD frame, without a guess: all attitudes are tried, and the best pose is verified.

1. Attitudes, spread over all of SO(3), are positioned by the centroid that the camera should measure, and
   compared roughly (``energy``): points off the surface and surface on unlit pixels increase the energy.
2. The best attitudes are aligned with the points in the target's distance field
   (``registration.field_alignment``) and ranked by rendering: depth and amplitude are compared (``fit``).
3. Poses with which the best one may be confused are tried too: near-symmetries, quarter turns about its axes.
4. The best distinct poses are refined on more points and on the frame's outline.

The search only ranks poses. The tracker refines the best one on depth and edges. It predicts edges by a
rendering at the pose from which it starts. Therefore it starts again from its own result, as long as this
makes the whole frame likelier. The tracker also decides whether a pose is believed: it compares every pixel
within the frame's noise.

The tracker aligns the likely rivals too, because only an aligned pose shows how well it explains the frame. A
rival is excluded if the tracker refuses it. If two poses are close to each other after the alignment, the one
that explains the frame clearly better is kept, and its covariance contains their distance, weighted by the
probability of the other one. The weights of the remaining poses follow from their likelihoods in the whole
frame, with the brightness of each face fitted (``joint.brightness_fit``). The coarse pixels of the search
would not do: they do not show the details that distinguish turned poses, and a user knows the materials only
roughly.

An alignment that leads away from a pose that explains the frame better is refused: it ended in a false
minimum. If a refused pose explains the frame better than the accepted ones, none is accepted: the right pose
may not be among them. Both decisions need the coarse pixels and the whole frame to agree: few coarse pixels
on an outline decide little, and their brightness is that of the file. If the tracker refuses all likely
poses, the next ones are tried in turn.

The real target may have other materials than its file states. If the tracker believes none of the poses that
are best with the file's materials, the search is repeated by shape alone, with these poses among its starts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform
from scipy.special import logit, softmax

from rpod_geometry.rays import NEAREST_M
from rpod_pose.belief import contradicted
from rpod_pose.pmd.fit import PmdFitter
from rpod_pose.pmd.frame_search import FrameSearch, Model, Pose
from rpod_pose.pmd.joint.alternatives import CLEAR_LOG, MOST_DROP_LOG, poses_of
from rpod_pose.pmd.joint.frame import moved_px
from rpod_pose.pmd.scene import PmdScene, scene_of
from rpod_pose.ports import (
    Acquisition,
    ClimbingTracker,
    ComparingTracker,
    Outcome,
    Registration,
    WholeFrameTracker,
)
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.search.attitude_grid import attitudes_of, within
from rpod_pose.search.hypotheses import belief_with_rivals, rivals, spread_of, standing
from rpod_pose.search.turns import matrices
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.search import PmdAcquisitionConfig
from rpod_schemas.poses import pose_of
from rpod_schemas.types import BeliefLevel, Float32Array, PmdFrame, Source
from rpod_target import Target

MOST_BIAS_SIGMAS = 2.0
"""Largest bias of the ranges that is tried, in standard deviations. Physics: 95 % of normal errors are
smaller."""
MOST_BIASES = 8
"""Largest number of biases that are tried on each side. Numerics: a budget of computation."""


@dataclass(frozen=True, eq=False)
class _Task:
    """A frame and the attitudes among which the target is searched in it."""

    frame: PmdFrame
    scene: PmdScene
    attitudes: Float32Array
    """Initial R_sensor_target, shape (M, 3, 3)."""
    around: FloatArray | None
    """R_sensor_target near which all poses must be, shape (3, 3); None for any attitude."""

    def failed(self, registration: Registration) -> Acquisition:
        """Return the acquisition of a search without an accepted pose."""
        nothing = replace(registration, T_sensor_target=None, covariance=np.full((6, 6), np.nan))
        return Acquisition(nothing, templates=len(self.attitudes))


@dataclass(frozen=True, eq=False)
class _Aligned:
    """A pose of the search, aligned with the frame by the tracker."""

    R: FloatArray
    """R_sensor_target, shape (3, 3)."""
    t: FloatArray
    """Position of the target's origin, sensor axes, shape (3,), m."""
    registration: Registration
    losses: FloatArray
    """Losses in the frame before and after the alignment, shape (2,)."""
    start: PoseArrays
    """Pose of the search before the alignment."""

    @property
    def is_accepted(self) -> bool:
        """Whether the tracker believes the pose: a first pose needs more than a track."""
        return self.registration.belief.level is BeliefLevel.ACCEPTED

    def climbed(self, tracker: ComparingTracker[PmdFrame], frame: PmdFrame) -> Self:
        """Return the likeliest pose nearby, if this one is coarse."""
        if not isinstance(tracker, ClimbingTracker):
            return self
        found = tracker.climbed(frame, self.registration)
        R, t = (self.R, self.t) if found is self.registration else poses_of([found])[0]
        return replace(self, R=R, t=t, registration=found)


class ViewSearch:
    """Finds the target in a frame: ports.Acquirer[PmdFrame].

    Args:
        config: parameters of the search.
        target: the target to find.
        tracker: tracker that uses depth and amplitude, refines poses and decides whether they are believed.

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(
        self, config: PmdAcquisitionConfig, target: Target, tracker: ComparingTracker[PmdFrame]
    ) -> None:
        self._config, self._tuning = config, config.tuning
        self._model, self._tracker = Model.of(target, config.tuning), tracker

    def acquire(self, measurement: PmdFrame) -> Acquisition:
        """Return the pose that explains the frame best, with its belief and its rivals."""
        return self._found(measurement, None)

    def near(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the best pose among the attitudes within ``near_deg`` of a given one, at any position."""
        return self._found(measurement, T_sensor_target.rotation.as_matrix())

    def log_likelihoods(self, measurement: PmdFrame, found: Sequence[Registration]) -> FloatArray:
        """Return the log likelihoods of a frame at registered poses, shape (N,): ports.Likelihoods."""
        return self._tracker.log_likelihoods(measurement, found)

    def _found(self, measurement: PmdFrame, around: FloatArray | None) -> Acquisition:
        tuning = self._tuning
        scene = scene_of(measurement, tuning.scene, radius_m=self._model.target.radius_m)
        if isinstance(scene, str):
            return Acquisition(Registration.none(Source.NONE, scene))
        attitudes = attitudes_of(tuning.attitudes if around is None else tuning.near_attitudes)
        if around is not None:
            attitudes = attitudes[within(attitudes, around, tuning.near_deg)]
        task, poses, failed = _Task(measurement, scene, attitudes, around), list[Pose](), list[Acquisition]()
        for known_materials in (True, False) if scene.outlined else (True,):  # both are one by depth alone
            fitter = PmdFitter(tuning.model, self._model.shown, scene, known_materials=known_materials)
            search = FrameSearch(tuning, self._model, scene, fitter, partial(self._possible, measurement))
            poses = search.search(attitudes, around, poses)
            found = self._verified(task, search, fitter, poses, known_materials=known_materials)
            if found.outcome is not Outcome.FAILED:
                return found
            failed.append(found)
        return failed[0]

    def _verified(
        self,
        task: _Task,
        search: FrameSearch,
        fitter: PmdFitter,
        poses: list[Pose],
        *,
        known_materials: bool,
    ) -> Acquisition:
        """Return the acquisition after the tracker has refined and checked the poses of a search."""
        tuning = self._tuning
        if not poses:
            reason = "no attitude shows the target to the camera"
            return task.failed(Registration.none(Source.NONE, reason))
        independent = tuning.independent_pixels if known_materials else tuning.independent_pixels_of_shape
        per_loss = independent / poses[0].fit.pixels
        aligned: list[_Aligned] = []
        for pose in poses:
            likely = pose.fit.loss <= tuning.rival_losses * poses[0].fit.loss
            if likely or not any(each.is_accepted for each in aligned):
                aligned.append(self._aligned(task, fitter, pose, per_loss))
        if any(each.is_accepted for each in aligned):
            turned = self._turned(task, search, aligned)
            aligned += [self._aligned(task, fitter, pose, per_loss) for pose in turned]
        believed = [each for each in aligned if each.is_accepted]
        if not believed:
            return task.failed(aligned[0].registration)
        logs = self._tracker.log_likelihoods(task.frame, [each.registration for each in believed])
        believed, logs = self._merged(believed, logs)
        best = believed[0]
        if better := self._better(task.frame, best, aligned, per_loss):
            reason = f"a refused pose explains the frame better than the accepted ones; refused as {better}"
            return task.failed(replace(best.registration, belief=contradicted(reason)))
        best = best.climbed(self._tracker, task.frame)
        found = rivals([best, *believed[1:]], logs, self._model.turns.exact)
        belief = belief_with_rivals(found, best.registration.belief, least=tuning.ambiguous_weight)
        return Acquisition(replace(best.registration, belief=belief), templates=len(task.attitudes))

    def _merged(self, aligned: list[_Aligned], logs: FloatArray) -> tuple[list[_Aligned], FloatArray]:
        """Return distinct poses, likeliest first, and their log likelihoods, relative to the best.

        Alignments that lead to nearly the same attitude may end in several neighbouring minima. Of these
        poses the first one is kept, or one that is clearly likelier. Its covariance contains the mean square
        distance of the others, weighted by their likelihoods.

        Args:
            aligned: poses in the order of the search.
            logs: their log likelihoods in the whole frame, shape (N,).
        """
        turns, within_deg = self._model.turns, self._tuning.distinct_deg
        distinct = turns.distinct(aligned, within_deg)
        merged, most = [], []
        for near in turns.close(matrices(distinct), matrices(aligned), within_deg):
            same = [pose for pose, is_near in zip(aligned, near, strict=True) if is_near]
            gains = logs[near] - logs[near][0]
            best = same[int(gains.argmax()) if gains.max() > CLEAR_LOG else 0]
            spread = spread_of(best, same, softmax(gains), self._model.target.equivalence)
            registration, parts = best.registration, best.registration.parts
            registration = replace(
                registration,
                covariance=registration.covariance + spread,
                parts=None if parts is None else replace(parts, of_image=parts.of_image + spread),
            )
            losses = np.min([pose.losses for pose in same], axis=0)
            merged.append(replace(best, registration=registration, losses=losses))
            most.append(logs[near].max())
        order = np.argsort(-np.array(most), kind="stable")
        return [merged[index] for index in order], np.array(most)[order] - max(most)

    def _turned(self, task: _Task, search: FrameSearch, aligned: list[_Aligned]) -> list[Pose]:
        """Return turns of the best accepted pose that were not aligned yet and may be rivals.

        These are near-symmetries, rotations that map main faces onto each other, and turns about the axis of
        a round target. The shape alone decides, as other poses may fit the file's materials better.
        """
        tuning, turns = self._tuning, self._model.turns
        best = next(each for each in aligned if each.is_accepted)
        shape = PmdFitter(tuning.model, self._model.shown, task.scene, known_materials=False)
        most = tuning.rival_losses * shape.fit(best.R, best.t).loss

        def left_out(attitudes: FloatArray) -> NDArray[np.bool_]:
            close = np.asarray(turns.close(attitudes, matrices(aligned), tuning.distinct_deg).any(axis=1))
            if task.around is not None:
                close |= ~within(attitudes.astype(np.float32), task.around, tuning.near_deg)
            return close

        return search.turned(best, left_out, shape, most)

    def _better(self, frame: PmdFrame, best: _Aligned, aligned: list[_Aligned], per_loss: float) -> str:
        """Return why a pose is refused that explains the frame better than the best accepted one.

        Empty if there is none. The loss of the best pose after its alignment is compared with the smaller
        loss of the other one, before or after its own alignment. A pose near the best may be better by
        ``MOST_DROP_LOG``, since both count as one pose.
        """
        refused = [each for each in aligned if not each.is_accepted]
        gains = per_loss * np.array([best.losses[1] - each.losses.min() for each in refused])
        near = self._model.turns.close(matrices([best]), matrices(refused), self._tuning.distinct_deg)[0]
        better = gains > np.where(near, MOST_DROP_LOG, logit(self._tuning.ambiguous_weight))
        for each in (refused[index] for index in np.flatnonzero(better)):
            if self._explains_better(frame, (each.start, PoseArrays(each.R, each.t)), best.registration):
                return each.registration.belief.reason
        return ""

    def _explains_better(self, frame: PmdFrame, poses: Sequence[PoseArrays], found: Registration) -> bool:
        """Return whether one of several poses explains the whole frame better than a registered one.

        Each pose is tried as it is, and moved along the line of sight by the bias of the ranges.
        """
        others = [
            replace(
                found, T_sensor_target=pose_of(R, t - bias_m * t / np.linalg.norm(t)), range_bias_m=bias_m
            )
            for R, t in poses
            for bias_m in (0.0, found.range_bias_m)
        ]
        logs = self._tracker.log_likelihoods(frame, [found, *others])
        return bool(logs[1:].max() > logs[0])

    def _aligned(self, task: _Task, fitter: PmdFitter, pose: Pose, per_loss: float) -> _Aligned:
        """Return a pose that the search found, aligned by the tracker.

        The result is contradicted if the alignment has led to a pose that explains the frame worse, both on
        the coarse pixels and in the whole frame. A log likelihood is minus ``per_loss`` times a loss.
        """
        bias_m = self._bias_m(task, fitter, pose, per_loss)
        found, start = self._registered(task, pose, bias_m), PoseArrays(pose.R, pose.t)
        if found.T_sensor_target is None:
            return _Aligned(*start, found, np.array((pose.fit.loss, np.inf)), start)
        R, t = PoseArrays.of(found.T_sensor_target)
        # the position that the depth shows: farther by the bias of the ranges that the tracker found
        shown_t = t * (1.0 + found.range_bias_m / float(np.linalg.norm(t)))
        losses = np.array((pose.fit.loss, fitter.fit(R, shown_t).loss))
        if found.continues_track and per_loss * (losses[1] - losses[0]) > MOST_DROP_LOG:
            # the outline shows the pose itself, the depth shows it displaced by the bias
            worse = min(losses[1], fitter.fit(R, t).loss)
            drops = per_loss * (worse - losses[0]) > MOST_DROP_LOG
            if drops and self._explains_better(task.frame, (start,), found):
                times = worse / losses[0]
                reason = (
                    f"the alignment leads away from a pose that explains the frame {times:.1f} times better"
                )
                found = replace(found, belief=replace(contradicted(reason), evidence=found.belief.evidence))
        return _Aligned(R, t, found, losses, start)

    def _possible(self, frame: PmdFrame, pose: Pose) -> bool:
        """Return whether the whole frame allows that a pose near this one is that of the target."""
        whole = self._tracker if isinstance(self._tracker, WholeFrameTracker) else None
        return whole is None or not whole.excluded(frame, pose_of(pose.R, pose.t))

    def _bias_m(self, task: _Task, fitter: PmdFitter, pose: Pose, per_loss: float) -> float:
        """Return the likeliest length by which all ranges are too long, m, at a pose of the search.

        The search has placed the target where the depth shows it. An error that all ranges share may put the
        outline beyond the reach of the tracker's search for edges. So the target is moved along the line of
        sight, and the outline, which no bias moves, decides. 0 if it moves by less than a coarse pixel.
        """
        sigma_m, range_m = self._tuning.model.sigma_m, max(float(np.linalg.norm(pose.t)), NEAREST_M)
        radius_px = task.frame.camera.fx * self._model.target.radius_m / max(float(pose.t[2]), NEAREST_M)
        step_m = task.scene.view.stride * range_m / radius_px
        number = int(min(MOST_BIAS_SIGMAS * sigma_m / step_m, MOST_BIASES))
        if not number:
            return 0.0
        biases_m = step_m * np.arange(-number, number + 1)
        misfits = [
            per_loss * fitter.fit(pose.R, pose.t * (1.0 - bias_m / range_m), bias_m=bias_m).loss
            + 0.5 * (bias_m / sigma_m) ** 2
            for bias_m in biases_m.tolist()
        ]
        return float(biases_m[int(np.argmin(misfits))])

    def _registered(self, task: _Task, pose: Pose, bias_m: float) -> Registration:
        """Return a pose that the search found, refined and checked by the tracker.

        Args:
            task: the frame.
            pose: the pose where the depth shows it.
            bias_m: length by which all ranges may be too long. If the pose with it is not accepted, the pose
                without it is tried too.
        """
        found = self._settled(task.frame, self._tracked(task.frame, pose, bias_m))
        if bias_m and found.belief.level is not BeliefLevel.ACCEPTED:
            other = self._settled(task.frame, self._tracked(task.frame, pose, 0.0))
            found = max(found, other, key=standing)
        evidence = {"mean_loss": pose.fit.mean_loss, **found.belief.evidence}
        return replace(found, belief=replace(found.belief, evidence=evidence))

    def _tracked(self, frame: PmdFrame, pose: Pose, bias_m: float) -> Registration:
        """Return the tracker's registration from a pose of the search that is moved nearer by a bias."""
        t = pose.t * (1.0 - bias_m / float(np.linalg.norm(pose.t)))
        return self._tracker.track(frame, pose_of(pose.R, t))

    def _again(self, frame: PmdFrame, found: Registration, pose: RigidTransform) -> Registration:
        """Return a registration aligned again from its own pose."""
        if isinstance(self._tracker, WholeFrameTracker):
            return self._tracker.again(frame, found)
        return self._tracker.track(frame, pose)

    def _settled(self, frame: PmdFrame, found: Registration) -> Registration:
        """Return a registration after repeated alignments from its own pose.

        An alignment converges slowly if edges are a pixel from their place, since they are outliers at first.
        One alignment suffices in a stream of frames, but not from the pose of a search. If the frame
        determines the pose weakly, alignments may wander along a valley of the likelihood. So the next pose
        is taken only if it is believed more, or equally and is likelier. The loop ends at a small motion.
        """
        tuning, radius_m = self._tuning, self._model.target.radius_m
        for _ in range(tuning.settling):
            before = found.T_sensor_target
            if before is None or not found.continues_track:
                break
            again = self._again(frame, found, before)
            after = again.T_sensor_target
            if after is None or not self._preferred(frame, again, found):
                break
            found = again
            px_per_m = frame.camera.fx / max(after.translation[2], NEAREST_M)
            moved = moved_px(PoseArrays.of(before), PoseArrays.of(after), radius_m, px_per_m)
            if moved < tuning.settled_px:
                break
        return found

    def _preferred(self, frame: PmdFrame, again: Registration, found: Registration) -> bool:
        """Return whether an alignment is believed more than the previous one, or equally and is likelier."""
        if standing(again) != standing(found):
            return standing(again) > standing(found)
        before, after = self._tracker.log_likelihoods(frame, [found, again], ranked_only=True)
        return bool(after > before)
