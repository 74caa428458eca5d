from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pmd_frames import CAMERA, depth_frame, frame_of, strange_frames
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.pmd.depth_view import DepthView, usable_image
from rpod_pose.pmd.paper_2018.icp_reverse_calibration import (
    DIRECT,
    NEAREST,
    NO_MATCH,
    DepthPixels,
    MatchReach,
    Pairs,
    ReverseCalibrationIcp,
    find_matches,
)
from rpod_pose.registration.lie_group import moved
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd.methods import (
    DepthImageConfig,
    IcpReverseCalibrationConfig,
)
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import Source
from rpod_target import load_target

FRONTAL = make_pose(rotation=FACING, translation_m=(0.05, -0.03, 5.0))
OBLIQUE = make_pose(
    rotation=Rotation.from_euler("y", 35, degrees=True) * FACING, translation_m=(0.1, 0.0, 4.0)
)
mockup = cache(lambda: load_target("mockup"))
LIMITS = {"tolerance_m": 0.12, "missing_weight": 0.25}


def off(T, degrees, metres, axis=(0.6, 0.64, -0.48)):
    """Return the pose turned about a target axis and shifted along it."""
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array(axis))
    return T * RigidTransform.from_components(metres * np.array(axis), turn)


def icp(**fields):
    return ReverseCalibrationIcp(IcpReverseCalibrationConfig(**fields), mockup())


def errors(T_truth, registration):
    assert registration.belief.reason == ""
    attitude_rad, position_m = pose_error(T_truth, registration.T_sensor_target)
    return np.rad2deg(np.linalg.norm(attitude_rad)), np.linalg.norm(position_m)


@pytest.mark.parametrize("T", [FRONTAL, OBLIQUE])
@pytest.mark.parametrize(("degrees", "metres"), [(0.0, 0.0), (3.0, 0.05), (10.0, 0.15)])
def test_the_pose_is_found_from_a_prediction_nearby(T, degrees, metres):
    frame = depth_frame(mockup(), T, noise_m=0.01)
    attitude_deg, position_m = errors(T, icp().track(frame, off(T, degrees, metres)))
    assert attitude_deg < 1.2
    assert position_m < 0.01


def test_the_roll_about_the_boresight_is_found_although_a_flat_face_does_not_show_it():
    T = make_pose(rotation=FACING, translation_m=(0.0, 0.0, 7.0))
    attitude_deg, _ = errors(
        T, icp().track(depth_frame(mockup(), T, noise_m=0.01), off(T, 8.0, 0.0, (1, 0, 0)))
    )
    assert attitude_deg < 1.5


def test_a_spinning_target_is_followed_without_a_prediction():
    T, tracker = FRONTAL, icp()
    estimate = T
    for number in range(8):
        T = off(T, 2.0, 0.0, (1, 0, 0))
        registration = tracker.track(depth_frame(mockup(), T, noise_m=0.01, seed=number), estimate)
        assert errors(T, registration)[0] < 1.5
        estimate = registration.T_sensor_target


def test_the_paper_s_metric_follows_a_turn_less_than_ours():
    frame, guess = depth_frame(mockup(), FRONTAL, noise_m=0.01), off(FRONTAL, 6.0, 0.02)
    points = icp(metric="point_to_point", unsettled_m=1.0).track(frame, guess)
    assert errors(FRONTAL, icp().track(frame, guess))[0] < errors(FRONTAL, points)[0] < 7.0


def test_the_lens_distortion_is_taken_into_account():
    lens = CAMERA.model_copy(update={"distortion": np.array([-1.0, 0.0, 0.002, -0.001, 0.0])})
    T = make_pose(rotation=FACING, translation_m=(0.6, 0.3, 4.0))
    frame = depth_frame(mockup(), T, camera=lens)
    assert errors(T, icp().track(frame, off(T, 2.0, 0.02)))[1] < 0.01
    straight = frame.model_copy(update={"camera": CAMERA})
    assert errors(T, icp().track(straight, off(T, 2.0, 0.02)))[1] > 0.01


@pytest.mark.parametrize("metric", ["point_to_plane", "point_to_point"])
@pytest.mark.parametrize("frame", strange_frames().values(), ids=strange_frames().keys())
def test_no_frame_raises_and_without_a_pose_there_is_a_reason(frame, metric):
    registration = icp(metric=metric).track(frame, FRONTAL)
    assert registration.source == Source.PMD_DEPTH
    assert bool(registration.belief.reason) != registration.continues_track


@pytest.mark.parametrize("z", [-5.0, 0.0, 0.3, 1e4])
def test_a_prediction_far_from_the_image_is_a_reason(z):
    guess = make_pose(rotation=FACING, translation_m=(0.0, 0.0, z))
    assert "model points matched" in icp().track(depth_frame(mockup(), FRONTAL), guess).belief.reason


def test_too_little_depth_is_a_reason():
    assert "0 pixels with depth" in icp().track(frame_of(np.nan), FRONTAL).belief.reason


