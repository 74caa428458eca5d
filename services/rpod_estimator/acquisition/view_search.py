"""Acquisition in one PMD frame, without a guess: every attitude is tried, the best is rendered and judged.

1. Attitudes, spread over all of SO(3), are laid on the measured points by the centroid that the camera should
   see of them and compared roughly (``energy``): points off the surface, and surface where nothing is lit.
2. The best are drawn to the points in the target's distance field (``scan_alignment.draw_in``) and ranked by
   render and compare of depth and amplitude (``pmd_fit``).
3. What the best may be mistaken for, its near-symmetries and quarter turns about its axes, is tried too:
   small details and materials alone tell them apart.
4. The best distinct poses are finished, on more points and on the frame's outline.

The verdict asks how much of the frame the best pose explains; the weights of the hypotheses follow from their
losses.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import softmax

from rpod_estimator.acquisition.attitude_grid import attitudes_of, within
from rpod_estimator.acquisition.frame_search import FrameSearch, Model, Pose
from rpod_estimator.acquisition.hypotheses import hypotheses
from rpod_estimator.acquisition.pmd_scene import PmdScene, scene_of
from rpod_estimator.ports import Acquisition, Registration, Verdict
from rpod_estimator.tracking.signed_distance import measured_equations
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd_search import PmdAcquisitionConfig
from rpod_schemas.poses import pose_of
from rpod_schemas.types import PmdFrame, Source
from rpod_target import Target


class ViewSearch:
    """Finds the target in a frame: ports.Acquirer[PmdFrame].

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(self, config: PmdAcquisitionConfig, target: Target) -> None:
        self._config, self._model = config, Model.of(target, config)

    def acquire(self, measurement: PmdFrame) -> Acquisition:
        """Return the pose that explains the frame best, the others that do, and the verdict."""
        return self._found(measurement, None)

    def near(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Acquisition:
        """Return the same of the attitudes within ``near_deg`` of a pose's, wherever the target is."""
        return self._found(measurement, T_sensor_target.rotation.as_matrix())

    def _found(self, measurement: PmdFrame, around: FloatArray | None) -> Acquisition:
        config = self._config
        scene = scene_of(measurement, config.scene, radius_m=self._model.target.radius_m)
        if isinstance(scene, str):
            return Acquisition(Verdict.FAILED, Registration(Source.NONE), scene)
        if around is None:
            attitudes = attitudes_of(config.attitudes)
        else:
            attitudes = attitudes_of(config.near_attitudes)
            attitudes = attitudes[within(attitudes, around, config.near_deg)]
        search = FrameSearch(config, self._model, scene)
        return self._judged(search, search.search(attitudes, around), len(attitudes))

    def _judged(self, search: FrameSearch, poses: list[Pose], templates: int) -> Acquisition:
        """Return the verdict on distinct poses, best first."""
        if not poses:
            reason = "no attitude shows the target to the camera"
            return Acquisition(Verdict.FAILED, Registration(Source.NONE), reason, templates=templates)
        registration = self._registration(search.scene, poses[0], self._doubt(search, poses[0]))
        reason = registration.reason
        if reason or registration.T_sensor_target is None:
            return Acquisition(Verdict.FAILED, registration, reason, templates=templates)
        per_fact = self._config.model.pixels_per_fact
        weights = softmax([-pose.fit.loss / per_fact for pose in poses])
        listed = hypotheses(poses, weights, self._model.turns.exact)
        alike, best = len(self._model.turns.exact), weights[0]
        sure = best >= self._config.verdict.ambiguous_weight
        if alike > 1 and sure:
            reason = f"{alike} poses look alike by the target's symmetry"
        elif not sure:
            reason = f"{len(listed)} poses explain the frame, the best with weight {best / alike:.2f}"
        return Acquisition(
            Verdict.AMBIGUOUS if reason else Verdict.ACCEPTED,
            registration,
            reason,
            listed,
            templates=templates,
            by_symmetry=alike > 1 and sure,
        )

    def _doubt(self, search: FrameSearch, pose: Pose) -> str:
        """Return why a pose does not explain the frame; empty if it does."""
        verdict, fit = self._config.verdict, pose.fit
        if fit.explained_share < verdict.min_explained_share:
            share = 1.0 - fit.explained_share
            return f"does not explain the frame: {share:.0%} of {fit.pixels} pixels contradict the pose"
        if fit.mean_loss > verdict.max_loss:
            return f"does not explain the frame: mean loss {fit.mean_loss:.2f} above {verdict.max_loss:.2f}"
        patch = search.fitter.worst_patch(pose.R, pose.t, verdict.patch_px)
        if patch > verdict.max_patch_loss:
            most = verdict.max_patch_loss
            return f"a detail contradicts the pose: mean loss {patch:.2f} above {most:.2f} there"
        face = search.fitter.worst_patch(pose.R, pose.t, verdict.face_px)
        if face > verdict.max_face_loss:
            return (
                f"a face contradicts the pose: mean loss {face:.2f} above {verdict.max_face_loss:.2f} there"
            )
        return ""

    def _registration(self, scene: PmdScene, pose: Pose, reason: str) -> Registration:
        config, T = self._config, pose_of(pose.R, pose.t)
        sums = measured_equations(self._model.target, scene.thinned(config.fine_points), T, config.scale_m)
        if not reason and sums.degenerate(self._model.target.radius_m):
            reason = "degenerate: the measured surface leaves a motion undetermined"
        return Registration(
            Source.PMD_DEPTH,
            None if reason else T,
            reason,
            cost_m2=sums.cost_m2,
            inliers=sums.inliers,
            inlier_share=sums.inliers / min(len(scene.points_m), config.fine_points),
            explained_share=pose.fit.explained_share,
            judged=True,
            covariance=sums.covariance(T, config.errors) if not reason else np.full((6, 6), np.nan),
        )
