"""Joints of a target: their angles are found with the pose, and tracked."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_pose.belief import NOISE_M, Angle, Rival
from rpod_pose.joints.angle_fit import Aligned, JointSolver, unknown
from rpod_pose.lidar.methods import LIDAR_METHODS, ideal_scan
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.measurement import Measurement
from rpod_pose.methods import methods_of
from rpod_pose.navigation.dynamics.options import CONSTANT
from rpod_pose.navigation.first_pose.beginning import Beginning
from rpod_pose.navigation.joints import tracked_joints
from rpod_pose.navigation.parallel import ParallelTracks
from rpod_pose.ports import Acquisition
from rpod_schemas.config.estimator import EstimatorSettings, LidarInput
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import BeliefLevel
from rpod_target import NO_SYMMETRY, Symmetry, load_target, posed

ANGLES_RAD = np.deg2rad(np.arange(-15.0, 15.1, 0.5))
PATTERN = ScanPattern(ANGLES_RAD, ANGLES_RAD, sigma_range_m=0.01)
POSE = make_pose(
    rotation=Rotation.from_euler("ZYX", [30.0, 35.0, 160.0], degrees=True), translation_m=(0.0, -0.5, 9.0)
)
FROM_BEHIND = make_pose(
    rotation=Rotation.from_euler("ZYX", [0.0, 0.0, 90.0], degrees=True), translation_m=(0.0, 0.0, 9.0)
)
TRUE_RAD = np.deg2rad(-37.0)


@pytest.fixture(scope="module")
def target(tmp_path_factory):
    folder = tmp_path_factory.mktemp("targets")
    boxes = {
        "body": ([1.0, 1.4, 0.8], [0.0, 0.0, 0.0]),
        "box": ([0.4, 0.3, 0.5], [0.3, 0.2, 0.5]),
        "array": ([0.8, 2.0, 0.05], [0.0, 1.75, 0.0]),
    }
    parts = [
        {
            "name": name,
            "shape": "box",
            "size_m": size,
            "material": "grey",
            "T_target_part": {"translation_m": at},
        }
        for name, (size, at) in boxes.items()
    ]
    parts[-1]["joint"] = "drive"
    document = {
        "name": "jointed",
        "mass_kg": 50.0,
        "materials": {"grey": {"reflectivity": 0.5, "diffuse": 0.4, "f0": 0.02, "roughness": 0.3}},
        "parts": parts,
        "joints": {"drive": {"axis": [0, 1, 0], "origin_m": [0, 0, 0], "limits_deg": [-60, 60]}},
        "distance_field": {"spacing_m": 0.04},
    }
    file = folder / "jointed.yaml"
    file.write_text(json.dumps(document))
    return load_target(file, cache=folder / "cache")


def scan_of(target, pose, angle_rad):
    scan, _ = ideal_scan(posed(target, {"drive": angle_rad}), pose, PATTERN)
    return scan


@pytest.fixture(scope="module")
def methods(target):
    return methods_of(LidarInput(), target, PATTERN)


def test_an_acquisition_finds_the_pose_with_the_angle(target, methods):
    found = methods.acquirer.acquire(scan_of(target, POSE, TRUE_RAD))
    angle = found.registration.angles["drive"]
    assert found.begins_track
    assert np.rad2deg(np.linalg.norm(pose_error(POSE, found.pose)[0])) < 0.5
    assert np.rad2deg(abs(angle.angle_rad - TRUE_RAD)) < 2.0
    assert np.rad2deg(angle.sigma_rad) < 2.0


def test_poses_are_compared_each_at_its_own_angle_and_rivals_are_tracked_at_theirs(target, methods):
    scan, near = scan_of(target, POSE, TRUE_RAD), np.deg2rad(1.0)
    right, wrong = (
        methods.expecting({"drive": Angle(angle_rad, near)}).tracker.track(scan, POSE)
        for angle_rad in (TRUE_RAD, -TRUE_RAD)
    )
    likelier, less = methods.likelihoods(scan, [right, replace(right, angles=wrong.angles)])
    assert likelier > less + 5.0
    noisy = replace(right, belief=replace(right.belief, evidence={NOISE_M: 4.0 * PATTERN.sigma_range_m}))
    assert np.ptp(methods.likelihoods(scan, [right, noisy])) == 0.0  # under the same noise
    alike = methods.acquirer._shared.at_one_noise(scan, [right, replace(noisy, log_likelihood=0.0)])
    assert np.ptp([each.log_likelihood for each in alike]) == 0.0

    rival = Rival("turned by 180 deg", POSE, -1.0, {"drive": Angle(-TRUE_RAD, near)})
    doubtful = replace(right.belief, level=BeliefLevel.DOUBTFUL, rivals=(rival,))
    settings = EstimatorSettings(sensors=(LidarInput(),))
    beginning = Beginning(
        settings,
        centre_of_mass_m=np.zeros(3),
        alike=NO_SYMMETRY,
        joints=target.joints,
        dynamics=CONSTANT,
    )
    parallel = ParallelTracks(beginning, settings.filter, NO_SYMMETRY)
    event = Measurement("lidar", scan, make_pose())
    tracks = parallel.started(event, Acquisition(replace(right, belief=doubtful)))
    angles_deg = np.rad2deg([track.joints["drive"].angle.angle_rad for track in tracks])
    np.testing.assert_allclose(angles_deg, [-37.0, 37.0], atol=2.0)  # one attitude, two rivals


def test_candidates_of_a_symmetrical_target_differ_if_a_turn_leaves_the_angle(target):
    alike = replace(target, symmetries=(Symmetry((1.0, 0.0, 0.0), 2, exact=True),))
    shared = methods_of(LidarInput(), alike, PATTERN).acquirer._shared
    turned = POSE * make_pose(rotation=Rotation.from_euler("x", 180.0, degrees=True))
    right, other, same = (
        Aligned(pose, {"drive": Angle(angle_rad, 1.0)}, loss_m2)
        for pose, angle_rad, loss_m2 in ((POSE, 0.6, 1.0), (turned, 0.6, 2.0), (turned, -0.6, 3.0))
    )
    assert shared.distinct([same, other, right]) == [right, other]


def test_a_tracker_finds_the_angle_beside_the_one_that_is_expected(target, methods):
    expecting = methods.expecting({"drive": Angle(TRUE_RAD + np.deg2rad(2.0), np.deg2rad(2.0))})
    start = make_pose(
        rotation=POSE.rotation * Rotation.from_rotvec([0.02, -0.03, 0.02]),
        translation_m=POSE.translation + 0.03,
    )
    found = expecting.tracker.track(scan_of(target, POSE, TRUE_RAD), start)
    assert np.rad2deg(np.linalg.norm(pose_error(POSE, found.T_sensor_target)[0])) < 0.5
    assert np.rad2deg(abs(found.angles["drive"].angle_rad - TRUE_RAD)) < 1.5


def test_an_angle_that_the_frame_does_not_show_keeps_its_standard_deviation(target):
    scan = scan_of(target, FROM_BEHIND, TRUE_RAD)
    body_m = LIDAR_METHODS.points(scan)[FROM_BEHIND.inv().apply(LIDAR_METHODS.points(scan))[:, 1] < 0.72]
    expected = {"drive": unknown(target.joints[0])}
    found = JointSolver(target).angles(body_m, FROM_BEHIND, expected)["drive"]
    assert found.sigma_rad == pytest.approx(expected["drive"].sigma_rad, rel=0.2)
    assert JointSolver(target).angles(body_m[:0], FROM_BEHIND, expected) == expected


def test_a_kind_without_its_own_points_ignores_the_parts_of_joints(target, monkeypatch):
    kind = replace(LIDAR_METHODS, points=None)
    monkeypatch.setattr("rpod_pose.methods.kind_methods", lambda _: kind)
    found = methods_of(LidarInput(), target, PATTERN)
    registration = found.tracker.track(scan_of(target, POSE, 0.1), POSE)
    assert found.expecting is None
    assert not registration.angles
    assert registration.T_sensor_target is not None


def test_a_track_follows_a_joint_that_turns(target):
    (joint,) = target.joints
    tracks, rate_rad_s, generator = {}, np.deg2rad(0.5), np.random.default_rng(1)
    for second in range(40):
        stamp_ns = second * NANOSECONDS
        measured_rad = rate_rad_s * second + np.deg2rad(0.5) * generator.standard_normal()
        prior = tracks["drive"].at(stamp_ns).angle if tracks else Angle(0.0, 10.0)
        weight = prior.sigma_rad**2 / (prior.sigma_rad**2 + np.deg2rad(0.5) ** 2)
        angle_rad = prior.angle_rad + weight * (measured_rad - prior.angle_rad)
        angle = Angle(angle_rad, prior.sigma_rad * np.sqrt(1.0 - weight))
        tracks = tracked_joints(tracks, {"drive": joint}, {"drive": angle}, stamp_ns)
    track = tracks["drive"]
    assert np.rad2deg(track.state[1]) == pytest.approx(0.5, abs=0.1)
    assert np.rad2deg(abs(track.angle.angle_rad - 39 * rate_rad_s)) < 0.6
    assert track.at(10**6 * NANOSECONDS).angle.sigma_rad == pytest.approx(unknown(joint).sigma_rad)
