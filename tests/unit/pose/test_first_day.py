"""What a laboratory sends on its first day, through the methods with their default settings."""

from functools import cache

import numpy as np
import pytest
from ifm_recording import configuration
from scipy.spatial.transform import Rotation

from rpod_driver.adapters.ifm.driver import open_driver
from rpod_geometry.rays import RayGrid, cast
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.measurement import Measurement
from rpod_pose.methods import methods_of
from rpod_pose.navigation.navigator import Navigator
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.readers.lidar import LidarReader
from rpod_schemas.config.estimator import EstimatorSettings, LidarInput, PmdInput
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.messages import write_points
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import POINTS
from rpod_schemas.types import Mode, PmdFrame
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.pmd import PmdEmulator
from rpod_target import load_target


def received(message) -> Received:
    topic = POINTS.of("lidar")
    return Received(topic, f"0/{topic.name}", memoryview(encode(message)), Attachment(1, 1, bytes(16)), 1)


@pytest.mark.parametrize("rows_are_azimuth", [False, True])
def test_a_lidar_without_info_is_found_whichever_way_its_rows_run(rows_are_azimuth):
    target, config = load_target("envisat-bulky"), LidarConfig()
    emulator, reader = LidarEmulator(config, target, seed=4), LidarReader()
    truth = make_pose(
        rotation=Rotation.from_euler("ZYX", [40.0, 25.0, 10.0], degrees=True), translation_m=(1, -2, 24)
    )
    for number in range(3):
        points_m = emulator.scan([truth], frame=number).points_m
        if rows_are_azimuth:
            points_m = points_m.transpose(1, 0, 2)
        cloud = {name: np.ascontiguousarray(points_m[..., axis]) for axis, name in enumerate("xyz")}
        scan = reader.read(Assembled(1, {"points": received(write_points(1, "lidar", cloud))}))
    found = methods_of(LidarInput(), target, ScanPattern.of(reader.newest_info)).acquirer.acquire(scan)
    assert found.begins_track, found.belief.refusal
    attitude_rad, position_m = pose_error(truth, found.pose)
    assert np.degrees(np.linalg.norm(attitude_rad)) < 0.5
    assert np.linalg.norm(position_m) < 0.1


def test_a_turning_head_with_staggered_rows_is_found_and_tracked():
    """Each of 32 lasers looks aside by its own angle, and a scan is a part of a turn."""
    target, sigma_m, rng = load_target("envisat-bulky"), 0.02, np.random.default_rng(1)
    aside_rad = np.tile(np.radians([3.26, -1.1, 5.4, -4.9, 0.2, 2.2, -3.3, 1.0]), 4)
    azimuth_rad, elevation_rad = (
        np.radians(np.arange(-30.0, 30.0, 0.36)),
        np.radians(np.linspace(-15, 15, 32)),
    )
    grid, reader = RayGrid.azimuth_elevation(azimuth_rad, elevation_rad, aside_rad), LidarReader()
    methods, pattern = None, None
    for number in range(3):
        attitude = Rotation.from_euler("ZYX", [40.0 + 3.0 * number, 25.0, 10.0], degrees=True)
        truth = make_pose(rotation=attitude, translation_m=(1.0, -1.0, 14.0 - number))
        range_m = cast(grid, target.triangles_m, truth).range_m
        range_m = np.where(np.isfinite(range_m), range_m + rng.normal(0.0, sigma_m, grid.shape), 0.0)
        points_m = range_m[..., None] * grid.directions
        cloud = {name: points_m[..., axis].astype(np.float32) for axis, name in enumerate("xyz")}
        scan = reader.read(Assembled(1, {"points": received(write_points(1, "lidar", cloud))}))
        pattern = pattern or reader.newest_info
        assert reader.newest_info is pattern
        methods = methods or methods_of(LidarInput(sigma_range_m=sigma_m), target, ScanPattern.of(pattern))
        begin = make_pose(
            rotation=Rotation.from_rotvec([0.02, -0.02, 0.02]), translation_m=(0.05, 0.05, 0.05)
        )
        tracked = methods.tracker.track(scan, truth * begin)
        assert tracked.belief.continues_track, tracked.belief.reason
        found = methods.acquirer.acquire(scan)
        assert found.begins_track, found.belief.refusal
        for pose in (found.pose, tracked.T_sensor_target):
            attitude_rad, position_m = pose_error(truth, pose)
            assert np.degrees(np.linalg.norm(attitude_rad)) < 0.1
            assert np.linalg.norm(position_m) < 0.01


def test_a_real_frame_without_the_target_gives_no_pose():
    driver = open_driver(configuration())
    driver.connect()
    frame = next(frame for frame in driver.frames() if frame is not None)
    driver.close()
    found = methods_of(PmdInput(name="front"), load_target("mockup")).acquirer.acquire(frame)
    assert not found.begins_track
    assert found.belief.refusal


@cache
def camera() -> PmdEmulator:
    return PmdEmulator(PmdConfig(), load_target("mockup"), seed=5)


@pytest.mark.parametrize("rate_hz", [15.0, 45.0])
def test_a_shaken_target_is_tracked_within_1_deg(rate_hz):
    """3 m/s2 and 60 deg/s2, whose direction changes each 0.15 s."""
    target, sensor = load_target("mockup"), PmdInput()
    rng = np.random.default_rng(8)
    navigator = Navigator(
        EstimatorSettings(sensors=(sensor,)),
        {"pmd": methods_of(sensor, target)},
        centre_of_mass_m=target.centre_of_mass_m,
        alike=target.equivalence,
    )
    pose = make_pose(
        rotation=Rotation.from_euler("ZYX", [20, 60, 10], degrees=True), translation_m=(0.1, 0, 4)
    )
    velocity_m_s, rate_rad_s, push, turn, tracked = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), 0
    state = navigator.start(pose)
    for number in range(round(1.2 * rate_hz)):
        if number % round(0.15 * rate_hz) == 0:
            push, turn = (rng.normal(size=3) for _ in range(2))
            push, turn = 3.0 * push / np.linalg.norm(push), np.radians(60.0) * turn / np.linalg.norm(turn)
        velocity_m_s, rate_rad_s = velocity_m_s + push / rate_hz, rate_rad_s + turn / rate_hz
        pose = make_pose(
            rotation=Rotation.from_rotvec(rate_rad_s / rate_hz) * pose.rotation,
            translation_m=pose.translation + velocity_m_s / rate_hz,
        )
        exposed = camera().expose([pose] * 4, sun_W_m2=np.zeros(3), frame=number)
        stamp_ns = round((number + 1) / rate_hz * 1e9)
        frame = PmdFrame(
            stamp_ns=stamp_ns,
            frame_id="pmd_optical",
            depth_m=exposed.depth_m,
            amplitude=exposed.amplitude,
            camera=PmdConfig().camera,
            info=PmdConfig().info(),
        )
        state, output = navigator.step(state, Measurement("pmd", frame, make_pose()))
        if output.odometry is not None and output.status.mode == Mode.TRACKING:
            tracked += 1
            attitude_rad, _ = pose_error(pose, output.odometry.pose)
            assert np.degrees(np.linalg.norm(attitude_rad)) < 1.0
    assert tracked > 0.5 * rate_hz
