"""The whole image decides which of several alignments is likeliest; the others are part of its errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.pmd_frames import CAMERA
from tests.unit.pose.pmd.test_joint import FRAME, MOCKUP, TRACKER, TRUTH, assert_within, error, frame, off

from rpod_pose.pmd.depth_view import DepthView
from rpod_pose.pmd.joint.alternatives import (
    MOST_MOVES,
    MOST_STARTS,
    PATIENCE,
    START_PX,
    Aligned,
    along_sight,
    depth_loss,
    likeliest,
    log_likelihoods,
    start_steps,
)
from rpod_pose.pmd.joint.brightness.patch_renderer import PatchRenderer
from rpod_pose.pmd.joint.edge_model import EdgeModel
from rpod_pose.pmd.joint.edge_search import Lens, Patch
from rpod_pose.pmd.joint.expected_edges import expect_edges
from rpod_pose.pmd.joint.facets import facet_turns
from rpod_pose.pmd.joint.frame import JointFrame, moved_px
from rpod_pose.pmd.joint.tracker import JointTracker
from rpod_pose.ports import Registration
from rpod_pose.registration.brightness import faces_of, surfaces_of
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import PoseArrays, step_between
from rpod_schemas.config.pmd.joint import JointConfig
from rpod_schemas.poses import make_pose, pose_of
from rpod_schemas.types import BeliefLevel, Source
from rpod_target import load_target

DRUM = """
name: drum
mass_kg: 100.0
materials: {paint: {reflectivity: 0.5, diffuse: 0.4, f0: 0.02, roughness: 0.3}}
parts:
  - {name: drum, shape: prism, sides: 64, circumradius_m: 1.0, length_m: 1.0, material: paint}
  - {name: box, shape: box, size_m: [2.4, 0.1, 0.1], material: paint}
distance_field: {spacing_m: 0.1, margin_m: 0.2}
model_points: 100
symmetries: [{axis: [1.0, 0.0, 0.0], order: 12, continuous: true}]
"""
TUNING = JointConfig().tuning
RENDERER = PatchRenderer(MOCKUP, TUNING.edges)


def prepared(shown) -> JointFrame:
    seen = JointFrame.of(shown, TRUTH.translation, radius_m=MOCKUP.radius_m, tuning=TUNING)
    assert isinstance(seen, JointFrame)
    return seen


def misfit(seen: JointFrame, T: RigidTransform, renderer: PatchRenderer = RENDERER) -> float:
    return renderer.misfit(seen.rays, seen.per_px, PoseArrays.of(T), seen.patch)


def aligned(T: RigidTransform) -> Aligned:
    """Return an alignment with the frame's points that ends at a pose."""
    seen = prepared(FRAME)
    pose = PoseArrays.of(T)
    found = TRACKER._aligned_by(
        seen, TRACKER._sights(seen), State(pose, 0.0), TRACKER._narrow, TRACKER._edge_errors
    )
    return found._replace(fit=found.fit._replace(state=State(pose, 0.0)))


@pytest.mark.parametrize("thick_px", [0.8, 4.0])
def test_edges_of_a_panel_are_merged_where_it_is_thinner_than_the_blur(thick_px: float) -> None:
    body = load_target("hexagonal-body")
    low, high = body.triangles_m.min(axis=(0, 1)), body.triangles_m.max(axis=(0, 1))
    away_m = 4.0
    thin = thick_px * away_m / CAMERA.fx / (high - low)[1]
    panel = replace(body, triangles_m=body.triangles_m * (1.0, thin, 1.0))
    edges = EdgeModel.of(panel, spacing_m=0.02).arrays
    black = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    patch = Patch(black, black, 0.0, 0.0, 6.0, 0.5, 100.0)
    renderer, rays = PatchRenderer(panel, TUNING.edges), DepthView.of(CAMERA, 4).rays(2).arrays
    pose = PoseArrays.of(make_pose(translation_m=(0.0, 0.0, away_m)))
    exact = renderer.render(rays, 2, pose, patch).shown
    row, column, rows, columns = exact.window
    image = np.zeros_like(patch.image)
    image[row : row + rows, column : column + columns] = exact.shade * np.float32(100.0 / exact.typical)
    patch = patch._replace(image=image, unclipped=image)
    shown = renderer.render(rays, 2, pose, patch).shown
    seen = expect_edges(edges, Lens(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy), patch, shown)
    along = np.abs(edges.directions[seen.sample, 1]) < 0.5
    assert along.any()
    share = seen.merged[along].mean()
    assert share > 0.2 if thick_px < 1.0 else share < 0.05, share