def test_a_last_step_too_long_is_a_reason():
    registration = icp(iterations=1).track(depth_frame(mockup(), FRONTAL), off(FRONTAL, 8.0, 0.1))
    assert "did not converge" in registration.belief.reason
    assert registration.T_sensor_target is None


def test_a_surface_that_shows_no_turn_is_degenerate():
    y, z = np.meshgrid(np.linspace(-0.4, 0.4, 20), np.linspace(-0.4, 0.4, 20))
    face_m = np.column_stack((np.zeros(400), y.ravel(), z.ravel()))
    flat = replace(mockup(), model_points_m=face_m, model_normals=np.tile((1.0, 0.0, 0.0), (400, 1)))
    tracker = ReverseCalibrationIcp(IcpReverseCalibrationConfig(cover_points=0), flat)
    assert "degenerate" in tracker.track(frame_of(5.0), FRONTAL).belief.reason


def test_the_same_frame_gives_the_same_registration():
    frame, guess = depth_frame(mockup(), OBLIQUE, noise_m=0.02), off(OBLIQUE, 3.0, 0.03)
    first, second = icp().track(frame, guess), icp().track(frame, guess)
    assert np.array_equal(first.T_sensor_target.as_matrix(), second.T_sensor_target.as_matrix())
    assert np.array_equal(first.covariance, second.covariance)


def test_the_covariance_is_largest_along_the_line_of_sight_and_positive():
    covariance = icp().track(depth_frame(mockup(), FRONTAL, noise_m=0.01), FRONTAL).covariance
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    assert np.allclose(covariance, covariance.T)
    assert np.argmax(np.diag(covariance)[:3]) == 2
    assert np.sqrt(covariance[2, 2]) == pytest.approx(0.02, rel=0.2)


def test_a_right_pose_is_explained_and_a_turned_one_less_so():
    image = usable_image(depth_frame(mockup(), FRONTAL, noise_m=0.01), DepthImageConfig())
    right, turned, aside = (
        image.compare(mockup(), T, **LIMITS)
        for T in (FRONTAL, off(FRONTAL, 60.0, 0.0, (1, 0, 0)), off(FRONTAL, 0.0, 0.3, (0, 1, 0)))
    )
    assert right.explained_share > 0.98
    assert right.cost_m2 < turned.cost_m2 < aside.cost_m2
    assert aside.explained_share < 0.7


def test_lost_depth_contradicts_less_than_foreign_depth():
    frame = depth_frame(mockup(), FRONTAL)
    seen = np.isfinite(frame.depth_m)
    left = seen & (np.arange(CAMERA.width) < CAMERA.cx)
    lost = frame_of(np.where(left, np.nan, frame.depth_m))
    foreign = frame_of(np.where(left, 3.0, frame.depth_m))
    share = {
        name: usable_image(image, DepthImageConfig()).compare(mockup(), FRONTAL, **LIMITS).explained_share
        for name, image in (("lost", lost), ("foreign", foreign))
    }
    assert share["lost"] > 0.75
    assert share["foreign"] < 0.6


def test_faint_depth_beside_a_bright_target_is_dropped_as_a_ghost():
    frame = depth_frame(mockup(), FRONTAL)
    seen = np.isfinite(frame.depth_m)
    amplitude = np.where(seen, 2000, 4).astype(np.uint16)
    haunted = frame_of(np.where(seen, frame.depth_m, 4.5), amplitude=amplitude)
    image = usable_image(haunted, DepthImageConfig())
    assert np.array_equal(np.isfinite(image.depth_m), seen)


def test_noise_is_lower_where_depth_is_thinned_and_outlines_stay():
    frame = depth_frame(mockup(), FRONTAL, noise_m=0.05)
    ideal_m = depth_frame(mockup(), FRONTAL).depth_m[2::4, 2::4]
    coarse_m = usable_image(frame, DepthImageConfig()).coarse_m
    both = np.isfinite(coarse_m) & np.isfinite(ideal_m)
    assert np.median(np.abs(coarse_m - ideal_m)[both]) < 0.5 * 0.6745 * 0.05
    assert np.count_nonzero(both) > 0.98 * max(np.isfinite(coarse_m).sum(), np.isfinite(ideal_m).sum())


def test_hidden_model_points_are_not_matched():
    T = make_pose(rotation=Rotation.from_euler("y", 60, degrees=True) * FACING, translation_m=(0, 0, 4.0))
    view, target = DepthView.of(CAMERA, 4), mockup()
    shown_m = T.apply(target.model_points_m[icp()._shown(view, T)])
    rays = RayGrid.pinhole(CAMERA)
    depth_m = cast(rays, target.triangles_m, T).range_m * rays.components[2]
    column, row = np.rint(view.project(shown_m)).astype(int).T
    behind_m = shown_m[:, 2] - depth_m[row, column]
    assert len(shown_m) > 200
    assert np.mean(behind_m > 0.06) < 0.025


