"""Walls, stands and arms that the emulated sensors see beside the target."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.surroundings import BoxThing, CylinderThing, MeshThing, Thing
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_sim_sensor.surroundings import MeshOfSurroundingsError
from rpod_target import load_target

CAMERA = Camera(width=60, height=50, fx=100.0, fy=100.0, cx=29.5, cy=24.5)
ROOM = BoxThing(kind="box", size_m=(4.0, 4.0, 10.0), pose=make_pose(translation_m=(0.0, 0.0, 1.0)))
PLATE = BoxThing(kind="box", size_m=(0.6, 3.0, 0.02), pose=make_pose(translation_m=(0.4, 0.0, 2.0)))
ARM = CylinderThing(
    kind="cylinder",
    radius_m=0.1,
    length_m=1.0,
    fixed_to="target",
    pose=RigidTransform.from_translation([0.0, 0.6, 0.0]),
)
MOUNT = make_pose(translation_m=(0.1, 0.0, 0.0))
POSE = make_pose(translation_m=(0.0, 0.0, 4.0))


def depth_m(*things: Thing) -> np.ndarray:
    config = PmdConfig(camera=CAMERA, subsamples=1, T_chaser_sensor=MOUNT)
    emulator = PmdEmulator(config, load_target("mockup"), seed=1, surroundings=things)
    return emulator.expose([POSE] * 4, sun_W_m2=np.zeros(3), frame=0).depth_m


def test_the_camera_sees_the_walls_at_their_distance_and_the_target_before_them():
    alone, in_room = depth_m(), depth_m(ROOM)
    on_target = np.isfinite(alone)
    assert 0.02 < on_target.mean() < 0.5
    assert np.isfinite(in_room).mean() > 0.98
    wall = in_room[:, :5]  # x / z of the left columns meets the wall at x = -2 - 0.1 in the sensor
    slope = (np.arange(5) - CAMERA.cx) / CAMERA.fx
    assert np.nanmedian(np.abs(wall - np.minimum(6.0, -2.1 / slope))) < 0.06
    assert np.nanmedian(np.abs(in_room - alone)[on_target]) < 0.03


def test_a_plate_of_the_chaser_hides_the_target_and_an_arm_moves_with_the_target():
    alone, hidden, held = depth_m(), depth_m(PLATE), depth_m(ARM)
    on_plate = np.abs(hidden - 2.0) < 0.1
    assert np.isfinite(alone)[on_plate].any()
    extra = np.isfinite(held) & ~np.isfinite(alone)
    assert extra.any()
    assert abs(np.median(np.nonzero(extra)[0]) - (CAMERA.cy + CAMERA.fy * 0.6 / 3.9)) < 4.0


def test_rays_of_the_lidar_meet_the_surroundings_in_the_axes_of_the_chaser():
    things = (ROOM, PLATE)
    emulator = LidarEmulator(
        LidarConfig(T_chaser_sensor=MOUNT), load_target("mockup"), seed=1, surroundings=things
    )
    points_m = emulator.scan([POSE], frame=0).points_m + MOUNT.translation
    assert np.isfinite(points_m).all(axis=-1).mean() > 0.95
    assert np.nanmax(np.abs(points_m[..., :2])) < 2.2
    on_plate = np.abs(points_m[..., 2] - 2.0) < 0.2
    assert np.nanmedian(points_m[on_plate][:, 0]) == pytest.approx(0.4, abs=0.1)


def test_a_mesh_file_that_cannot_be_read_is_named():
    with pytest.raises(MeshOfSurroundingsError, match=r"mesh nowhere\.stl: .*No such file"):
        depth_m(MeshThing(kind="mesh", file="nowhere.stl"))
