from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pmd_frames import depth_frame, strange_frames
from pydantic import ValidationError
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.pmd.signed_distance import SignedDistanceTracker, measured_equations
from rpod_pose.registration.distance_field import distance_and_gradient, field_arrays
from rpod_pose.registration.lie_group import moved, turned
from rpod_pose.registration.normal_equations import NormalEquations
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd.methods import SignedDistanceConfig, SignedDistanceTuning
from rpod_schemas.poses import make_pose, pose_error
from rpod_target import TargetError, load_target

POSE = make_pose(rotation=Rotation.from_euler("y", 25, degrees=True) * FACING, translation_m=(0.1, -0.1, 4.0))
mockup = cache(lambda: load_target("mockup"))
inside = st.floats(0.0, 4.0)


@given(inside, inside, inside)
def test_a_linear_field_is_interpolated_exactly(x, y, z):
    i, j, k = np.indices((6, 6, 6))
    values = (0.5 * i - 0.25 * j + 2.0 * k + 1.0).astype(np.float32)
    found = distance_and_gradient(x, y, z, values)
    assert np.allclose(
        (found.distance, *found.gradient), (0.5 * x - 0.25 * y + 2.0 * z + 1.0, 0.5, -0.25, 2.0), atol=1e-5
    )


def test_the_gradient_is_that_of_the_interpolation():
    values = np.random.default_rng(1).normal(size=(4, 4, 4)).astype(np.float32)
    at = np.array([1.3, 2.6, 0.4])
    gradient = distance_and_gradient(*at, values).gradient
    numeric = [
        (distance_and_gradient(*(at + h), values)[0] - distance_and_gradient(*(at - h), values)[0]) / 2e-5
        for h in 1e-5 * np.eye(3)
    ]
    assert np.allclose(gradient, numeric, atol=1e-4)


def test_outside_the_grid_the_border_answers():
    values = np.arange(27, dtype=np.float32).reshape(3, 3, 3)
    assert distance_and_gradient(-5.0, 1.0, 1.0, values)[0] == pytest.approx(4.0)
    assert distance_and_gradient(1e300, np.inf, 1e9, values).distance == pytest.approx(26.0, abs=0.1)


def test_a_place_that_is_not_a_number_is_in_the_first_cell():
    values = np.arange(27, dtype=np.float32).reshape(3, 3, 3)
    assert distance_and_gradient(np.nan, np.nan, np.nan, values).distance == 0.0


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_a_turn_is_a_rotation_by_its_vector(vector):
    R = Rotation.from_euler("xyz", [0.1, 0.2, 0.3])
    expected = (R * Rotation.from_rotvec(vector)).as_matrix()
    assert np.allclose(turned(R.as_matrix(), np.array(vector)), expected, atol=1e-9)


def test_the_gradient_of_the_equations_is_the_derivative_of_half_the_squared_distances():
    field = field_arrays(mockup())
    points = POSE.apply(np.array([[0.013, 0.21, 0.23], [0.31, 0.105, 0.02], [0.027, -0.3, 0.12]]))

    def half_cost(step):
        q = (moved(POSE, step).inv().apply(points) - field[0]) / field[1]
        return 0.5 * sum(distance_and_gradient(*place, field[2])[0] ** 2 for place in q)

    gradient = measured_equations(mockup(), points, POSE, 1e6).gradient
    numeric = [(half_cost(1e-5 * row) - half_cost(-1e-5 * row)) / 2e-5 for row in np.eye(6)]
    assert np.allclose(gradient, numeric, rtol=1e-3, atol=1e-6)


def test_a_face_turned_away_from_the_camera_is_not_matched():
    pose = make_pose(rotation=FACING, translation_m=np.array([0.0, 0.0, 4.0]))
    sums = measured_equations(mockup(), pose.apply(np.array([[-0.81, 0.0, 0.0]])), pose, 0.1)
    assert (sums.weight, sums.inliers) == (0.0, 0)
    assert not sums.information.any()


@pytest.mark.parametrize(("degrees", "metres"), [(2.0, 0.03), (10.0, 0.15)])
def test_the_pose_is_found_from_a_prediction_nearby(degrees, metres):
    guess = POSE * RigidTransform.from_components(
        metres * np.array([0.6, 0.0, 0.8]),
        Rotation.from_rotvec(np.deg2rad(degrees) * np.array([0.8, 0.6, 0.0])),
    )
    tracker = SignedDistanceTracker(SignedDistanceConfig(), mockup())
    registration = tracker.track(depth_frame(mockup(), POSE, noise_m=0.01), guess)
    attitude_rad, position_m = pose_error(POSE, registration.T_sensor_target)
    assert np.rad2deg(np.linalg.norm(attitude_rad)) < 1.5
    assert np.linalg.norm(position_m) < 0.015
    assert registration.explained_share > 0.95
    assert registration.inlier_share > 0.8


@pytest.mark.parametrize("frame", strange_frames().values(), ids=strange_frames().keys())
def test_no_frame_raises_and_without_a_pose_there_is_a_reason(frame):
    registration = SignedDistanceTracker(SignedDistanceConfig(), mockup()).track(frame, POSE)
    assert bool(registration.belief.reason) != registration.continues_track


def test_a_target_without_a_field_cannot_be_tracked_by_its_field():
    with pytest.raises(TargetError):
        SignedDistanceTracker(SignedDistanceConfig(), replace(mockup(), field=None))


def test_a_scale_that_widens_is_refused():
    with pytest.raises(ValidationError, match="must not exceed"):
        SignedDistanceTuning(scale_m=0.05, final_scale_m=0.1)


def test_a_turn_about_a_free_axis_need_not_be_determined():
    axis = np.array([0.0, 0.6, 0.8])
    free = np.concatenate((np.zeros(3), axis))
    sums = NormalEquations(np.eye(6) - np.outer(free, free), np.zeros(6), 1.0, 0.0, 10)
    assert sums.degenerate(1.0)
    assert not sums.without_turn(axis[None]).degenerate(1.0)
    assert sums.without_turn(np.eye(3)[:1]).degenerate(1.0)
    assert sums.without_turn(np.zeros((0, 3))) is sums
