"""A known arm before the target and on it: taken out of the frames of both sensors, wherever it is."""

from functools import cache

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from rpod_campaign.lidar.methods import lidar_config, pattern_of
from rpod_pose.lidar.methods import ScanFrames
from rpod_pose.methods import methods_of
from rpod_pose.pmd.other_things import PmdFrames
from rpod_pose.surroundings.bodies import KnownBodies, KnownBodiesError
from rpod_pose.surroundings.known import KnownParts, known_bodies, known_parts
from rpod_schemas.config.estimator import LidarInput, PmdInput
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.config.surroundings import CylinderThing, KnownBody, SensorSurroundings
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import LidarScan, PmdFrame
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target

CAMERA, LIDAR, STAMP_NS = PmdConfig(), lidar_config(step_deg=0.5), 10**18
POSE = make_pose(rotation=Rotation.from_euler("ZYX", [20, 60, 10], degrees=True), translation_m=(0.1, 0, 4))
MOUNT = make_pose(rotation=Rotation.from_euler("y", 5, degrees=True), translation_m=(0.2, 0.1, 0.0))
LIMB = {"radius_m": 0.15, "length_m": 2.4}
ACROSS = make_pose(rotation=Rotation.from_euler("z", 70, degrees=True), translation_m=(-0.3, -1.2, 3.1))
"""Pose of a thick limb before the target, sensor axes: it hides a half of it."""


@cache
def limb_file(folder) -> str:
    """Write the limb in millimetres, along the file's own z."""
    radius_mm, length_mm = 1e3 * LIMB["radius_m"], 1e3 * LIMB["length_m"]
    limb = trimesh.creation.cylinder(radius=radius_mm, height=length_mm, sections=64)
    limb.apply_translation((0.0, 0.0, 0.5 * length_mm))
    limb.export(folder / "limb.stl")
    return "limb.stl"


def bodies(tmp_path, T_sensor_limb=ACROSS, frame: str = "chaser") -> KnownBodies:
    along_x = make_pose(rotation=Rotation.from_euler("y", 90, degrees=True))
    pose = MOUNT * T_sensor_limb * along_x if frame == "chaser" else along_x
    body = KnownBody(file=limb_file(tmp_path), metres_per_unit=1e-3, frame=frame, pose=pose)
    found = KnownBodies.of({"limb": body}, tmp_path)
    assert found is not None
    return found


@cache
def frame(sensor: str):
    thing = CylinderThing(kind="cylinder", pose=ACROSS, **LIMB)
    if sensor == "lidar":
        emulator = LidarEmulator(LIDAR, load_target("mockup"), seed=2, surroundings=(thing,))
        return LidarScan(stamp_ns=STAMP_NS, frame_id="", points_m=emulator.scan([POSE], frame=1).points_m)
    exposure = PmdEmulator(CAMERA, load_target("mockup"), seed=2, surroundings=(thing,)).expose(
        [POSE] * 4, sun_W_m2=np.zeros(3), frame=1
    )
    for image in (exposure.depth_m, exposure.amplitude):
        image.setflags(write=False)
    return PmdFrame(
        stamp_ns=STAMP_NS,
        frame_id="",
        depth_m=exposure.depth_m,
        amplitude=exposure.amplitude,
        camera=CAMERA.camera,
        info=CAMERA.info(),
    )


@cache
def methods(sensor: str):
    target = load_target("mockup")
    if sensor == "lidar":
        return methods_of(LidarInput(), target, pattern_of(LIDAR))
    return methods_of(PmdInput(), target)


def separation(sensor: str):
    return ScanFrames(pattern_of(LIDAR)) if sensor == "lidar" else PmdFrames()


def of_target(sensor: str, known: KnownBodies):
    parts = KnownParts.of(SensorSurroundings(), separation(sensor), None, known)
    return parts.of_target(frame(sensor), STAMP_NS, MOUNT)


def near(angle_deg: float, shift_m: float):
    turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * np.array([0.6, 0.0, 0.8]))
    return make_pose(
        rotation=turn * POSE.rotation, translation_m=POSE.translation + np.array([shift_m, 0, 0])
    )


@pytest.mark.parametrize("sensor", ["pmd", "lidar"])
def test_a_target_of_which_a_known_arm_hides_a_half_is_tracked_within_half_a_degree(sensor, tmp_path):
    tracked = methods(sensor).tracker.track(of_target(sensor, bodies(tmp_path)), near(2.0, 0.03))
    assert tracked.continues_track, tracked.belief.reason
    assert 0.4 < tracked.belief.evidence["visible_share"] < 0.6
    attitude_rad, position_m = pose_error(POSE, tracked.T_sensor_target)
    assert np.rad2deg(np.linalg.norm(attitude_rad)) < 0.5
    assert np.linalg.norm(position_m) < 0.03


def test_the_pixels_of_a_known_arm_are_taken_out_and_those_before_it_stay(tmp_path):
    left = of_target("pmd", bodies(tmp_path))
    alone = np.isfinite(frame("pmd").depth_m)
    on_arm = frame("pmd").depth_m < 3.2
    assert not np.isfinite(left.depth_m[on_arm]).any()
    assert np.isfinite(left.depth_m[alone & ~on_arm]).mean() > 0.85
    farther = make_pose(rotation=ACROSS.rotation, translation_m=ACROSS.translation + np.array([0, 0, 3.0]))
    kept = of_target("pmd", bodies(tmp_path, farther)).depth_m
    assert np.isfinite(kept[alone]).all()


def test_the_place_of_a_moving_body_is_extrapolated_and_unknown_after_a_gap(tmp_path):
    known = bodies(tmp_path, frame="forearm")
    assert known.unknown(STAMP_NS) == ("forearm",)
    for number in range(3):
        shift = np.array([0.1, 0.0, 0.0]) * (number - 3)
        moved = make_pose(rotation=ACROSS.rotation, translation_m=ACROSS.translation + shift)
        known.tracks["forearm"].take(STAMP_NS + (number - 3) * 10_000_000, MOUNT * moved)
    found = known.tracks["forearm"].at(STAMP_NS)
    np.testing.assert_allclose((MOUNT.inv() * found).translation, ACROSS.translation, atol=1e-9)
    assert known.unknown(STAMP_NS) == ()
    assert of_target("pmd", known).hidden.sum() == of_target("pmd", bodies(tmp_path)).hidden.sum()
    assert known.unknown(STAMP_NS + 200_000_000) == ("forearm",)


def test_a_file_of_bodies_serves_every_sensor_and_names_what_cannot_be_read(tmp_path):
    limb_file(tmp_path)
    path = tmp_path / "known.yaml"
    path.write_text("bodies: {limb: {file: limb.stl, metres_per_unit: 0.001, frame: forearm}}")
    known = known_bodies(path)
    assert known is not None
    assert known_parts(path, "pmd", PmdFrames(), known).bodies is known
    path.write_text("bodies: {limb: {file: none.stl, metres_per_unit: 0.001}}")
    with pytest.raises(KnownBodiesError, match=r"body limb: .*none\.stl"):
        known_bodies(path)