def test_what_no_brightness_explains_is_greater_off_the_truth() -> None:
    seen = prepared(FRAME)
    at_truth = misfit(seen, TRUTH)
    assert at_truth > 0.0
    for seed in range(6):
        assert misfit(seen, off(TRUTH, 1.0, 0.0, seed)) > at_truth
        assert misfit(seen, off(TRUTH, 0.0, 0.02, seed)) > at_truth


def test_the_brightness_of_faces_is_fitted() -> None:
    seen = prepared(FRAME)
    shuffled = replace(MOCKUP, triangle_material=np.roll(MOCKUP.triangle_material, 40))
    renderer = PatchRenderer(shuffled, TUNING.edges)
    renderer._faces = RENDERER._faces
    as_known, exchanged = misfit(seen, TRUTH), misfit(seen, TRUTH, renderer)
    assert exchanged < misfit(seen, off(TRUTH, 2.0, 0.0))
    assert exchanged < 1.3 * as_known


def test_the_brightness_of_surfaces_follows_the_image_and_not_the_file() -> None:
    shuffled = replace(MOCKUP, triangle_material=np.roll(MOCKUP.triangle_material, 40))
    exchanged = PatchRenderer(shuffled, TUNING.edges)
    exchanged._surfaces = RENDERER._surfaces
    seen, pose = prepared(FRAME), PoseArrays.of(TRUTH)
    known, other = (
        each.render(seen.rays, seen.per_px, pose, seen.patch).shown for each in (RENDERER, exchanged)
    )
    lit = known.shade > 0.5 * known.typical
    by_file = np.abs(known.shade / known.typical - other.shade / other.typical)[lit].mean()
    by_image = np.abs(known.fitted - other.fitted)[lit].mean() / seen.patch.typical
    assert by_image < 0.2 * by_file


def test_smooth_neighbours_of_one_material_are_one_surface() -> None:
    assert len(set(surfaces_of(load_target("hexagonal-body")))) == 8  # six sides, two ends
    surface = surfaces_of(MOCKUP)
    assert 6 < len(set(surface)) < len(set(faces_of(MOCKUP)))
    for number in range(surface.max() + 1):
        assert len(set(MOCKUP.triangle_material[surface == number])) == 1


def test_triangles_of_one_plane_and_one_material_are_one_face() -> None:
    box = load_target("hexagonal-body")
    face = faces_of(box)
    for number in range(face.max() + 1):
        normals = box.normals[face == number]
        np.testing.assert_allclose(normals @ normals[0], 1.0, atol=0.001)
        assert len(set(box.triangle_material[face == number])) == 1


def test_depth_off_the_surface_costs_likelihood() -> None:
    at_truth, aside = (
        depth_loss(each.last, each.fit.state) for each in (aligned(TRUTH), aligned(off(TRUTH, 0.0, 0.05, 1)))
    )
    assert 0.0 < at_truth < aside


def test_an_alignment_as_likely_is_among_the_errors_of_another() -> None:
    T = off(TRUTH, 1.0, 0.01)
    one, other = aligned(TRUTH), aligned(T)
    step = step_between(TRUTH, T)
    np.testing.assert_allclose(one.beside(other, 0.0).spread, 0.5 * np.outer(step, step), atol=1e-12)
    assert np.trace(one.beside(other, 20.0).spread) < 1e-6


def test_the_covariance_contains_the_distance_to_the_other_alignment() -> None:
    seen = prepared(frame())
    one = aligned(TRUTH)
    other = one.beside(aligned(off(TRUTH, 2.0, 0.0)), 0.0)
    alone, beside = (TRACKER._uncertainty(seen, TRACKER._sights(seen), each) for each in (one, other))
    more = beside.covariance - alone.covariance
    assert np.degrees(np.sqrt(np.trace(more[3:, 3:]))) == pytest.approx(2.0 * np.sqrt(0.5), rel=1e-3)
    np.testing.assert_allclose(beside.parts.of_image - alone.parts.of_image, more, atol=1e-12)


