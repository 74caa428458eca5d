"""A sensor that comes to the track of another one may differ from it as far as is declared."""

from dataclasses import replace

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, Desk, View, registration, truth

from rpod_pose.navigation.filter import predict
from rpod_pose.navigation.first_pose.carried import carried
from rpod_pose.navigation.integrity.memory import Memory
from rpod_pose.navigation.integrity.monitor import Monitor
from rpod_pose.navigation.pose_measurement import Origin, PoseMeasurement, beside_of, started, updated
from rpod_pose.navigation.sensors.beside import Beside
from rpod_schemas.config.estimator import EstimatorSettings, LidarInput
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Mode

BESIDE = beside_of("lidar")
DECLARED_M = 7.0 * 5e-4 * 2.0**0.5
"""Standard deviation of the difference of two sensors' ranges at 7 m."""
FAR_M = 12.0
PRECISE = np.diag(np.repeat([1e-6, 1e-8], 3))
EXACT = FilterConfig(position_floor_m=0.0, attitude_floor_deg=0.0)


def farther(time_s: float, longer_m: float) -> View:
    """Return a precise view of the target, farther away by a length along the line of sight."""
    true = truth(time_s)
    line_m = true.translation - MOUNT.translation
    moved_m = true.translation + longer_m * line_m / np.linalg.norm(line_m)
    moved = make_pose(rotation=true.rotation, translation_m=moved_m)
    seen = registration(MOUNT.inv() * moved, covariance=PRECISE)
    return View(round(time_s * SECOND_NS), tracked=seen, acquired=(seen,))


def tracking_by_camera() -> Desk:
    """Return a desk that tracks by its camera; the newest image is at ``START_S + 2``."""
    desk = Desk()
    for number in range(21):
        desk.see("pmd", farther(START_S + 0.1 * number, 0.0))
    assert desk.state.mode is Mode.TRACKING
    return desk


def distance_m(output, time_s: float) -> float:
    return float(output.odometry.pose.translation[2] - truth(time_s).translation[2])


def test_a_lidar_joins_a_camera_from_which_it_differs_as_far_as_is_declared():
    desk, longer_m = tracking_by_camera(), 3.0 * DECLARED_M
    for second in (2.0, 3.0, 4.0):
        scan = desk.see("lidar", farther(START_S + second + 0.05, longer_m))
        for number in range(1, 11):
            image = desk.see("pmd", farther(START_S + second + 0.1 * number, 0.0))
    assert scan.status.accepted
    assert abs(distance_m(image, START_S + 5.0)) < 1e-3, "the track stays with the camera"
    place = desk.state.history.state.places()[BESIDE]
    known = desk.state.history.state.covariance[place, place]
    assert known.shape == (8, 8)
    assert np.sqrt(np.diag(known)[7]) < 0.7, "the difference of the ranges has been estimated"


def test_the_lidar_carries_the_track_alone_without_a_jump():
    desk, longer_m = tracking_by_camera(), 2.0 * DECLARED_M
    for second in range(2, 6):
        desk.see("lidar", farther(START_S + second + 0.05, longer_m))
        for number in range(1, 11):
            desk.see("pmd", farther(START_S + second + 0.1 * number, 0.0))
    for second in range(6, 11):
        scan = desk.see("lidar", farther(START_S + second + 0.05, longer_m))
        assert scan.status.accepted
        assert abs(distance_m(scan, START_S + second + 0.05)) < 0.5 * longer_m
    assert "lidar" in desk.state.established


def test_a_lidar_that_differs_by_more_than_is_declared_does_not_join():
    desk = tracking_by_camera()
    for second in (2.0, 3.0, 4.0):
        scan = desk.see("lidar", farther(START_S + second + 0.05, 15.0 * DECLARED_M))
        assert scan.status.reason.startswith("gate: nis")
        for number in range(1, 11):
            desk.see("pmd", farther(START_S + second + 0.1 * number, 0.0))
    assert BESIDE not in desk.state.history.state.places()


