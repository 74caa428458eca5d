"""What a new filter takes over of the filter before it: of the facility always, of the body if it goes on."""

from dataclasses import replace

import numpy as np
import pytest
from navigator_rig import START_S, Desk, Slow, good, tracking_by_lidar, turned
from scipy.spatial.transform import Rotation

from rpod_pose.navigation.dynamics.free_motion import (
    ACCELERATION_BIAS,
    CENTRE_OF_MASS,
    GYRO_BIAS,
    INERTIA,
)
from rpod_pose.navigation.filter import POSE, Block, FilterState, start
from rpod_pose.navigation.first_pose.carried import carried
from rpod_pose.navigation.integrity.mounts import mount_offsets
from rpod_pose.navigation.pose_measurement import MOUNT, Origin, PoseMeasurement, started
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Mode

SECOND_NS = 1_000_000_000
CONFIG = FilterConfig(mount_sigma_deg=0.5, mount_sigma_m=0.02)
PRECISE = np.diag(np.repeat([1e-3, 1e-3], 3) ** 2)
AT = make_pose(rotation=Rotation.from_rotvec([0.3, -0.2, 0.5]), translation_m=[0.2, -0.1, 5.0])
BODY = {CENTRE_OF_MASS, INERTIA}
FACILITY = {GYRO_BIAS, ACCELERATION_BIAS, MOUNT.format("pmd")}


def known_well() -> FilterState:
    """Return a filter that knows further states, some of which depend on each other."""
    blocks = [
        Block(CENTRE_OF_MASS, np.array([0.01, -0.02, 0.03]), np.full(3, 0.1)),
        Block(INERTIA, np.array([0.05, -0.02]), np.full(2, 0.1)),
        Block(GYRO_BIAS, np.array([1e-5, 2e-5, -3e-5]), np.full(3, 5e-5)),
        Block(ACCELERATION_BIAS, np.array([1e-4, 0.0, 2e-4]), np.full(3, 1e-3)),
        Block(MOUNT.format("pmd"), np.array([0.01, 0.0, -0.01, 2e-3, 1e-3, 0.0]), np.full(6, 9e-3)),
    ]
    state = start(AT, PRECISE, 0, config=CONFIG, blocks=blocks)
    P = 0.01 * state.covariance
    P[12, 15] = P[15, 12] = 0.5 * np.sqrt(P[12, 12] * P[15, 15])
    return replace(state, covariance=P)


def seen(turn_deg: float, sensor: str = "pmd") -> PoseMeasurement:
    turn = Rotation.from_rotvec([0.0, turn_deg, 0.0], degrees=True)
    pose = make_pose(rotation=turn * AT.rotation, translation_m=AT.translation)
    return PoseMeasurement(SECOND_NS // 10, pose, PRECISE, Origin(sensor, make_pose()))


@pytest.mark.parametrize(("turn_deg", "names"), [(15.0, BODY | FACILITY), (180.0, FACILITY)])
def test_a_body_is_the_same_where_its_attitude_goes_on_and_the_facility_in_any_case(turn_deg, names):
    assert {block.name for block in carried(known_well(), seen(turn_deg), CONFIG).blocks} == names


def test_an_attitude_that_is_not_known_tells_nothing_of_the_body():
    past = known_well()
    P = past.covariance.copy()
    P[3:6, 3:6] = np.radians(10.0) ** 2 * np.eye(3)
    vague = replace(past, covariance=P)
    assert {block.name for block in carried(vague, seen(5.0), CONFIG).blocks} == FACILITY


def test_a_new_filter_has_the_values_and_the_covariance_of_the_one_before():
    past = known_well()
    state = started(seen(15.0), config=CONFIG, known=carried(past, seen(15.0), CONFIG))
    values = {block.name: block.value for block in state.blocks}
    for block in past.blocks:
        np.testing.assert_array_equal(values[block.name], block.value)
    (c, i), (before_c, before_i) = (
        (found.places()[CENTRE_OF_MASS].start, found.places()[INERTIA].start) for found in (state, past)
    )
    assert state.covariance[c, i] == pytest.approx(past.covariance[before_c, before_i])
    assert state.covariance[c, i] != 0.0


def test_a_filter_begins_at_the_measured_pose_less_the_known_error_of_its_mount():
    past = known_well()
    measured = seen(0.0)
    state = started(measured, config=CONFIG, known=carried(past, measured, CONFIG))
    mount = past.blocks[-1].value
    moved_m = measured.T_chaser_target.translation - state.T_chaser_target.translation
    np.testing.assert_allclose(moved_m, mount[:3] + np.cross(mount[3:], AT.translation), atol=1e-9)
    turn = measured.T_chaser_target.rotation * state.T_chaser_target.rotation.inv()
    np.testing.assert_allclose(turn.as_rotvec(), mount[3:], atol=1e-9)
    unknown = started(measured, config=CONFIG)
    sigma, before = (np.sqrt(np.diag(each.covariance[POSE, POSE])) for each in (state, unknown))
    assert (sigma < 0.7 * before).all()


def with_known_offset() -> Desk:
    """Return a desk that knows that the camera's mount is 0.5 deg off; its newest scan is at 10 s."""
    desk = tracking_by_lidar(mount_sigma_deg=0.5)
    for second in range(3, 10):
        for number in range(1, 10):
            desk.see("pmd", turned(START_S + second + 0.1 * number, 0.5))
        assert desk.see("lidar", good(START_S + second + 1.0)).status.accepted
    return desk


def offset_deg(desk: Desk) -> float:
    (offset,) = mount_offsets(desk.state.history.state, ["lidar", "pmd"])
    return float(np.degrees(np.linalg.norm(offset.error[3:])))


def test_a_track_that_goes_on_at_another_pose_knows_the_mounts_as_before():
    desk = with_known_offset()
    before_deg = offset_deg(desk)
    assert 0.4 < before_deg < 0.6
    assert not desk.see("lidar", turned(START_S + 10.3, 19.5)).status.accepted
    output = desk.see("lidar", turned(START_S + 10.6, 19.5))
    assert (output.status.accepted, output.status.mode) == (True, Mode.TRACKING)
    assert desk.state.separation is None
    assert offset_deg(desk) == pytest.approx(before_deg, abs=0.02)


def test_a_track_that_begins_after_a_silence_knows_the_mounts_as_before():
    desk = with_known_offset()
    before_deg = offset_deg(desk)
    assert desk.tick(START_S + 60.0).status.mode == Mode.LOST
    for second in range(4):
        output = desk.see("lidar", good(START_S + 61.0 + second))
    assert output.status.mode == Mode.TRACKING
    assert offset_deg(desk) == pytest.approx(before_deg, abs=0.02)


def test_a_track_that_frames_contradicted_leaves_nothing():
    """Its attitude was wrong, and so may be what it has learned."""
    desk = with_known_offset()
    for second in (10.3, 10.6):
        output = desk.see("lidar", turned(START_S + second, 90.0))
    assert output.status.mode == Mode.LOST
    for second in (12.0, 13.0, 14.0, 15.0):
        output = desk.see("lidar", turned(START_S + second, 90.0))
    assert output.status.mode == Mode.TRACKING
    assert mount_offsets(desk.state.history.state, ["lidar", "pmd"]) == []


def test_a_filter_of_hours_ago_is_not_predicted_and_leaves_what_is_constant():
    past = replace(known_well(), model=Slow(300.0))
    late = replace(seen(5.0), stamp_ns=3600 * SECOND_NS)
    assert {block.name for block in carried(past, late, CONFIG).blocks} == FACILITY - {GYRO_BIAS}
