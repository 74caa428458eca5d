"""Several sensors, one track: who carries it, who joins it, and whose frames cannot end it."""

from dataclasses import replace

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, Desk, View, blind, good, tracking_by_lidar, turned

from rpod_pose.navigation.integrity.memory import Memory
from rpod_pose.navigation.integrity.monitor import Monitor
from rpod_pose.navigation.integrity.mounts import mount_offsets
from rpod_pose.navigation.sensors.streams import heard, supported
from rpod_pose.navigation.state import Cause
from rpod_schemas.config.estimator import PmdInput
from rpod_schemas.poses import pose_error
from rpod_schemas.types import BeliefLevel, Mode


def joined() -> Desk:
    """Return a desk whose camera has joined the track: its newest frame is at ``START_S + 4.1``."""
    desk = tracking_by_lidar(2)
    for second in (2.0, 3.0):
        for number in range(1, 10):
            desk.see("pmd", good(START_S + second + 0.1 * number))
        desk.see("lidar", good(START_S + second + 1.0))
    assert desk.see("pmd", good(START_S + 4.1)).status.accepted
    return desk


def contradicting(time_s: float) -> View:
    view = good(time_s)
    belief = replace(view.tracked.belief, level=BeliefLevel.CONTRADICTED, reason="30% contradict")
    return replace(view, tracked=replace(view.tracked, belief=belief))


def error_deg(output, time_s: float) -> float:
    turn_rad, _ = pose_error(output.odometry.pose, MOUNT * good(time_s).tracked.T_sensor_target)
    return float(np.rad2deg(np.linalg.norm(turn_rad)))


@pytest.mark.parametrize("seen", [blind, contradicting])
def test_frames_of_a_camera_that_sees_nothing_do_not_drop_the_lidars_first_pose(seen):
    desk = Desk()
    desk.see("lidar", good(START_S))
    for number in range(1, 10):
        assert desk.see("pmd", seen(START_S + 0.1 * number)).status.mode == Mode.VERIFYING
        assert desk.asked["pmd"].asked == [], "nothing is asked of it"
    assert desk.see("lidar", good(START_S + 1.0)).status.mode == Mode.TRACKING


@pytest.mark.parametrize("seen", [blind, contradicting])
def test_frames_of_a_camera_that_sees_nothing_cost_one_registration_and_no_search(seen):
    desk = tracking_by_lidar()
    for number in range(1, 200):
        output = desk.see("pmd", seen(START_S + 3.0 + 0.005 * number))
        assert desk.asked["pmd"].asked == ["track"]
    assert output.status.mode == Mode.TRACKING, "they do not end the track either"
    assert desk.see("lidar", good(START_S + 4.0)).status.accepted


def test_a_camera_that_contradicts_the_track_of_a_lidar_is_told_with_figures_and_remedy():
    reason = tracking_by_lidar(5).see("pmd", turned(START_S + 5.0, 19.0)).status.reason
    assert ", limit 16.8: 19.0 deg and 0 mm from the prediction over 0.00 s, " in reason
    assert reason.endswith("are wrong: compare them with rpod driver check --against")


def test_a_camera_is_offered_the_tracked_pose_and_joins_when_the_lidars_next_two_frames_agree():
    desk = tracking_by_lidar()
    for second in (3.0, 4.0):
        output = desk.see("pmd", good(START_S + second + 0.1))
        assert not output.status.accepted
        told = "offered: the sensor joins the track when the next frames of lidar agree"
        assert output.status.reason == told
        assert desk.see("lidar", good(START_S + second + 1.0)).status.accepted
    assert desk.see("pmd", good(START_S + 5.1)).status.accepted
    assert desk.asked["pmd"].asked == ["track"], "it has never searched"


