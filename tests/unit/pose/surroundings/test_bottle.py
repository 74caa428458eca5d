"""A real depth image: a bottle of 0.2 m on a table, another bottle behind it, and the room around."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.measurement import Measurement
from rpod_pose.methods import methods_of
from rpod_pose.navigation.navigator import Navigator
from rpod_schemas.config.estimator import EstimatorSettings, PmdInput
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import Camera, Mode, PmdFrame
from rpod_target import load_target

FOLDER = Path(__file__).parents[3] / "recordings" / "depth_bottle"
INPUT = PmdInput(name="front")


def of_rows(*rows) -> RigidTransform:
    return RigidTransform.from_matrix([*rows, (0.0, 0.0, 0.0, 1.0)])


@cache
def pose() -> RigidTransform:
    """Return T_camera_target, from poses in the colour camera, of the cameras, and of the mesh."""
    body_colour = of_rows(
        (0.607676, 0.408914, -0.680823, 0.297794),
        (0.786584, -0.428213, 0.444880, -0.189009),
        (-0.109620, -0.805867, -0.581860, 0.255284),
    )
    colour_depth = of_rows(
        (0.99985489, 0.00778240, 0.01509715, 0.01453388),
        (-0.00782678, 0.99996543, 0.00288261, 0.00013995),
        (-0.01507424, -0.00300036, 0.99988175, 0.00051057),
    )
    mesh_in_body = make_pose(translation_m=(0.0, 0.0, -0.097))
    mesh_in_target = make_pose(translation_m=(-2.3728e-05, -0.00012268, -0.099853298))
    return (body_colour * colour_depth).inv() * mesh_in_body * mesh_in_target.inv()


@cache
def frame() -> PmdFrame:
    millimetres = cv2.imread(str(FOLDER / "depth.png"), cv2.IMREAD_UNCHANGED)
    depth_m = np.where(millimetres == 0, np.nan, 1e-3 * millimetres).astype(np.float32)
    camera = Camera(height=480, width=848, fx=425.773, fy=425.773, cx=427.202, cy=237.662)
    return PmdFrame(stamp_ns=10**9, frame_id="front_optical", depth_m=depth_m, amplitude=None, camera=camera)


@cache
def navigator() -> Navigator:
    target = load_target(FOLDER / "bottle.yaml")
    settings = EstimatorSettings(sensors=(INPUT,))
    return Navigator(
        settings,
        {"front": methods_of(INPUT, target)},
        centre_of_mass_m=target.centre_of_mass_m,
        alike=target.equivalence,
    )


def error(found: RigidTransform) -> tuple[float, float]:
    """Return the attitude error, modulo half a turn, deg, and that of the position, m."""
    turns = [make_pose(rotation=Rotation.from_rotvec(angle * np.array([0, 0, 1]))) for angle in (0.0, np.pi)]
    errors = [[np.linalg.norm(part) for part in pose_error(pose() * turn, found)] for turn in turns]
    attitude_rad, position_m = min(errors)
    return float(np.degrees(attitude_rad)), float(position_m)


@pytest.mark.parametrize("seed", [0, 7])
def test_the_bottle_is_tracked_from_a_guess_15_deg_and_5_cm_off(seed):
    rng = np.random.default_rng(seed)
    axis, way = (each / np.linalg.norm(each) for each in rng.normal(size=(2, 3)))
    state = navigator().start(
        make_pose(
            rotation=Rotation.from_rotvec(np.radians(15.0) * axis) * pose().rotation,
            translation_m=pose().translation + 0.05 * way,
        )
    )
    for stamp_ns in (10**8, 2 * 10**8):
        event = Measurement("front", frame().model_copy(update={"stamp_ns": stamp_ns}), make_pose())
        state, output = navigator().step(state, event)
    assert output.status.mode == Mode.TRACKING, output.status.reason
    attitude_deg, position_m = error(output.odometry.pose)
    assert attitude_deg < 10.0
    assert position_m < 0.015