def test_the_fitted_bias_shows_the_stated_share_of_an_error_of_the_ranges() -> None:
    longer = FRAME.model_copy(update={"depth_m": FRAME.depth_m + np.float32(0.004)})
    tracker = JointTracker(JointConfig(), MOCKUP, calibrated=True)
    found, other = (tracker.track(each, TRUTH) for each in (FRAME, longer))
    assert found.by_part is not None
    assert other.range_bias_m - found.range_bias_m == pytest.approx(0.004 * found.by_part.follows, rel=0.2)
    assert 0.2 < found.by_part.follows < 0.98
    assert found.by_part.follows * 0.007 < found.by_part.apart_m < 0.009


def test_from_a_prediction_some_pixels_off_the_likeliest_of_several_alignments_is_taken() -> None:
    errors = []
    for seed in range(6):
        found = TRACKER.track(FRAME, off(TRUTH, 3.0, 0.02, seed))
        errors.append(error(found))
        assert found.belief.level is BeliefLevel.ACCEPTED
    assert_within(tuple(np.max(errors, axis=0)), 0.25, 0.005)


def test_starts_lie_around_the_likeliest_pose_so_far_and_end_when_none_is_better() -> None:
    first = aligned(TRUTH)
    losses, started = iter((9.0, 9.0, 3.0, 9.0, 9.0, 9.0, 9.0)), []

    def aligned_from(start: State) -> Aligned:
        started.append(start.pose)
        return first._replace(fit=first.fit._replace(state=start))

    best = likeliest(
        first, loss=lambda _: next(losses), aligned_from=aligned_from, px_m=0.005, radius_m=MOCKUP.radius_m
    )
    assert len(started) == 2 + PATIENCE
    np.testing.assert_array_equal(best.fit.state.pose.R, started[1].R)
    near, far = (
        [moved_px(pose, each, MOCKUP.radius_m, 1.0 / 0.005) for each in started[some]]
        for pose, some in ((first.fit.state.pose, slice(2)), (started[1], slice(2, None)))
    )
    assert max(near + far) < 3.0 * START_PX
    assert min(near + far) > 0.5 * START_PX
    assert np.trace(best.spread) > 0.0


def test_a_start_that_returns_to_the_likeliest_pose_ends_the_search() -> None:
    first, started = aligned(TRUTH), []

    def aligned_from(start: State) -> Aligned:
        started.append(start)
        return first

    best = likeliest(
        first, loss=lambda _: 9.0, aligned_from=aligned_from, px_m=0.005, radius_m=MOCKUP.radius_m
    )
    assert len(started) == 1
    assert best.fit is first.fit


def test_an_unlikely_alignment_adds_nothing_to_the_errors() -> None:
    first = aligned(TRUTH)
    losses = iter([0.0] + [60.0] * PATIENCE)
    best = likeliest(
        first,
        loss=lambda _: next(losses),
        aligned_from=lambda start: first._replace(fit=first.fit._replace(state=start)),
        px_m=0.005,
        radius_m=MOCKUP.radius_m,
    )
    assert best.fit is first.fit
    assert np.trace(best.spread) < 1e-20


def test_poses_along_the_sight_leave_the_depth_where_it_is() -> None:
    state = State(PoseArrays.of(TRUTH), 0.01)
    assert along_sight(state, sigma_m=0.036, step_m=0.08) == []
    moved = along_sight(state, sigma_m=0.036, step_m=0.03)
    assert [each.bias_m for each in moved] == pytest.approx([-0.05, -0.02, 0.04, 0.07])
    range_m = np.linalg.norm(TRUTH.translation)
    for each in moved:
        assert np.linalg.norm(each.pose.t) + each.bias_m == pytest.approx(range_m + 0.01)
        np.testing.assert_allclose(np.cross(each.pose.t, TRUTH.translation), 0.0, atol=1e-12)
    assert len(along_sight(state, sigma_m=0.036, step_m=1e-3)) == 2 * MOST_MOVES


def test_the_search_around_a_pose_begins_at_the_likeliest_along_the_sight() -> None:
    first, started = aligned(TRUTH), []
    moved = along_sight(first.fit.state, sigma_m=0.036, step_m=0.03)

    def aligned_from(start: State) -> Aligned:
        started.append(start)
        return first._replace(fit=first.fit._replace(state=start))

    losses = iter((9.0, 9.0, 3.0, 9.0, 9.0, 9.0, 9.0, 9.0))
    best = likeliest(
        first,
        loss=lambda _: next(losses),
        aligned_from=aligned_from,
        px_m=0.005,
        radius_m=MOCKUP.radius_m,
        along_sight=moved,
    )
    assert started[: len(moved)] == moved
    assert len(started) == len(moved) + PATIENCE
    assert best.fit.state is moved[1]