def test_a_camera_whose_poses_lie_off_never_joins_and_moves_nothing():
    desk = tracking_by_lidar()
    alone = tracking_by_lidar()
    for second in range(3, 7):
        for number in range(1, 10):
            time_s = START_S + second + 0.1 * number
            assert not desk.see("pmd", turned(time_s, 4.0)).status.accepted
        one, other = (each.see("lidar", good(START_S + second + 1.0)) for each in (desk, alone))
        assert one.status.accepted
        np.testing.assert_array_equal(one.odometry.pose.as_matrix(), other.odometry.pose.as_matrix())


def test_a_camera_whose_mount_may_be_as_far_off_joins_and_the_offset_is_known():
    desk = tracking_by_lidar(mount_sigma_deg=2.0)
    for second in range(3, 9):
        for number in range(1, 10):
            output = desk.see("pmd", turned(START_S + second + 0.1 * number, 2.0))
        assert desk.see("lidar", good(START_S + second + 1.0)).status.accepted
    assert output.status.accepted
    assert desk.state.history is not None
    (offset,) = mount_offsets(desk.state.history.state, ["lidar", "pmd"])
    assert np.degrees(np.linalg.norm(offset.error[3:])) == pytest.approx(2.0, abs=0.1)


def test_a_camera_that_agrees_at_first_and_then_pulls_its_filter_away_does_not_join():
    """A frame of the LIDAR soon after the camera's first one tells little of the camera."""
    desk = tracking_by_lidar()
    desk.see("pmd", good(START_S + 3.95))
    desk.see("lidar", good(START_S + 4.0))
    for number in range(1, 10):
        time_s = START_S + 4.0 + 0.1 * number
        assert not desk.see("pmd", turned(time_s, 0.5 * number)).status.accepted
    output = desk.see("lidar", good(START_S + 5.0))
    assert error_deg(output, START_S + 5.0) < 0.2
    assert desk.state.separation is None


def test_a_camera_that_has_joined_and_then_pulls_the_track_away_is_put_out_by_the_lidar():
    desk = joined()
    for number in range(2, 10):
        time_s = START_S + 4.0 + 0.1 * number
        pulled = desk.see("pmd", turned(time_s, 0.6 * number))
    assert error_deg(pulled, time_s) > 2.0, "the camera's gradual error passes its own gate"
    output = desk.see("lidar", good(START_S + 5.0))
    assert output.status.accepted
    assert error_deg(output, START_S + 5.0) < 0.2
    assert "joins the track when" in desk.see("pmd", good(START_S + 5.1)).status.reason


def test_a_camera_carries_the_track_alone_when_the_lidar_is_silent():
    desk = joined()
    for number in range(2, 60):
        output = desk.see("pmd", good(START_S + 4.0 + 0.1 * number))
        assert output.status.accepted
        assert output.status.mode == Mode.TRACKING
    assert desk.state.established == {"lidar", "pmd"}


@pytest.mark.parametrize("order", [("lidar", "pmd"), ("pmd", "lidar")])
def test_frames_with_equal_stamps_are_taken_in_any_order(order):
    desk = joined()
    for second in (5.0, 6.0, 7.0):
        for sensor in order:
            output = desk.see(sensor, good(START_S + second))
            assert output.status.accepted
            assert output.odometry.stamp_ns == round((START_S + second) * SECOND_NS)


def test_a_scan_that_comes_after_newer_frames_of_the_camera_is_applied_at_its_stamp():
    desk = joined()
    for number in range(2, 14):
        desk.see("pmd", good(START_S + 4.0 + 0.1 * number))
    output = desk.see("lidar", good(START_S + 5.0))
    assert output.status.accepted
    assert output.odometry.stamp_ns == round((START_S + 5.3) * SECOND_NS), "the output does not go back"


def test_a_sensor_beyond_its_configured_range_is_not_asked():
    desk = tracking_by_lidar(range_m=(0.0, 5.0))
    output = desk.see("pmd", good(START_S + 3.1))
    assert output.status.reason.startswith("out of range: the target is predicted at 6.")
    assert output.cause is Cause.OUT_OF_RANGE
    assert output.status.reason.endswith("m, range_m is 0 to 5")
    assert desk.asked["pmd"].asked == []
    assert output.odometry is not None


