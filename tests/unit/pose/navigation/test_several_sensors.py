"""Several sensors, one track: who carries it, who joins it, and whose frames cannot end it."""

from dataclasses import replace

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, Method, View, blind, good, turned

from rpod_pose.measurement import Measurement, Tick
from rpod_pose.navigation.integrity.mounts import mount_offsets
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.navigation.sensors.streams import heard, supported
from rpod_pose.ports import Methods
from rpod_pose.search.verified_search import VerifiedSearch
from rpod_schemas.config.estimator import EstimatorSettings, LidarInput, NavigatorConfig, PmdInput
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import pose_error
from rpod_schemas.types import BeliefLevel, Mode


class Desk:
    """A navigator with a LIDAR and a camera."""

    def __init__(self, *, range_m=None, mount_sigma_deg: float = 0.0, **limits: float) -> None:
        settings = EstimatorSettings(
            sensors=(LidarInput(), PmdInput(range_m=range_m)),
            navigator=NavigatorConfig(**limits),
            filter=FilterConfig(mount_sigma_deg=mount_sigma_deg, mount_sigma_m=0.1 * mount_sigma_deg),
        )
        self.asked: dict[str, Method] = {"lidar": Method(), "pmd": Method()}
        methods = {
            name: Methods(VerifiedSearch(method, method, "first"), method, lambda data, *_, **__: data)
            for name, method in self.asked.items()
        }
        self.navigator = Navigator(settings, methods, centre_of_mass_m=np.zeros(3))
        self.state = self.navigator.start()

    def see(self, sensor: str, view: View):
        self.asked[sensor].asked.clear()
        self.state, output = self.navigator.step(self.state, Measurement(sensor, view, MOUNT))
        return output

    def tick(self, time_s: float):
        self.state, output = self.navigator.step(self.state, Tick(round(time_s * SECOND_NS)))
        return output


def tracking(until_s: int = 3, **limits: float) -> Desk:
    """Return a desk that tracks by its LIDAR from ``START_S`` on, 3 s if nothing else is said."""
    desk = Desk(**limits)
    for number in range(until_s + 1):
        desk.see("lidar", good(START_S + number))
    assert desk.state.mode == Mode.TRACKING
    return desk


def joined() -> Desk:
    """Return a desk whose camera has joined the track: its newest frame is at ``START_S + 4.1``."""
    desk = tracking(2)
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
    desk = tracking()
    for number in range(1, 200):
        output = desk.see("pmd", seen(START_S + 3.0 + 0.005 * number))
        assert desk.asked["pmd"].asked == ["track"]
    assert output.status.mode == Mode.TRACKING, "they do not end the track either"
    assert desk.see("lidar", good(START_S + 4.0)).status.accepted


def test_a_camera_is_offered_the_tracked_pose_and_joins_when_the_lidars_next_two_frames_agree():
    desk = tracking()
    for second in (3.0, 4.0):
        output = desk.see("pmd", good(START_S + second + 0.1))
        assert not output.status.accepted
        told = "offered: the sensor joins the track when the next frames of lidar agree"
        assert output.status.reason == told
        assert desk.see("lidar", good(START_S + second + 1.0)).status.accepted
    assert desk.see("pmd", good(START_S + 5.1)).status.accepted
    assert desk.asked["pmd"].asked == ["track"], "it has never searched"


def test_a_camera_whose_poses_lie_off_never_joins_and_moves_nothing():
    desk = tracking()
    alone = tracking()
    for second in range(3, 7):
        for number in range(1, 10):
            time_s = START_S + second + 0.1 * number
            assert not desk.see("pmd", turned(time_s, 4.0)).status.accepted
        one, other = (each.see("lidar", good(START_S + second + 1.0)) for each in (desk, alone))
        assert one.status.accepted
        np.testing.assert_array_equal(one.odometry.pose.as_matrix(), other.odometry.pose.as_matrix())


def test_a_camera_whose_mount_may_be_as_far_off_joins_and_the_offset_is_known():
    desk = tracking(mount_sigma_deg=2.0)
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
    desk = tracking()
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
    desk = tracking(range_m=(0.0, 5.0))
    output = desk.see("pmd", good(START_S + 3.1))
    assert output.status.reason.startswith("out of range: the target is predicted at 6.")
    assert output.status.reason.endswith("m, range_m is 0 to 5")
    assert desk.asked["pmd"].asked == []
    assert output.odometry is not None


def test_a_pose_that_a_search_finds_beyond_the_configured_range_begins_no_track():
    desk = Desk(range_m=(0.0, 5.0))
    output = desk.see("pmd", good(START_S))
    assert output.status.mode == Mode.ACQUIRING
    assert output.status.reason.startswith("out of range: the target is found at 6.")


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
