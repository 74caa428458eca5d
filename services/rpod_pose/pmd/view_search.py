"""Acquisition in one PMD frame, without a guess: all attitudes are tried, and the best pose is verified.

1. Attitudes, spread over all of SO(3), are aligned with the measured points by the centroid that the camera
   should measure, and compared roughly (``energy``): points off the surface, and surface where nothing is
   lit.
2. The best are aligned with the points in the target's distance field (``registration.field_alignment``) and
   ranked by rendering: depth and amplitude are compared (``fit``).
3. Poses that the best may be mistaken for are tried too: its near-symmetries and quarter turns about its
   axes. Only small details and materials distinguish them.
4. The best distinct poses are refined on more points and on the frame's outline.

The search only ranks poses. The tracker refines the best on depth and edges, and again from its own result
until the pose settles: the edges that it expects are those of a rendering at the pose from which it starts.
Whether the pose is believed is the tracker's decision: it compares every pixel within the frame's own noise.
The weights of the hypotheses follow from their losses. If no hypothesis outweighs the others, the tracker
checks each: its edges may show which of them the frame contradicts. If it refuses the best, the next ones are
tried in turn.

The real target may have other materials than the target file says. If the tracker believes none of the poses
that are best with the file's materials, the search is repeated with the shape alone. Then the shape alone
must distinguish poses: the best is accepted only if all others are much worse; otherwise the result is
ambiguous.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import softmax

from rpod_pose.pmd.fit import PmdFitter
from rpod_pose.pmd.frame_search import FrameSearch, Model, Pose
from rpod_pose.pmd.joint.expected_edges import moved_px
from rpod_pose.pmd.scene import PmdScene, scene_of
from rpod_pose.ports import Acquisition, Outcome, Registration, Tracker
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.search.attitude_grid import attitudes_of, within
from rpod_pose.search.hypotheses import belief_with_rivals, rivals
from rpod_pose.surroundings.methods import TrackerAmongThings
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_search import PmdAcquisitionConfig
from rpod_schemas.poses import pose_of, rotation_matrix
from rpod_schemas.types import BeliefLevel, Float32Array, PmdFrame, Source
from rpod_target import Target


@dataclass(frozen=True, eq=False)
class _Task:
    """A frame and the attitudes among which the target is searched in it."""

    frame: PmdFrame
    scene: PmdScene
    attitudes: Float32Array
    """Initial R_sensor_target, shape (M, 3, 3)."""
    around: FloatArray | None
    """R_sensor_target near which all poses must be, shape (3, 3); None for any."""

    def failed(self, registration: Registration) -> Acquisition:
        """Return the acquisition of a search without an accepted pose."""
        nothing = replace(registration, T_sensor_target=None, covariance=np.full((6, 6), np.nan))
        return Acquisition(nothing, templates=len(self.attitudes))


class ViewSearch:
    """Finds the target in a frame: ports.Acquirer[PmdFrame].

    Args:
        config: parameters of the search.
        target: the target to find.
        tracker: tracker by both images, which refines the pose.

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(self, config: PmdAcquisitionConfig, target: Target, tracker: Tracker[PmdFrame]) -> None:
        self._config, self._tuning = config, config.tuning
        self._model, self._tracker = Model.of(target, config.tuning), tracker

    def acquire(self, measurement: PmdFrame) -> Acquisition:
        """Return the pose that explains the frame best, with its belief and its rivals."""
        return self._found(measurement, None)

    def near(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the best pose among the attitudes within ``near_deg`` of a given one, at any position."""
        return self._found(measurement, T_sensor_target.rotation.as_matrix())

    def log_likelihoods(self, measurement: PmdFrame, poses: Sequence[RigidTransform]) -> FloatArray:
        """Return the log likelihoods of a frame under poses, shape (N,), up to a constant: ports.Likelihoods.

        They are 0 where the frame shows too little. The materials are those of the target file.
        """
        tuning = self._tuning
        scene = scene_of(measurement, tuning.scene, radius_m=self._model.target.radius_m)
        if isinstance(scene, str):
            return np.zeros(len(poses))
        fitter = PmdFitter(tuning.model, self._model.shown, scene)
        losses = [fitter.fit(rotation_matrix(pose), pose.translation).loss for pose in poses]
        return -np.array(losses) * tuning.independent_pixels / max(int(np.count_nonzero(scene.lit)), 1)

    def _found(self, measurement: PmdFrame, around: FloatArray | None) -> Acquisition:
        tuning = self._tuning
        scene = scene_of(measurement, tuning.scene, radius_m=self._model.target.radius_m)
        if isinstance(scene, str):
            return Acquisition(Registration.none(Source.NONE, scene))
        if around is None:
            attitudes = attitudes_of(self._config.attitudes)
        else:
            attitudes = attitudes_of(tuning.near_attitudes)
            attitudes = attitudes[within(attitudes, around, tuning.near_deg)]
        task = _Task(measurement, scene, attitudes, around)
        found = self._verified(task, known_materials=True)
        if found.outcome is not Outcome.FAILED:
            return found
        by_shape = self._verified(task, known_materials=False)
        return found if by_shape.outcome is Outcome.FAILED else by_shape

    def _verified(self, task: _Task, *, known_materials: bool) -> Acquisition:
        """Return the acquisition of the poses that are best with the file's materials, or by shape alone."""
        tuning = self._tuning
        fitter = PmdFitter(tuning.model, self._model.shown, task.scene, known_materials=known_materials)
        search = FrameSearch(tuning, self._model, task.scene, fitter, partial(self._possible, task.frame))
        poses = search.search(task.attitudes, task.around)
        if not poses:
            reason = "no attitude shows the target to the camera"
            return task.failed(Registration.none(Source.NONE, reason))
        independent = tuning.independent_pixels if known_materials else tuning.independent_pixels_of_shape
        logs = np.array([-pose.fit.loss * independent / poses[0].fit.pixels for pose in poses])
        weights, least = softmax(logs), tuning.ambiguous_weight
        contenders = 1 if weights[0] >= least else int(np.count_nonzero(weights > 1.0 - least))
        checked: list[Registration] = []
        left: list[int] = []
        for index, pose in enumerate(poses):
            if index >= contenders and left:
                break
            checked.append(self._registered(task, pose))
            if checked[-1].belief.level is BeliefLevel.ACCEPTED:  # a first pose needs more than a track
                left.append(index)
        if not left:
            return task.failed(checked[0])
        best = checked[left[0]]
        left += range(len(checked), len(poses))
        ranked = [poses[index] for index in left]
        if best.T_sensor_target is not None:
            matrix = best.T_sensor_target.as_matrix()
            ranked[0] = replace(ranked[0], R=matrix[:3, :3], t=matrix[:3, 3])
        found = rivals(ranked, logs[left], self._model.turns.exact)
        believed = belief_with_rivals(found, best.belief, least=least)
        return Acquisition(replace(best, belief=believed), templates=len(task.attitudes))

    def _possible(self, frame: PmdFrame, pose: Pose) -> bool:
        """Return whether a pose near this one may be the target's, by what the whole frame shows there."""
        among = self._tracker
        return not isinstance(among, TrackerAmongThings) or not among.excluded(frame, pose_of(pose.R, pose.t))

    def _registered(self, task: _Task, pose: Pose) -> Registration:
        """Return a pose that the search found, refined and judged by the tracker."""
        found = self._settled(task.frame, self._tracker.track(task.frame, pose_of(pose.R, pose.t)))
        evidence = {"mean_loss": pose.fit.mean_loss, **found.belief.evidence}
        return replace(found, belief=replace(found.belief, evidence=evidence))

    def _again(self, frame: PmdFrame, found: Registration, pose: RigidTransform) -> Registration:
        """Return a registration aligned again from its own pose."""
        among = self._tracker
        if isinstance(among, TrackerAmongThings):
            return among.again(frame, found)
        return among.track(frame, pose)

    def _settled(self, frame: PmdFrame, found: Registration) -> Registration:
        """Return a registration that is aligned again from its own pose, until the pose hardly moves.

        An alignment finds edges that are a pixel from their place only slowly, since they count as outliers
        first. The steps of one alignment suffice in a stream of frames, but not from the pose of a search. A
        pose that the frame contradicts is not continued, nor is one that is believed less than before.
        """
        tuning, radius_m = self._tuning, self._model.target.radius_m
        for _ in range(tuning.settling):
            before = found.T_sensor_target
            if before is None or not found.continues_track:
                break
            again = self._again(frame, found, before)
            after = again.T_sensor_target
            if after is None or _standing(again) < _standing(found):
                break
            found = again
            moved = moved_px(PoseArrays.of(before), PoseArrays.of(after), radius_m, frame.camera.fx)
            if moved < tuning.settled_px:
                break
        return found


def _standing(found: Registration) -> tuple[bool, bool]:
    """Return how far a registration is believed; a greater value is more."""
    return found.belief.level is BeliefLevel.ACCEPTED, found.continues_track
