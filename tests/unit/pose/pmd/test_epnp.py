from functools import cache

import numpy as np
import pytest
from pmd_frames import CAMERA, strange_frames
from pmd_views import mockup, pmd_view
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.pmd.paper_2018.edge_lines import ImageLine, intersection
from rpod_pose.pmd.paper_2018.epnp import EpnpTracker
from rpod_schemas.config.motion import FACING
from rpod_schemas.config.pmd.amplitude import EpnpConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import Source
from rpod_target import load_target

FRONTAL = make_pose(rotation=FACING, translation_m=(0.05, -0.03, 5.0))
OBLIQUE = make_pose(
    rotation=Rotation.from_euler("y", 30, degrees=True) * FACING, translation_m=(0.1, 0.0, 4.0)
)
epnp = cache(lambda points="front", **fields: EpnpTracker(EpnpConfig(points=points, **fields), mockup()))
view = cache(pmd_view)


def off(T, degrees, metres, axis=(0.6, 0.64, -0.48)):
    turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array(axis))
    return T * RigidTransform.from_components(metres * np.array(axis), turn)


def errors(T_truth, registration):
    assert registration.belief.reason == ""
    assert registration.source == Source.PMD_AMPLITUDE
    attitude_rad, position_m = pose_error(T_truth, registration.T_sensor_target)
    return np.rad2deg(np.linalg.norm(attitude_rad)), np.linalg.norm(position_m)


@pytest.mark.parametrize("points", ["front", "all"])
@pytest.mark.parametrize("T", [FRONTAL, OBLIQUE], ids=["frontal", "oblique"])
@pytest.mark.parametrize(("degrees", "metres"), [(0.0, 0.0), (2.0, 0.05), (5.0, 0.06)])
def test_the_pose_is_found_from_a_prediction_nearby(T, degrees, metres, points):
    attitude_deg, position_m = errors(T, epnp(points).track(view(T), off(T, degrees, metres)))
    assert attitude_deg < 0.7
    assert position_m < 0.02


def test_a_turn_about_the_boresight_is_followed_without_a_prediction():
    T, estimate = FRONTAL, FRONTAL
    for number in range(4):
        T = off(T, 5.0, 0.0, (1, 0, 0))
        registration = epnp().track(pmd_view(T, number=number), estimate)
        assert errors(T, registration)[0] < 0.7
        estimate = registration.T_sensor_target


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_the_amplitude_may_be_of_any_kind(dtype):
    frame = view(FRONTAL)
    scaled = np.minimum(frame.amplitude / 8.0, 255.0).astype(dtype)
    same = frame.model_copy(update={"amplitude": scaled})
    assert errors(FRONTAL, epnp().track(same, FRONTAL))[0] < 1.0


def test_the_lens_distortion_is_taken_into_account():
    lens = CAMERA.model_copy(update={"distortion": np.array([-1.0, 0.0, 0.002, -0.001, 0.0])})
    T = make_pose(rotation=FACING, translation_m=(0.5, 0.25, 4.0))
    frame = pmd_view(T, camera=lens)
    attitude_deg, position_m = errors(T, epnp().track(frame, off(T, 1.0, 0.02)))
    assert attitude_deg < 0.7
    assert position_m < 0.02
    straight = epnp().track(frame.model_copy(update={"camera": CAMERA}), off(T, 1.0, 0.02))
    assert straight.belief.reason or errors(T, straight)[1] > 0.02


def test_depth_is_not_asked():
    blind = view(FRONTAL).model_copy(update={"depth_m": np.full_like(view(FRONTAL).depth_m, np.nan)})
    assert errors(FRONTAL, epnp().track(blind, FRONTAL))[0] < 0.7


@pytest.mark.parametrize("frame", strange_frames().values(), ids=strange_frames().keys())
def test_no_frame_raises_and_without_a_pose_there_is_a_reason(frame):
    registration = epnp().track(frame, FRONTAL)
    assert registration.source == Source.PMD_AMPLITUDE
    assert registration.T_sensor_target is None
    assert registration.belief.reason


@pytest.mark.parametrize("z", [-5.0, 0.0, 0.3, 40.0, 1e4])
def test_a_prediction_far_from_the_image_is_a_reason(z):
    guess = make_pose(rotation=FACING, translation_m=(0.0, 0.0, z))
    assert epnp().track(view(FRONTAL), guess).belief.reason


def test_corners_of_one_plane_without_the_nose_are_a_reason():
    frame = view(FRONTAL)
    centre = (CAMERA.cx + CAMERA.fx * 0.05 / 4.6, CAMERA.cy - CAMERA.fy * 0.03 / 4.6)
    row, column = np.indices(frame.amplitude.shape)
    noseless = frame.amplitude.copy()
    noseless[np.hypot(column - centre[0], row - centre[1]) < 0.2 * CAMERA.fx / 4.6] = 300
    registration = epnp().track(frame.model_copy(update={"amplitude": noseless}), FRONTAL)
    assert "in one plane" in registration.belief.reason


def test_too_few_corners_are_a_reason():
    frame = view(FRONTAL)
    half = frame.amplitude.copy()
    half[:, : int(CAMERA.cx + 20)] = 0
    assert (
        "corners and circles found"
        in epnp().track(frame.model_copy(update={"amplitude": half}), FRONTAL).belief.reason
    )


def test_a_target_without_a_face_towards_the_camera_is_a_reason():
    behind = make_pose(rotation=FACING, translation_m=(0.0, 0.0, 0.2))
    assert epnp().track(view(FRONTAL), behind).belief.reason


def test_another_target_s_prediction_is_a_reason_or_no_pose_is_believed():
    other = EpnpTracker(EpnpConfig(), load_target("envisat-slim"))
    assert other.track(view(FRONTAL), FRONTAL).belief.reason


def test_the_nearest_place_to_three_lines_through_a_point_is_the_point():
    lines = []
    for angle in (0.1, 1.2, 2.2):
        normal = np.array((np.cos(angle), np.sin(angle)))
        lines.append(ImageLine(normal, float(normal @ (30.0, 40.0))))
    assert np.allclose(intersection(lines, min_turn_rad=0.2), (30.0, 40.0))


def test_lines_that_hardly_cross_have_no_intersection():
    normal = np.array((np.cos(0.1), np.sin(0.1)))
    lines = [ImageLine(np.array((1.0, 0.0)), 5.0), ImageLine(normal, 5.0)]
    assert intersection(lines, min_turn_rad=0.2) is None
    assert intersection(lines[:1], min_turn_rad=0.2) is None