def test_points_seen_obliquely_are_not_matched():
    T = OBLIQUE
    target, view = mockup(), DepthView.of(CAMERA, 4)
    sight_m = T.inv().translation - target.model_points_m
    cosine = (sight_m * target.model_normals).sum(axis=1) / np.linalg.norm(sight_m, axis=1)
    all_sides, front = icp(min_cosine=0.0)._shown(view, T), icp(min_cosine=0.3)._shown(view, T)
    assert cosine[all_sides].min() < 0.15
    assert set(front) == {index for index in all_sides if cosine[index] > 0.3}


def test_the_paper_s_metric_is_not_dragged_aside_by_faces_that_nothing_measured():
    T = make_pose(rotation=FACING, translation_m=(0.0, 0.05, 6.7))
    guess = off(make_pose(translation_m=(0.0, 0.0, 0.25)) * T, 5.0, 0.0, (1, 0, 0))
    tilt_deg = []
    for cosine in (0.0, 0.3):
        paper = icp(metric="point_to_point", unsettled_m=1.0, iterations=40, min_cosine=cosine)
        estimate = paper.track(depth_frame(mockup(), T, noise_m=0.01), guess).T_sensor_target
        tilt_deg.append(np.rad2deg(np.linalg.norm(pose_error(T, estimate)[0][1:])))
    assert tilt_deg[1] < 3.0 < tilt_deg[0]


SLOPES = np.stack(np.meshgrid(np.arange(20) / 100.0 - 0.1, np.arange(20) / 100.0 - 0.1), axis=-1)


def matches(depth, *, at=(0.0, 0.0, 5.0), radius=3, direct=0.2, gate=10.0):
    point = np.array([at])
    pixel = 100.0 * (point[:, :2] / point[:, 2:] + 0.1)
    measured, kind = find_matches(
        point, pixel, DepthPixels(depth.astype(np.float32), SLOPES), MatchReach(radius, direct, gate)
    )
    return measured[0], kind[0]


def test_the_mean_depth_near_the_model_point_is_its_match():
    depth = np.full((20, 20), 5.1)
    depth[9], depth[11] = 5.0, 5.05
    measured, kind = matches(depth)
    assert kind == DIRECT
    assert np.allclose(measured, (0.0, 0.0, 5.05), atol=2e-3)


def test_the_nearest_neighbour_is_searched_in_a_circle_where_the_depth_beneath_disagrees():
    depth = np.full((20, 20), np.nan)
    depth[10, 13], depth[13, 13] = 5.0, 5.0
    measured, kind = matches(depth)
    assert kind == NEAREST
    assert np.allclose(measured, (0.15, 0.0, 5.0))
    depth[10, 13] = np.nan
    assert matches(depth)[1] == NO_MATCH, "the corner of the window lies outside of the circle"


def test_there_is_no_match_beyond_the_gate_nor_where_the_border_cuts_the_neighbourhood():
    depth = np.full((20, 20), np.nan)
    depth[10, 12] = 5.0
    assert matches(depth)[1] == NEAREST
    assert matches(depth, gate=0.05)[1] == NO_MATCH
    depth[10, 2] = 5.0
    assert matches(depth, at=(-0.45, 0.0, 5.0))[1] == NO_MATCH
    assert matches(depth, at=(-5.0, 0.0, 5.0))[1] == NO_MATCH


@given(st.integers(0, 2**32 - 1))
def test_the_closed_form_recovers_a_motion(seed):
    rng = np.random.default_rng(seed)
    T = make_pose(rotation=Rotation.random(random_state=seed), translation_m=rng.normal(size=3))
    model = rng.normal(size=(20, 3))
    measured, kind = T.apply(model), np.full(20, NEAREST, np.uint8)
    measured[3], kind[3] = 1e3, NO_MATCH
    found = Pairs(model, model, measured, kind).best_motion()
    assert np.allclose(found.as_matrix(), T.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("kind", [DIRECT, NEAREST])
def test_the_gradient_is_the_derivative_of_half_the_squared_residuals(kind):
    rng = np.random.default_rng(2)
    model, measured = rng.normal(size=(9, 3)), rng.normal(size=(9, 3))
    normals = rng.normal(size=(9, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    T = make_pose(rotation=Rotation.random(random_state=1), translation_m=(0.3, -0.2, 0.5))
    kinds, equal = np.full(9, kind, np.uint8), 1e6

    def half_cost(step):
        e = moved(T, step).inv().apply(measured) - model
        residual = (e * normals).sum(axis=1) if kind == DIRECT else np.linalg.norm(e, axis=1)
        return 0.5 * (residual**2).sum()

    gradient = Pairs(model, normals, measured, kinds).equations(T, scale_m=equal, outline_weight=1.0).gradient
    numeric = [(half_cost(1e-6 * row) - half_cost(-1e-6 * row)) / 2e-6 for row in np.eye(6)]
    assert np.allclose(gradient, numeric, rtol=1e-5, atol=1e-6)
