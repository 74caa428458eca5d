import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pmd_frames import CAMERA
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.pmd.paper_2018.perspective import Correspondences, Fit, fitted, pose_from_points
from rpod_schemas.config.motion import FACING
from rpod_schemas.poses import make_pose, pose_error

ANGLE = np.arange(6) * np.pi / 3.0
HEXAGON = 0.5 * np.stack((np.zeros(6), np.cos(ANGLE), np.sin(ANGLE)), axis=1)
PAPER = np.vstack((HEXAGON, (0.4, 0.0, 0.0)))
"""The 2018 paper's seven points."""
POSE = make_pose(rotation=Rotation.from_euler("y", 20, degrees=True) * FACING, translation_m=(0.1, -0.2, 4.0))


def seen(T, *, points_m=PAPER, noise_px=0.0, seed=0) -> Correspondences:
    at = T.apply(points_m)
    pixels = at[:, :2] / at[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)
    noise = noise_px * np.random.default_rng(seed).standard_normal(pixels.shape)
    return Correspondences(points_m, pixels + noise)


def fit_of(points, iterations=10) -> Fit:
    fit = pose_from_points(points, CAMERA, iterations=iterations)
    assert fit is not None
    return fit


@given(
    turn=st.tuples(*[st.floats(-0.6, 0.6)] * 3),
    place=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(2.0, 8.0)),
)
@settings(max_examples=50, deadline=None)
def test_seven_exact_points_give_the_exact_pose(turn, place):
    T = make_pose(rotation=Rotation.from_rotvec(turn) * FACING, translation_m=place)
    attitude_rad, position_m = pose_error(T, fit_of(seen(T)).T_sensor_target)
    assert np.linalg.norm(attitude_rad) < 1e-5
    assert np.linalg.norm(position_m) < 1e-5


def test_the_refinement_reprojects_no_worse_than_epnp_and_ends_in_a_minimum():
    points = seen(POSE, noise_px=0.5)
    rough, fine = fit_of(points, 0), fit_of(points)
    assert fine.rms_px < rough.rms_px
    for axis in np.eye(6):
        for side in (-1e-4, 1e-4):
            step = RigidTransform.from_components(side * axis[:3], Rotation.from_rotvec(side * axis[3:]))
            beside = fitted(points, CAMERA, fine.T_sensor_target * step, iterations=0)
            assert beside is not None
            assert beside.rms_px > fine.rms_px


def test_the_covariance_is_that_of_the_errors():
    squares = []
    for seed in range(300):
        fit = fit_of(seen(POSE, noise_px=0.5, seed=seed))
        T = fit.T_sensor_target
        turn = (T.rotation * POSE.rotation.inv()).as_rotvec()
        error = np.concatenate((T.translation - POSE.translation, turn))
        squares.append(error @ np.linalg.solve(fit.covariance(0.5), error))
    assert 4.5 < np.mean(squares) < 7.5


def test_relief_tells_coplanar_points():
    assert seen(POSE, points_m=HEXAGON).relief == pytest.approx(0.0, abs=1e-9)
    assert seen(POSE).relief > 0.2
    assert Correspondences(np.zeros((5, 3)), np.zeros((5, 2))).relief == 0.0


def test_points_that_leave_a_motion_undetermined_have_no_covariance():
    twice = np.vstack((PAPER[:2], PAPER[:2], PAPER[:2]))
    fit = fitted(seen(POSE, points_m=twice), CAMERA, POSE, iterations=0)
    assert fit is not None
    assert np.isnan(fit.covariance(0.3)).all()


def test_a_pose_behind_the_camera_is_none():
    behind = make_pose(rotation=FACING, translation_m=(0.0, 0.0, -4.0))
    assert fitted(seen(POSE), CAMERA, behind, iterations=0) is None


def test_a_point_can_be_dropped():
    points = seen(POSE).without(6)
    assert len(points) == 6
    assert np.array_equal(points.points_m, HEXAGON)