@pytest.mark.parametrize(("loss_there", "share"), [(9.0, 0.5), (4.0, 1.0), (60.0, 0.0)])
def test_a_rival_does_not_replace_the_likeliest_pose_but_counts_in_its_spread(
    loss_there: float, share: float
) -> None:
    first, away_rad = aligned(TRUTH), np.radians(6.0)
    (R, t), _ = first.fit.state
    rival = State(PoseArrays(R @ Rotation.from_rotvec([0.0, 0.0, away_rad]).as_matrix(), t), 0.0)
    best = likeliest(
        first,
        loss=lambda each: loss_there if each.fit.state is rival else 9.0,
        aligned_from=lambda start: (
            first._replace(fit=first.fit._replace(state=start)) if start is rival else first
        ),
        px_m=0.005,
        radius_m=MOCKUP.radius_m,
        rivals=lambda _: [rival],
    )
    assert best.fit is first.fit
    among = np.exp(9.0 - loss_there) / (2.0 + np.exp(9.0 - loss_there))  # the pose itself is found twice
    assert best.spread[5, 5] == pytest.approx(among * away_rad**2, abs=1e-12)
    assert among == pytest.approx(share, abs=0.2)


def test_facets_of_a_nearly_round_body_are_turned_onto_their_neighbours(tmp_path: Path) -> None:
    (tmp_path / "drum.yaml").write_text(DRUM)
    drum = load_target(tmp_path / "drum.yaml", cache=tmp_path)
    turns = Rotation.from_matrix(facet_turns(drum)).as_rotvec(degrees=True)
    np.testing.assert_allclose(turns, np.outer((-5.625, 5.625, -11.25, 11.25), (1.0, 0.0, 0.0)), atol=1e-6)
    assert facet_turns(MOCKUP).shape == (0, 3, 3)


def test_starts_are_the_same_in_each_process() -> None:
    steps = start_steps()
    assert steps.shape == (MOST_STARTS, 2, 3)
    np.testing.assert_allclose(np.linalg.norm(steps[:, 1], axis=1), 1.0)
    assert np.abs(np.corrcoef(steps[:, 1].T)[np.triu_indices(3, 1)]).max() < 0.5


SIGMAS = np.array([0.01, 0.01, 0.01, 0.005, 0.005, 0.005])
"""Standard deviations of a registered pose, m and rad."""


@pytest.mark.parametrize(("steeper", "kept"), [(0.1, 0.1), (0.5, 0.5), (100.0, 0.5)])
def test_a_loss_that_is_steeper_than_the_covariance_is_no_more_evidence_than_this_tells(
    steeper: float, kept: float
) -> None:
    """A pose drawn from the covariance costs 3 in the mean, for which half of a difference counts."""
    poses = TRUTH, make_pose(translation_m=(3.0, 0.0, 0.0)) * TRUTH
    found = [Registration(Source.PMD_JOINT, T, covariance=np.diag(SIGMAS**2)) for T in poses]

    def loss(state: State) -> float:
        near = min(poses, key=lambda T: float(np.linalg.norm(T.translation - state.pose.t)))
        step = step_between(near, pose_of(*state.pose)) / SIGMAS
        return steeper * (0.5 * float(step @ step) + 8.0 * (near is poses[1]))

    logs = log_likelihoods(found, loss)
    assert logs[0] - logs[1] == pytest.approx(8.0 * kept, rel=0.35)


def test_where_only_the_order_of_poses_counts_each_is_compared_once() -> None:
    found = [Registration(Source.PMD_JOINT, T, covariance=np.diag(SIGMAS**2)) for T in (TRUTH, TRUTH)]
    losses = [7.0, 3.0]
    logs = log_likelihoods(found, lambda _: losses.pop(0), ranked_only=True)
    assert logs.tolist() == [-7.0, -3.0]


def test_a_frame_is_rendered_again_only_where_the_target_has_moved_in_it() -> None:
    sights, seen = TRACKER._sights(prepared(FRAME)), prepared(FRAME)
    across_m = seen.away_m / seen.lens.fx
    near, far = (off(TRUTH, 0.0, pixels * across_m, 1) for pixels in (0.05, 5.0))
    first = sights.at(PoseArrays.of(TRUTH))
    assert sights.at(PoseArrays.of(near)) is first
    other = sights.at(PoseArrays.of(far))
    assert other is not first
    assert sights.at(PoseArrays.of(far)) is other
    assert sights.at(PoseArrays.of(near)) is first