def test_the_filter_of_the_newcomer_alone_has_no_difference_from_itself():
    desk = tracking_by_camera()
    monitor, memory = Monitor(desk.settings), Memory()
    for second in (2.0, 3.0, 4.0):
        for sensor, longer_m, steps in (("lidar", 2.0 * DECLARED_M, (0.5,)), ("pmd", 0.0, range(1, 11))):
            for number in steps:
                output = desk.see(sensor, farther(START_S + second + 0.1 * number, longer_m))
                memory, _ = monitor.assess(memory, desk.state, output)
    assert BESIDE in desk.state.history.state.places()
    assert all(BESIDE not in state.places() for state in memory.without.values())
    off_m = memory.without["pmd"].T_chaser_target.translation - truth(START_S + 4.05).translation
    assert off_m[2] == pytest.approx(2.0 * DECLARED_M, abs=1e-3), "it follows the scans"


def at_far(sensor: str, longer_m: float, stamp_ns: int = 0) -> PoseMeasurement:
    pose = make_pose(translation_m=[0.0, 0.0, FAR_M + longer_m])
    return PoseMeasurement(stamp_ns, pose, PRECISE, Origin(sensor, make_pose()))


@pytest.mark.parametrize(("mount_sigma_deg", "size"), [(0.0, 8), (0.2, 6)])
def test_states_of_mounts_stand_for_the_differences(mount_sigma_deg, size):
    config = EXACT.model_copy(update={"mount_sigma_deg": mount_sigma_deg, "mount_sigma_m": 0.01})
    config = config if mount_sigma_deg else EXACT
    settings = EstimatorSettings(sensors=(LidarInput(),), filter=config)
    state = started(at_far("pmd", 0.0), config=config)
    found = Beside(settings).newcomer(at_far("lidar", 0.0), state)
    assert (found.declared is None) is bool(mount_sigma_deg)
    grown = updated(state, found, config).state
    assert grown.size - state.size == size


def test_the_differences_are_those_of_two_sensors_at_the_range():
    declared = IntegrityConfig(mount_sigma_deg=0.1, mount_sigma_m=0.002, clock_sigma_s=0.003)
    settings = EstimatorSettings(sensors=(LidarInput(),), filter=EXACT, integrity=declared)
    state = replace(started(at_far("pmd", 0.0), config=EXACT), velocity_m_s=np.array([0.0, 0.5, 0.0]))
    by = Beside(settings).newcomer(at_far("lidar", 0.0), state).declared
    across_m2 = 2.0 * ((np.radians(0.1) * FAR_M) ** 2 + 0.002**2)
    np.testing.assert_allclose(
        np.diag(by @ by.T),
        [
            across_m2,
            across_m2 + 2.0 * (0.003 * 0.5) ** 2,
            2.0 * (0.002**2 + (5e-4 * FAR_M) ** 2),
            *[2.0 * np.radians(0.1) ** 2] * 3,
        ],
        rtol=1e-9,
    )


def test_a_new_track_does_not_know_how_sensors_differed_from_the_old_one():
    settings = EstimatorSettings(sensors=(LidarInput(),), filter=EXACT)
    state = started(at_far("pmd", 0.0), config=EXACT)
    state = updated(state, Beside(settings).newcomer(at_far("lidar", 0.0), state), EXACT).state
    assert BESIDE in state.places()
    assert all(block.name != BESIDE for block in carried(state, at_far("lidar", 0.0), EXACT).blocks)


def test_a_frame_of_a_sensor_that_came_to_the_track_differs_by_the_same_states():
    settings = EstimatorSettings(sensors=(LidarInput(),), filter=EXACT)
    beside, state = Beside(settings), started(at_far("pmd", 0.0), config=EXACT)
    assert beside.known(at_far("lidar", 0.0), state).declared is None
    state = updated(state, beside.newcomer(at_far("lidar", 0.0), state), EXACT).state
    later = predict(state, SECOND_NS, EXACT)
    again = beside.known(at_far("lidar", 0.0, SECOND_NS), later)
    assert updated(later, again, EXACT).state.size == state.size
    assert beside.known(at_far("pmd", 0.0, SECOND_NS), later).declared is None
