"""Tracking by depth and amplitude together: signed distances of points, and positions of edges.

The iterations depend on the prediction. If most edges are near their predicted places, only the last, narrow
steps are made: a wider search may confuse neighbours. If many edges are near, a few wider steps come first.
All steps are made from any other prediction, moved to where its image is found, then from one that explains
the depth moderately, and last from a pose by depth alone. If a result is inconsistent with the frame, it is
moved along the line of sight to where most edges are in place, and is aligned again, before the next start.

The self-check uses both images. With a wrong camera matrix, another target or a mirrored image the depth may
agree, but the edges do not. If one image shows nothing of the target, the source names the other one.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import inf, radians
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_geometry.rays import Hits, RenderBuffers
from rpod_pose.belief import PixelMarks
from rpod_pose.pmd.depth_view import DepthView
from rpod_pose.pmd.joint.alternatives import (
    LEADS_PX,
    SAME_PX,
    Aligned,
    along_sight,
    depth_loss,
    likeliest,
    log_likelihoods,
    poses_of,
)
from rpod_pose.pmd.joint.brightness.amplitude_noise import correlation_px
from rpod_pose.pmd.joint.brightness.patch_renderer import PatchRenderer
from rpod_pose.pmd.joint.check.belief import by_distances, edges_in_place, frame_belief, source_of
from rpod_pose.pmd.joint.check.bright_beyond import marked, or_by_depth
from rpod_pose.pmd.joint.check.noisy_ranges import MedianError
from rpod_pose.pmd.joint.check.pixel_check import PixelCheck
from rpod_pose.pmd.joint.depth_points import Planes
from rpod_pose.pmd.joint.edge_lines import grouped
from rpod_pose.pmd.joint.edge_model import EdgeModel
from rpod_pose.pmd.joint.edge_points import EdgeErrors, add_edge_points
from rpod_pose.pmd.joint.expected_edges import EdgeSight, Sights
from rpod_pose.pmd.joint.facets import facet_turns, turned_states
from rpod_pose.pmd.joint.fit import DepthErrors, JointProblem, align, joint_shares, near_the_pose
from rpod_pose.pmd.joint.frame import FINE_RAYS, JointFrame
from rpod_pose.pmd.joint.image_shift import found_in_image
from rpod_pose.pmd.joint.uncertainty import JointModelError, Uncertainty, inverse_curvature, uncertainty
from rpod_pose.pmd.joint.whole_image.first_pose import at_likeliest, is_coarse
from rpod_pose.ports import Registration
from rpod_pose.registration.distance_field import field_arrays
from rpod_pose.registration.field_alignment import Points, field_aligned
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.normal_equations import no_sums
from rpod_pose.registration.surface_model import cast_faces, coarse_field
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.poses import pose_of
from rpod_schemas.types import PmdFrame, Source
from rpod_target import Target

CERTAIN_PX = 1.6
"""Largest distance in the image from the prediction at which an alignment cannot have matched wrong edges.
Physics: the width of an edge, twice the standard deviation of the smoothing."""
CERTAIN_SIGMAS = 0.5
"""The same distance over the motion in the image that one standard deviation of the position, and of the
attitude times the radius, causes. Numerics: a budget of computation."""
LAST_STEPS = 2
"""Number of last steps, before which a target that has moved is rendered again. Numerics: a budget."""
MOST_WIDER = 3.0
"""Largest factor on the reach of the last search, for close targets. Numerics: a budget of computation."""


class _Tried(NamedTuple):
    """An alignment and its registration."""

    aligned: Aligned
    found: Registration


class JointTracker:
    """Registers PMD frames by depth and edges: ports.Tracker[PmdFrame], ports.ComparingTracker.

    Args:
        config: parameters of the tracker.
        target: the target to track.
        calibrated: whether the depth is calibrated, so that its assumed errors are smaller.

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """

    def __init__(self, config: JointConfig, target: Target, *, calibrated: bool = False) -> None:
        tuning = config.tuning
        self._tuning, self._target = tuning, target
        self._ranges = tuning.depth.calibrated if calibrated else tuning.depth.raw
        self._spacing_m = tuning.edges.spacing_share * target.radius_m
        edges = EdgeModel.of(target, spacing_m=self._spacing_m)
        self._edges = edges.arrays
        self._field, self._renderer = field_arrays(target), PatchRenderer(target, tuning.edges)
        weak = np.repeat((target.radius_m, radians(tuning.unobserved_deg)), 3)
        self._weak = np.diag(np.append(weak**-2, 0.0))
        scale, final = tuning.depth.scale_share, tuning.depth.final_scale_share
        scales_m = target.radius_m * np.geomspace(scale, final, tuning.iterations)
        reaches_px = np.geomspace(tuning.edges.search_px, tuning.edges.final_search_px, tuning.iterations)
        coarse = np.column_stack((scales_m, reaches_px))
        self._narrow = np.tile(coarse[-1], (tuning.near_iterations, 1))
        self._facets = facet_turns(target)
        self._near = np.vstack((coarse[-tuning.near_iterations :], self._narrow))
        self._full = np.vstack((coarse, self._narrow))
        self._far_m = target.radius_m * np.geomspace(tuning.far_scale_share, scale, tuning.far_iterations)
        self._coarse, self._faces = coarse_field(target), self._renderer.faces
        ranges, most = self._ranges, float(tuning.depth.effective_points)
        self._depth_errors = DepthErrors(
            tuning.depth.noise_m, most, ranges.bias_m, ranges.uneven_m, config.slack_m
        )
        self._edge_errors = EdgeErrors.of(tuning.edges)
        self._model_error, self._lines = JointModelError(target, edges.parts), edges.lines
        self._check = PixelCheck(target, tuning, self._ranges, self._renderer)
        self._buffers: dict[tuple[int, int], RenderBuffers] = {}
        self._nothing = Registration.none(Source.PMD_JOINT, "nothing of the target is seen")

    def track(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        """Return the registration from a predicted pose, or the reason why the frame gives none."""
        tracked = partial(self._tracked, T_sensor_target=T_sensor_target)
        found, by_depth = or_by_depth(tracked, measurement, lambda found: found.continues_track)
        return marked(self._check.by_extent(measurement, found)) if by_depth else found

    def _tracked(self, measurement: PmdFrame, T_sensor_target: RigidTransform) -> Registration:
        pose = PoseArrays.of(T_sensor_target)
        seen = JointFrame.of(measurement, pose.t, radius_m=self._target.radius_m, tuning=self._tuning)
        if isinstance(seen, str):
            return Registration.none(Source.PMD_JOINT, seen)
        tried: list[_Tried] = []
        sights = self._sights(seen)
        for start, schedule in self._starts(seen, sights, pose):
            aligned = self._aligned(seen, sights, start, schedule)
            tried.append(_Tried(aligned, self._registered(seen, sights, aligned, len(schedule))))
            ends = State(aligned.fit.state.pose, 0.0)
            moved = None if tried[-1].found.begins_track else self._moved_along_sight(seen, sights, ends)
            if moved is not None:
                aligned = self._aligned(seen, sights, moved, self._near)
                steps = len(schedule) + len(self._near)
                tried.append(_Tried(aligned, self._registered(seen, sights, aligned, steps)))
            if believed := [each for each in tried if each.found.continues_track]:
                best = max(believed, key=lambda each: each.found.begins_track)
                return self._likeliest(seen, sights, pose, best)
        posed = [each.found for each in tried if each.found.T_sensor_target is not None]
        nothing = tried[0].found if tried else self._nothing
        return max(posed, key=lambda each: each.explained_share, default=nothing)

    def log_likelihoods(
        self, measurement: PmdFrame, found: Sequence[Registration], *, ranked_only: bool = False
    ) -> FloatArray:
        """Return the log likelihoods of one frame at registered poses: ports.ComparingTracker.

        They contain the depth and the whole image, with the brightness of each face fitted
        (``brightness_fit``), and are scaled to the covariance of the likeliest pose (``alternatives``).
        """
        pose = poses_of(found)[0]
        seen = JointFrame.of(measurement, pose.t, radius_m=self._target.radius_m, tuning=self._tuning)
        if isinstance(seen, str) or len(found) == 1:
            return np.zeros(len(found))
        depth_at = self._depth_near(seen, pose)
        return log_likelihoods(
            found, lambda state: self._loss(seen, state, depth_at(state.pose)), ranked_only=ranked_only
        )

    def climbed(self, measurement: PmdFrame, found: Registration) -> Registration:
        """Return a coarse registration at the likeliest pose nearby: ports.ClimbingTracker."""
        if not is_coarse(found, self._target.radius_m):
            return found
        pose, radius_m = poses_of([found])[0], self._target.radius_m
        seen = JointFrame.of(measurement, pose.t, radius_m=radius_m, tuning=self._tuning)
        if isinstance(seen, str):
            return found
        return at_likeliest(found, seen, self._renderer, self._depth_near(seen, pose), radius_m)

    def _depth_near(self, seen: JointFrame, pose: PoseArrays) -> Callable[[PoseArrays], JointProblem]:
        """Return the function that returns the problem of the depth alone at poses near one."""
        problem = self._problem(seen, self._sights(seen).blank(pose), self._near[-1:], self._edge_errors)
        return lambda near: near_the_pose(problem, self._planes(seen, near))

    def _likeliest(
        self, seen: JointFrame, sights: Sights, predicted: PoseArrays, tried: "_Tried"
    ) -> Registration:
        """Return the registration of the likeliest pose near an aligned one, if its prediction is far off."""
        (aligned, found), radius_m = tried, self._target.radius_m
        focal_px, pose = seen.lens.fx, aligned.fit.state.pose
        deviations = np.sqrt(np.diag(found.covariance).reshape(2, 3).sum(axis=1))
        sigma_px = focal_px / seen.away_m * float(deviations @ (1.0, radius_m))
        if seen.moved_px(predicted, pose, radius_m) < max(CERTAIN_PX, CERTAIN_SIGMAS * sigma_px):
            return found
        schedule = np.maximum(self._near, (self._least_scale_m(seen), 0.0))
        errors = self._edge_errors._replace(merged=aligned.last.edge_errors.merged)
        best = likeliest(
            aligned,
            along_sight=self._along_sight(seen, aligned.fit.state),
            rivals=partial(turned_states, self._facets),
            loss=lambda each: self._loss(seen, each.fit.state, each.last),
            aligned_from=lambda start: self._aligned_by(seen, sights, start, schedule, errors),
            px_m=seen.away_m / focal_px,
            radius_m=radius_m,
        )
        again = self._registered(seen, sights, best, found.iterations + len(schedule))
        return again if again.continues_track >= found.continues_track else found

    def _starts(
        self, seen: JointFrame, sights: Sights, pose: PoseArrays
    ) -> Iterator[tuple[State, FloatArray]]:
        """Yield starting poses with their schedules, shape (S, 2); those with the fewest steps come first."""
        tuning, shown = self._tuning, sights.shown_at(pose)
        share = self._check.explained(seen, pose, self._buffers_of(seen.view))
        in_place = self._in_place(seen, sights.at(pose), pose)
        if in_place is None and share >= tuning.fair_share:
            yield State(pose, 0.0), self._near
        elif in_place is not None and in_place >= tuning.near_share:
            yield State(pose, 0.0), self._narrow if in_place >= tuning.accurate_share else self._near
        if (moved := found_in_image(seen, shown)) is not shown.pose:
            yield State(moved, 0.0), self._full
        if share >= tuning.fair_share or len(seen.points_m) < tuning.acceptance.min_points:
            yield State(pose, 0.0), self._full
        if len(seen.points_m) >= tuning.acceptance.min_points:
            every = max(1, round(len(seen.points_m) / tuning.far_points))
            few = Points.equal(np.ascontiguousarray(seen.points_m[::every]))
            far_m = np.maximum(self._far_m, self._least_scale_m(seen))
            yield State(field_aligned(few, pose, self._coarse, far_m), 0.0), self._full

    def _moved_along_sight(self, seen: JointFrame, sights: Sights, state: State) -> State | None:
        """Return the pose along the line of sight at which most edges are in place; None if they are few."""
        best, most = None, self._tuning.near_share
        sight = sights.at(state.pose)  # from all these poses the same sides of the target are visible
        for moved in self._along_sight(seen, state):
            in_place = self._in_place(seen, sight, moved.pose)
            if in_place is not None and in_place > most:
                best, most = moved, in_place
        return best

    def _along_sight(self, seen: JointFrame, state: State) -> list[State]:
        """Return poses along the line of sight, whose edges move by the reach of the search between two."""
        px_per_m = seen.px_per_m_along(state.pose.t, self._target.radius_m)
        step_m = self._tuning.edges.final_search_px / px_per_m if 0.0 < px_per_m < inf else inf
        return along_sight(state, sigma_m=self._ranges.bias_m, step_m=step_m)

    def _aligned(self, seen: JointFrame, sights: Sights, state: State, schedule: FloatArray) -> Aligned:
        """Return the likelier of two alignments: with and without edges that merge with others.

        The second alignment is computed only if its last steps would move the result of the first. The
        schedule has the shape (S, 2) as in ``JointProblem``, and each row is one step.
        """
        schedule = np.maximum(schedule, (self._least_scale_m(seen), 0.0))
        found = self._aligned_by(seen, sights, state, schedule, self._edge_errors)
        if not found.last.sight.expected.merged.any():
            return found
        apart = found.last._replace(edge_errors=found.last.edge_errors._replace(merged=False))
        poses = found.fit.state.pose, align(apart, found.fit.state).state.pose
        if seen.moved_px(*poses, self._target.radius_m) < LEADS_PX:
            return found
        other = self._aligned_by(seen, sights, state, schedule, self._edge_errors._replace(merged=False))
        poses = found.fit.state.pose, other.fit.state.pose
        if seen.moved_px(*poses, self._target.radius_m) < SAME_PX:
            return found
        loss, least = (self._loss(seen, each.fit.state, each.last) for each in (other, found))
        more = loss - least
        return found.beside(other, more) if more >= 0.0 else other.beside(found, -more)

    def _loss(self, seen: JointFrame, state: State, problem: JointProblem) -> float:
        """Return minus the log likelihood of a pose, from the depth of a problem and the whole image."""
        misfit = self._renderer.misfit(seen.rays, seen.per_px, state.pose, seen.patch)
        return depth_loss(problem, state) + misfit

    def _aligned_by(
        self, seen: JointFrame, sights: Sights, state: State, schedule: FloatArray, errors: EdgeErrors
    ) -> Aligned:
        """Return the pose after one step for each row of a schedule, and the problem of the last steps.

        The first steps minimise distances in the distance field, the last ones distances from the planes of
        the faces that the pixels show. The last ones are done again with a brightness that follows the image,
        and with all samples of the edges.
        """
        first, last = schedule[:-LAST_STEPS], schedule[-LAST_STEPS:]
        state = align(self._problem(seen, sights.some_at(state.pose), first, errors), state).state
        problem = self._problem(seen, sights.some_at(state.pose), last, errors)
        problem = near_the_pose(problem, self._planes(seen, state.pose))
        state = align(problem, state).state
        problem = problem._replace(sight=sights.finally_at(state.pose))
        return Aligned(align(problem, state), problem)

    def _sights(self, seen: JointFrame) -> Sights:
        return Sights(self._edges, self._renderer, seen)

    def _least_scale_m(self, seen: JointFrame) -> float:
        """Return the least Geman-McClure scale, m: an error that the noise explains must be no outlier."""
        depth = self._tuning.depth
        return depth.scale_sigmas * max(seen.noise_m, depth.noise_m)

    def _problem(
        self, seen: JointFrame, sight: EdgeSight, schedule: FloatArray, edges: EdgeErrors
    ) -> JointProblem:
        errors = self._depth_errors._replace(white_m2=seen.white_m2, spread_m2=seen.spread_m2)
        points, planes = Points(seen.points_m, seen.trust), Planes.none(len(seen.points_m))
        px_per_m, correlated_px = seen.lens.fx / seen.away_m, correlation_px(self._tuning.edges.blur_px)
        independent = min(1.0, sight.every * self._spacing_m * px_per_m / correlated_px)
        edges = edges._replace(px_per_m=px_per_m, independent=independent)
        return JointProblem(points, planes, self._field, sight, errors, edges, schedule)

    def _planes(self, seen: JointFrame, pose: PoseArrays) -> Planes:
        """Return the planes of the faces that the points' pixels show at a pose."""
        buffers = self._buffers_of(seen.view)
        cast_faces(seen.view.coarse.arrays, self._faces, pose.R, pose.t, buffers)
        return Planes.of(self._faces, buffers.triangle.ravel()[seen.pixel])

    def _registered(self, seen: JointFrame, sights: Sights, aligned: Aligned, steps: int) -> Registration:
        """Return the registration of an aligned pose, with its belief."""
        tuning, limits = self._tuning, self._tuning.acceptance
        ((R, t), bias), _, (depth, found, *_) = aligned.fit
        points, edges, checked = depth.inliers, found.inliers, found.checked
        if points < limits.min_points and checked < limits.min_edges:
            reason = f"nothing of the target is seen: {points} points on it, {checked} places of edges"
            return Registration.none(Source.PMD_JOINT, reason)
        pose, buffers = aligned.fit.state.pose, self._buffers_of(seen.view)
        inconsistent = self._check.contradictions(seen, pose, bias, buffers)
        measured, sigma_m = points >= limits.min_points, self._ranges.bias_m
        ranges = None if measured else MedianError.of(seen.every_range_m, buffers, limits.bias_sigmas)
        known, in_place = self._uncertainty(seen, sights, aligned), self._edges_in_place(seen, aligned)
        far_off = ranges.reason(limits, sigma_m, t, known.covariance) if ranges else ""
        scale = {"bias_m": bias, "sigma_m": sigma_m, "range_m": float(np.linalg.norm(t))}
        belief = frame_belief(tuning, inconsistent, in_place, **scale, far_off=far_off)
        if inconsistent.reason(tuning.check):
            marks = PixelMarks(inconsistent.marked, seen.view.stride)
            reason = "{}; most of them around pixel ({}, {})".format(belief.reason, *marks.centre_px)
            belief = replace(belief, reason=reason, marks=marks)
        return Registration(
            source_of(limits, points=points, edges=checked),
            T_sensor_target=pose_of(R, t),
            belief=belief,
            cost_m2=depth.squares_m2 / max(points, 1),
            inliers=points + edges,
            inlier_share=(points + found.found) / max(len(seen.points_m) + checked, 1),
            explained_share=inconsistent.explained_share,
            covariance=known.covariance,
            parts=known.parts,
            iterations=steps,
            range_bias_m=bias,
            by_part=by_distances(t, bias, known.bias, self._model_error.scale, measured=measured),
        )

    def _uncertainty(self, seen: JointFrame, sights: Sights, aligned: Aligned) -> Uncertainty:
        """Return the covariance of a pose, sensor axes, and its parts by how long the errors last."""
        fit, last = aligned.fit, aligned.last
        moved = seen.moved_px(last.sight.expected.pose, fit.state.pose, self._target.radius_m)
        sight = last.sight if moved < CERTAIN_PX else sights.at(fit.state.pose)
        problem = last._replace(sight=sight, schedule=self._near[-1:])
        shares = joint_shares(problem, fit.state)
        groups = grouped(problem, fit.state, shares, self._lines)
        information = fit.information + self._weak
        alone = inverse_curvature(information, groups.both.bends.sum(axis=0))
        return uncertainty(
            aligned,
            alone,
            self._model_error.added(fit, problem, shares, alone),
            assumed=np.linalg.inv(information).astype(np.float64),
            groups=groups,
            weak=self._weak,
            bias_m=self._depth_errors.bias_m,
            radius_px=seen.radius_px(self._target.radius_m),
            wider=max(1.0, seen.fills(self._target.radius_m)),
            of_body=self._target.camera_errors or 1.0,
        )

    def _edges_in_place(self, seen: JointFrame, aligned: Aligned) -> float:
        """Return the share of the expected edges found near their place, plus an allowance for chance.

        If the share is small, the edges are predicted again with more rays, which show thin parts.
        """
        limits, pose, last = self._tuning.acceptance, aligned.fit.state.pose, aligned.last
        share = edges_in_place(limits, aligned.fit.evidence.edges)
        if share >= limits.weak_edge_share or seen.per_px == FINE_RAYS:
            return share
        sight, reach_px = self._sights(seen.finely()).at(pose), last.schedule[-1, 1]
        return edges_in_place(limits, add_edge_points(no_sums(), sight, pose, reach_px, last.edge_errors))

    def _in_place(self, seen: JointFrame, sight: EdgeSight, pose: PoseArrays) -> float | None:
        """Return the share of the expected edges near their place at a pose; None if too few are seen."""
        tuning = self._tuning
        reach = tuning.edges.final_search_px
        reach *= float(np.clip(2.0 * seen.fills(self._target.radius_m), 1.0, MOST_WIDER))
        found = add_edge_points(no_sums(), sight, pose, reach, self._edge_errors)
        enough = found.checked >= tuning.acceptance.min_edges
        return found.found / max(found.expected, 1.0) if enough else None

    def _buffers_of(self, view: DepthView) -> RenderBuffers:
        shape = view.coarse.shape
        if shape not in self._buffers:
            self._buffers[shape] = Hits.of(view.coarse).arrays
        return self._buffers[shape]