def test_a_pose_that_a_search_finds_beyond_the_configured_range_begins_no_track():
    desk = Desk(range_m=(0.0, 5.0))
    output = desk.see("pmd", good(START_S))
    assert output.status.mode == Mode.ACQUIRING
    assert output.status.reason.startswith("out of range: the target is found at 6.")
    assert output.cause is Cause.OUT_OF_RANGE


def test_a_range_that_does_not_rise_is_refused():
    with pytest.raises(ValueError, match="is 12 to 3 m, needs to rise"):
        PmdInput(range_m=(12.0, 3.0))


def test_a_camera_that_finds_nothing_searches_once_a_second_only_and_does_not_keep_the_lidar_from_searching():
    desk = Desk()
    searches = 0
    for number in range(30):
        output = desk.see("pmd", blind(START_S + 0.1 * number))
        searches += "acquire" in desk.asked["pmd"].asked
        assert ("acquire" in desk.asked["pmd"].asked) != output.status.reason.startswith("not searched: ")
    assert searches == 3
    assert desk.see("lidar", good(START_S + 2.95)).status.mode == Mode.VERIFYING


def test_one_long_gap_is_a_pause_and_not_the_rate_of_a_sensor():
    streams = {}
    for stamp_s in (0.0, 0.1, 0.2, 10.2):
        streams = heard(streams, "pmd", round(stamp_s * SECOND_NS))
    streams = supported(streams, "pmd", round(10.2 * SECOND_NS))
    later_ns = round(12.0 * SECOND_NS)
    assert streams["pmd"].is_silent(later_ns, 0.3)
    assert not streams["pmd"].supports(later_ns, 0.3)
    for stamp_s in np.arange(11.2, 19.0, 1.0):
        streams = heard(streams, "pmd", round(stamp_s * SECOND_NS))
    assert streams["pmd"].period_ns == SECOND_NS, "a slower rate is known after some frames"


def test_the_solution_without_a_sensor_that_joins_has_never_seen_its_frames():
    """While a camera is on probation, its frames are in the filter that is published once it has joined."""
    desk, alone = tracking_by_lidar(2), tracking_by_lidar(2)
    monitor, memory = Monitor(desk.settings), Memory()

    def see(sensor: str, view: View):
        nonlocal memory
        output = desk.see(sensor, view)
        memory, _ = monitor.assess(memory, desk.state, output)
        return output

    for second in (2.0, 3.0):
        for number in range(1, 10):
            assert not see("pmd", turned(START_S + second + 0.1 * number, 0.3)).status.accepted
        scan = good(START_S + second + 1.0)
        assert see("lidar", scan).status.accepted
        assert alone.see("lidar", scan).status.accepted
    stamp_s = START_S + 4.1
    assert see("pmd", turned(stamp_s, 0.3)).status.accepted
    assert desk.state.history is not None
    assert alone.state.history is not None
    by_lidar = alone.state.history.at(round(stamp_s * SECOND_NS), desk.settings.filter)
    without = memory.without_at(round(stamp_s * SECOND_NS), desk.settings.filter)["pmd"]
    np.testing.assert_allclose(
        without.T_chaser_target.as_matrix(), by_lidar.T_chaser_target.as_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(without.covariance, by_lidar.covariance, atol=1e-15)


def test_frames_of_a_camera_on_probation_count_less_the_nearer_they_are():
    """Errors of near frames are alike, whether or not their sensor has joined the track."""
    desk = tracking_by_lidar()
    for number in range(1, 10):
        desk.see("pmd", good(START_S + 3.0 + 0.02 * number))
    assert desk.state.separation is not None
    measured = [step.measurement for step in desk.state.separation.including.steps]
    apart_s = [each.since_s for each in measured if each.origin is not None and each.origin.sensor == "pmd"]
    assert apart_s[1:] == pytest.approx([0.02] * 8)
