"""The navigator's transitions, one by one, with methods that say what the test tells them to."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from navigator_rig import (
    BAD,
    LIMITS,
    MOUNT,
    SECOND_NS,
    START_S,
    Slow,
    View,
    blind,
    failed,
    good,
    in_sensor,
    lost,
    registration,
    rig,
    tracking,
    truth,
    turned,
    untracked,
    wrong,
)
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.belief import SYMMETRY, Belief, Rival, contradicted, worst_sigma
from rpod_pose.navigation.history import History
from rpod_pose.ports import Acquisition, Registration
from rpod_schemas.config.estimator.filter import FilterConfig, FilterTuning
from rpod_schemas.config.sensor import AlertLimit
from rpod_schemas.types import BeliefLevel, LidarScan, Mode, Source
from rpod_target import Equivalence, Symmetry

# --- ACQUIRING ---


def test_a_navigator_begins_by_acquiring():
    made = rig()
    assert made.mode == Mode.ACQUIRING
    assert made.tick(START_S) is None


def test_a_believed_candidate_is_a_hypothesis_to_verify():
    made = rig()
    output = made.see(good(START_S))
    assert made.mode == output.status.mode == Mode.VERIFYING
    assert output.status.accepted
    assert output.odometry is None
    assert (output.status.sensor, output.status.source) == ("pmd", Source.PMD_DEPTH)
    assert output.status.inliers == 500


def test_without_candidates_the_search_goes_on():
    made = rig()
    output = made.see(blind(START_S))
    assert made.mode == Mode.ACQUIRING
    assert not output.status.accepted
    assert output.status.reason == "the search found too few points of the target"


def test_a_candidate_that_is_not_believed_is_no_hypothesis_and_says_why():
    made = rig()
    output = made.see(
        replace(blind(START_S), acquired=(registration(in_sensor(START_S), cost_m2=0.5), failed()))
    )
    assert made.mode == Mode.ACQUIRING
    assert output.status.reason == "not accepted: cost 0.5 m2 above 0.01 m2"
    assert output.status.cost_m2 == 0.5


@pytest.mark.parametrize(
    ("acquired", "best"),
    [
        ([{"explained_share": 0.8}, {"explained_share": 0.95}], 0),
        ([{"cost_m2": 0.5}, {"cost_m2": 0.009}, {"cost_m2": 0.002}], 1),
        ([{"cost_m2": 0.5}, {"explained_share": 0.1}, {}], 2),
    ],
    ids=["the first", "the second, where the first is too costly", "the third"],
)
def test_the_first_believed_candidate_is_taken_and_no_further_one_refined(acquired, best):
    made = rig()
    registrations = tuple(
        registration(in_sensor(START_S + number), inliers=100 + number, **changes)
        for number, changes in enumerate(acquired)
    )
    output = made.see(replace(blind(START_S), acquired=registrations))
    assert output.status.inliers == 100 + best
    assert made.method.asked == ["acquire", *["refine"] * (best + 1)]
    np.testing.assert_allclose(
        made.state.history.state.T_chaser_target.as_matrix(), truth(START_S + best).as_matrix(), atol=1e-12
    )


def test_the_believed_candidate_that_explains_most_is_taken_where_configured():
    made = rig(choice="best_explained")
    shares = (0.8, 0.95, 0.9)
    acquired = tuple(
        registration(in_sensor(START_S), inliers=100 + number, explained_share=share)
        for number, share in enumerate(shares)
    )
    assert made.see(replace(blind(START_S), acquired=acquired)).status.inliers == 101
    assert made.method.asked == ["acquire", *["refine"] * 3]


# --- VERIFYING ---


@pytest.mark.parametrize("confirmations", [0, 1, 3])
def test_tracking_begins_after_as_many_confirmations_as_configured(confirmations):
    made = rig(confirmations=confirmations)
    modes = [made.see(good(START_S + 0.1 * number)).status.mode for number in range(confirmations + 2)]
    assert modes == [Mode.VERIFYING] * confirmations + [Mode.TRACKING] * 2


def test_a_hypothesis_that_the_next_frame_does_not_show_is_dropped():
    made = rig()
    made.see(good(START_S))
    output = made.see(blind(START_S + 0.1))
    assert made.mode == Mode.ACQUIRING
    assert output.status.reason == BAD
    assert output.odometry is None
    assert made.see(good(START_S + 0.2)).status.mode == Mode.VERIFYING


def test_a_hypothesis_that_the_next_frame_contradicts_is_dropped():
    made = rig()
    made.see(good(START_S))
    output = made.see(wrong(START_S + 0.1))
    assert made.mode == Mode.ACQUIRING
    assert output.status.reason.startswith("gate: nis")
    assert output.status.nis > 16.8


def test_while_no_twist_is_known_a_prediction_that_does_not_do_is_searched_around():
    made = rig()
    made.see(good(START_S))
    output = made.see(replace(untracked(START_S + 0.1), nearby=(registration(in_sensor(START_S + 0.1)),)))
    assert made.method.asked == ["track", "near", "refine"]
    assert output.status.mode == Mode.TRACKING


def test_a_frame_from_before_the_hypothesis_is_too_old():
    made = rig()
    made.see(good(START_S))
    output = made.see(good(START_S - 0.05))
    assert output.status.reason.startswith("older than")
    assert made.mode == Mode.VERIFYING


# --- TRACKING ---


def test_tracking_publishes_the_filtered_pose_at_each_frame():
    made = tracking(START_S + 5.0)
    output = made.see(good(START_S + 5.1))
    assert output.status.accepted
    assert output.odometry.stamp_ns == output.status.stamp_ns == round((START_S + 5.1) * SECOND_NS)
    assert (output.odometry.frame_id, output.odometry.child_frame_id) == ("chaser", "target_estimate")
    np.testing.assert_allclose(output.odometry.pose.translation, truth(START_S + 5.1).translation, atol=0.01)
    np.testing.assert_allclose(output.odometry.linear_m_s, [0.0, 0.0, -0.1], atol=0.03)


@pytest.mark.parametrize(("rate_hz", "factor"), [(10, 2.0), (45, 6.0), (90, 12.0)])
def test_frames_that_follow_closely_count_as_much_as_the_time_that_they_span(rate_hz, factor):
    fixed = FilterConfig(tuning=FilterTuning(correlation_inflation=factor))
    by_rate, by_factor = tracking(START_S + 1.0), tracking(START_S + 1.0, filter_config=fixed)
    for frame in range(1, rate_hz + 1):
        view = good(START_S + 1.0 + frame / rate_hz)
        seen = [made.see(view).odometry.pose_covariance for made in (by_rate, by_factor)]
    np.testing.assert_allclose(*map(np.diag, seen), rtol=0.05)


@pytest.mark.parametrize("view", [blind, wrong], ids=["not believed", "gated"])
def test_where_a_measurement_is_rejected_the_prediction_is_published_with_the_reason(view):
    made = tracking(START_S + 5.0)
    output = made.see(view(START_S + 5.1))
    assert made.mode == Mode.TRACKING
    assert not output.status.accepted
    assert output.status.reason
    assert output.odometry.stamp_ns == round((START_S + 5.1) * SECOND_NS)
    np.testing.assert_allclose(output.odometry.pose.translation, truth(START_S + 5.1).translation, atol=0.02)


def test_tracking_searches_nothing():
    made = tracking()
    made.see(blind(START_S + 1.1))
    assert made.method.asked == ["track"]


def test_a_track_whose_prediction_has_become_vague_is_searched_around():
    made = tracking(tuning={"vague_deg": 3.0})
    made.see(replace(untracked(START_S + 1.5), nearby=(registration(in_sensor(START_S + 1.5)),)))
    assert made.method.asked == ["track"]
    output = made.see(replace(untracked(START_S + 9.0), nearby=(registration(in_sensor(START_S + 9.0)),)))
    assert made.method.asked == ["track", "near", "refine"]
    assert output.status.accepted


def test_a_track_goes_on_with_less_explained_than_it_began_with():
    limits = LIMITS.model_copy(update={"min_tracked_share": 0.5})
    made = rig()

    def seen(after_s: float, explained_share: float) -> str:
        view = good(START_S + after_s, limits=limits, explained_share=explained_share)
        return made.see(view).status.reason

    made.see(good(START_S))
    assert seen(0.1, 0.6) == "explained share 0.60 below 0.70"
    made.see(good(START_S + 0.2))
    made.see(good(START_S + 0.3))
    assert seen(0.4, 0.6) == ""
    assert seen(0.5, 0.4) == "explained share 0.40 below 0.50"


QUIET = FilterConfig(acceleration_density_m2_s3=1e-5, angular_acceleration_density_rad2_s3=1e-7)
WIDE = AlertLimit(attitude_deg=30.0, position_m=5.0)


@pytest.mark.parametrize(
    ("rate_hz", "after_s"), [(10.0, 0.2), (1.0, 1.5)], ids=["fast sensor", "slow sensor: 1.5 periods"]
)
def test_without_accepted_frames_for_a_while_the_track_coasts_with_a_prediction(rate_hz, after_s):
    made = tracking(START_S + 4.0, rate_hz, alert=WIDE)
    for number in range(1, 6):
        time_s = number / rate_hz
        output = made.see(blind(START_S + 4.0 + time_s))
        expected = Mode.TRACKING if time_s <= after_s else Mode.COASTING
        assert output.status.mode == made.mode == expected
        assert output.odometry.stamp_ns == round((START_S + 4.0 + time_s) * SECOND_NS)
        assert output.status.reason == BAD


def test_an_accepted_frame_ends_the_coasting():
    made = tracking(alert=WIDE)
    for number in range(1, 8):
        made.see(blind(START_S + 1.0 + 0.1 * number))
    assert made.mode == Mode.COASTING
    assert made.see(good(START_S + 1.8)).status.mode == Mode.TRACKING
    assert made.method.asked == ["track"]


@pytest.mark.parametrize("quiet", [QUIET, FilterConfig()])
@pytest.mark.parametrize(
    ("alert", "reason"),
    [
        (AlertLimit(attitude_deg=1.0, position_m=5.0), "sigma of the attitude 1.0 deg, alert limit 1 deg"),
        (AlertLimit(attitude_deg=30.0, position_m=0.05), "sigma of the position 5"),
        (AlertLimit(attitude_deg=30.0, range_share=0.01), "mm, alert limit 6"),
    ],
)
def test_a_coasting_track_is_lost_when_its_covariance_reaches_the_alert_limit(alert, reason, quiet):
    made = tracking(alert=alert, filter_config=quiet)
    for number in range(1, 1000):
        time_s = START_S + 1.0 + 0.02 * number
        output = made.see(blind(time_s))
        if made.mode == Mode.LOST:
            break
        assert made.mode == (Mode.TRACKING if number <= 10 else Mode.COASTING)
        covariance = output.odometry.pose_covariance
        assert worst_sigma(covariance[3:, 3:]) <= np.deg2rad(alert.attitude_deg)
        assert worst_sigma(covariance[:3, :3]) <= alert.position_limit_m(7.0)
    assert output.odometry is None
    assert reason in output.status.reason
    assert output.status.reason.startswith(f"no measurement was accepted for {0.02 * number:.2f} s, sigma")


@pytest.mark.parametrize(
    ("alert", "reason"),
    [
        (
            AlertLimit(attitude_deg=0.01, position_m=5.0),
            "sigma of the attitude 0.2 deg, alert limit 0.01 deg",
        ),
        (AlertLimit(attitude_deg=30.0, position_m=0.001), "mm, alert limit 1 mm"),
        (WIDE, ""),
    ],
)
def test_a_track_whose_measurements_are_vaguer_than_the_alert_limit_is_unusable(alert, reason):
    made = tracking(alert=alert)
    output = made.see(good(START_S + 1.1))
    assert output.status.mode == Mode.TRACKING
    assert reason in output.unusable
    assert bool(output.unusable) == bool(reason)


def test_a_quiet_target_is_predicted_for_longer_than_a_restless_one():
    def coasted_s(filter_config):
        made, number = tracking(filter_config=filter_config), 0
        while made.mode != Mode.LOST and number < 1000:
            number += 1
            made.see(blind(START_S + 1.0 + 0.02 * number))
        return 0.02 * number

    assert 0.3 < coasted_s(FilterConfig()) < coasted_s(QUIET) < 19.0


def test_silence_is_told_with_predictions_until_the_track_is_lost():
    made = tracking(alert=AlertLimit(attitude_deg=3.0, position_m=0.5), silence_timeout_s=2.5)
    assert made.tick(START_S + 3.5) is None
    output = made.tick(START_S + 3.6)
    assert made.mode == output.status.mode == Mode.COASTING
    assert output.status.reason == "no measurement was accepted for 2.60 s"
    assert output.odometry.stamp_ns == round((START_S + 3.6) * SECOND_NS)
    assert made.tick(START_S + 3.7).odometry.stamp_ns == round((START_S + 3.7) * SECOND_NS)
    output = made.tick(START_S + 30.0)
    assert made.mode == output.status.mode == Mode.LOST
    assert output.odometry is None
    assert "alert limit" in output.status.reason
    assert made.tick(START_S + 31.0) is None


def test_a_clock_that_begins_at_zero_is_as_good_as_any():
    # the LIDAR campaigns' first stamp is 0, and their second frame was lost: 0 was taken for "never accepted"
    made = rig(pose=truth(0.0))
    seen = [made.see(good(float(second))) for second in range(3)]
    assert [output.status.mode for output in seen] == [Mode.TRACKING] * 3
    assert all(output.odometry is not None for output in seen)


def test_rejected_measurements_are_not_silence():
    made = tracking(silence_timeout_s=2.5, alert=WIDE)
    for number in range(1, 5):
        made.see(blind(START_S + 1.0 + number))
        assert made.tick(START_S + 1.0 + number + 0.5) is None
    assert made.mode == Mode.COASTING


@pytest.mark.parametrize("make", [rig, lost])
def test_time_alone_changes_nothing_while_nothing_is_tracked(make):
    made = make()
    state = made.state
    assert made.tick(START_S + 1000.0) is None
    assert made.state is state


# --- LOST ---


def test_a_lost_target_is_first_looked_for_near_the_prediction():
    made = lost()
    output = made.see(good(START_S + 6.1))
    assert made.method.asked == ["track"]
    assert output.status.mode == Mode.VERIFYING
    assert made.see(good(START_S + 6.2)).status.mode == Mode.TRACKING


def test_a_track_that_one_frame_ends_and_begins_again_says_why_it_was_lost():
    made = tracking()
    output = made.see(good(START_S + 60.0))
    assert (output.status.mode, output.status.accepted) == (Mode.VERIFYING, True)
    assert output.lost.startswith("the track was lost: no measurement was accepted for 5")
    assert "alert limit" in output.lost
    assert output.lost.endswith("this frame begins it again")
    assert output.status.evidence["lost_after_s"] == pytest.approx(58.0, abs=2.0)
    assert output.status.reason == ""
    after = made.see(good(START_S + 60.1))
    assert (after.lost, "lost_after_s" in after.status.evidence) == ("", False)


def test_the_search_around_the_prediction_comes_next():
    made = lost()
    made.see(replace(untracked(START_S + 6.1), nearby=(registration(in_sensor(START_S + 6.1)),)))
    assert made.method.asked == ["track", "near", "refine"]
    assert made.mode == Mode.VERIFYING


def test_then_it_is_searched_everywhere():
    made = lost()
    made.see(untracked(START_S + 6.1))
    assert made.method.asked == ["track", "near", "acquire", "refine"]
    assert made.mode == Mode.VERIFYING


def test_the_prediction_is_tried_for_a_while_after_the_loss_only():
    made = lost(tuning={"near_search_s": 3.0})
    made.see(blind(START_S + 9.0))
    assert made.method.asked == ["track", "near", "acquire"]
    made.see(blind(START_S + 9.1))
    assert made.method.asked == ["acquire"]


def test_a_slow_sensors_prediction_is_tried_after_a_loss_by_rejections():
    made = tracking(START_S + 4.0, 1.0, tuning={"near_search_s": 3.0})
    made.see(blind(START_S + 5.0))
    made.see(blind(START_S + 6.0))
    assert made.mode == Mode.LOST
    made.see(good(START_S + 7.0))
    assert made.method.asked == ["track"]
    assert made.mode == Mode.VERIFYING


def test_what_stays_lost_says_why():
    made = lost()
    output = made.see(blind(START_S + 6.1))
    assert made.mode == Mode.LOST
    assert output.status.reason == "the search found too few points of the target"
    assert output.odometry is None


def test_a_recovered_target_is_confirmed_like_a_new_one():
    made = lost(confirmations=2)
    modes = [made.see(good(START_S + 6.1 + 0.1 * number)).status.mode for number in range(3)]
    assert modes == [Mode.VERIFYING, Mode.VERIFYING, Mode.TRACKING]


# --- a given pose ---


@pytest.mark.parametrize("confirmations", [0, 1, 3])
def test_a_given_pose_is_tracked_from_the_first_frame_that_agrees(confirmations):
    made = rig(pose=truth(START_S), confirmations=confirmations)
    assert made.mode == Mode.VERIFYING
    output = made.see(good(START_S))
    assert made.method.asked == ["track"]
    assert output.status.mode == Mode.TRACKING
    assert output.odometry is not None


@pytest.mark.parametrize("view", [blind, wrong])
def test_a_given_pose_that_the_first_frame_does_not_show_is_dropped(view):
    made = rig(pose=truth(START_S))
    assert made.see(view(START_S)).status.mode == Mode.ACQUIRING
    assert made.see(good(START_S + 0.1)).status.mode == Mode.VERIFYING
    assert "acquire" in made.method.asked


def test_a_given_pose_that_the_first_frame_does_not_show_is_searched_around_and_then_everywhere():
    made = rig(pose=truth(START_S))
    output = made.see(untracked(START_S))
    assert made.method.asked == ["track", "near", "acquire", "refine"]
    assert output.status.mode == Mode.VERIFYING
    assert made.see(good(START_S + 0.1)).status.mode == Mode.TRACKING


def test_what_the_search_around_a_given_pose_finds_is_verified_however_far_it_is():
    made = rig(pose=truth(START_S))
    far = wrong(START_S).tracked
    assert made.see(replace(blind(START_S), nearby=(far,))).status.mode == Mode.VERIFYING
    assert made.see(wrong(START_S + 0.1)).status.mode == Mode.TRACKING


def test_a_given_pose_is_predicted_from_its_stamp():
    made = rig()
    made.state = made.navigator.start(truth(START_S), stamp_ns=round(START_S * SECOND_NS))
    made.see(good(START_S + 0.5))
    assert made.mode == Mode.TRACKING
    assert made.state.history.origin.stamp_ns == round(START_S * SECOND_NS)


def test_a_given_pose_of_the_future_holds_for_the_first_frame():
    made = rig()
    made.state = made.navigator.start(truth(START_S), stamp_ns=round((START_S + 9.0) * SECOND_NS))
    assert made.see(good(START_S)).odometry.stamp_ns == round(START_S * SECOND_NS)


def test_a_scan_that_took_its_time_is_tracked_as_of_its_stamp_once_a_twist_is_known():
    made = tracking(START_S + 3.0)
    points_m = np.tile(in_sensor(START_S + 3.1).translation, (2, 1)).astype(np.float32)
    scan = LidarScan(
        stamp_ns=round((START_S + 3.1) * SECOND_NS),
        frame_id="lidar",
        points_m=points_m,
        time_s=np.array([-0.5, 0.5], np.float32),
    )
    given: list[LidarScan] = []

    def track(data: LidarScan, _: RigidTransform) -> Registration:
        given.append(data)
        return failed()

    made.method.track = track
    made.see(scan)
    moved_m = given[0].points_m - points_m
    # the target comes closer by 0.1 m/s: an early return is moved on, a late one back
    velocity_m_s = MOUNT.rotation.inv().apply([0.0, 0.0, -0.1])
    np.testing.assert_allclose(moved_m, np.outer([0.5, -0.5], velocity_m_s), atol=0.01)


# --- late measurements ---


def test_a_late_measurement_is_applied_at_its_own_stamp():
    in_turn, late = tracking(START_S + 1.0), tracking(START_S + 1.0)
    views = [good(START_S + 1.1), good(START_S + 1.2)]
    for view in views:
        in_turn.see(view)
    for view in reversed(views):
        output = late.see(view)
    assert output.status.accepted
    assert output.status.stamp_ns == views[0].stamp_ns
    assert output.odometry.stamp_ns == views[1].stamp_ns, "the output does not go back"
    one, other = in_turn.state.history.state, late.state.history.state
    np.testing.assert_array_equal(one.T_chaser_target.as_matrix(), other.T_chaser_target.as_matrix())
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_the_output_does_not_go_back_behind_a_prediction_that_was_published():
    made = tracking(START_S + 1.0)
    shown = made.see(blind(START_S + 1.5)).odometry.stamp_ns
    output = made.see(good(START_S + 1.2))
    assert output.status.accepted
    assert output.odometry.stamp_ns == shown


def test_the_output_does_not_go_back_after_a_loss():
    made = lost(confirmations=0)
    shown = made.state.shown_ns
    output = made.see(good(START_S + 0.95))
    assert output.status.mode == Mode.TRACKING
    assert output.odometry.stamp_ns == shown


def test_a_measurement_that_comes_too_late_is_rejected_and_changes_nothing():
    made = tracking(START_S + 3.0)
    history = made.state.history
    output = made.see(good(START_S + 1.5))
    assert output.status.reason == "older than the filter's history"
    assert made.mode == Mode.TRACKING
    assert made.state.history is history
    assert output.odometry.stamp_ns == round((START_S + 3.0) * SECOND_NS)


def test_a_late_measurement_may_speak_for_one_that_was_gated_before():
    """The target sets off between two frames: the second is believed once the first has arrived."""
    slow = FilterConfig(initial_velocity_sigma_m_s=0.05)  # so that no manoeuvre explains the second alone
    made = tracking(START_S + 1.0, alert=WIDE, filter_config=slow)
    assert not made.see(wrong(START_S + 2.0, offset_m=0.2)).status.accepted
    assert made.see(wrong(START_S + 1.5, offset_m=0.1)).status.accepted
    moved_m = made.state.history.state.T_chaser_target.translation - truth(START_S + 2.0).translation
    np.testing.assert_allclose(moved_m, [0.0, 0.2, 0.0], atol=0.05)


# --- frames of reference ---


def test_pose_and_covariance_are_turned_into_the_chasers_axes():
    made = rig(
        confirmations=0,
        filter_config=FilterConfig(position_floor_m=0.0, tuning=FilterTuning(correlation_inflation=1.0)),
    )
    covariance = np.diag([0.01, 0.02, 0.03, 1e-4, 2e-4, 3e-4])
    output = made.see(
        replace(blind(START_S), acquired=(registration(in_sensor(START_S), covariance=covariance),))
    )
    np.testing.assert_allclose(output.odometry.pose.as_matrix(), truth(START_S).as_matrix(), atol=1e-12)
    # the sensor's z axis is the chaser's x axis, its x axis the chaser's -z axis
    np.testing.assert_allclose(np.diag(output.odometry.pose_covariance)[:3], [0.03, 0.02, 0.01], atol=1e-12)
    assert np.argmax(np.diag(output.odometry.pose_covariance)[3:]) == 0


# --- properties ---

EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["good", "blind", "wrong", "untracked", "tick"]),
        st.floats(0.02, 3.0),
        st.sampled_from([0.0, 0.0, 0.0, 0.03, 0.5, 2.0]),
    ),
    max_size=25,
)
NEXT = {
    Mode.ACQUIRING: {Mode.ACQUIRING, Mode.VERIFYING},
    Mode.VERIFYING: {Mode.VERIFYING, Mode.ACQUIRING, Mode.TRACKING},
    Mode.TRACKING: {Mode.TRACKING, Mode.COASTING, Mode.LOST, Mode.VERIFYING},  # lost and found in one step
    Mode.COASTING: {Mode.TRACKING, Mode.COASTING, Mode.LOST, Mode.VERIFYING},
    Mode.LOST: {Mode.LOST, Mode.VERIFYING},
}
VIEWS = {"good": good, "blind": blind, "wrong": wrong, "untracked": untracked}


def played(events) -> list:
    """Play events, each after a pause and with a delay; return what was put out."""
    made, now_s, outputs = rig(), START_S, []
    for kind, pause_s, delay_s in events:
        now_s += pause_s
        before = made.mode
        output = made.tick(now_s) if kind == "tick" else made.see(VIEWS[kind](now_s - delay_s))
        assert made.mode in NEXT[before]
        outputs.append(output)
        if kind != "tick":
            assert output.status.mode == made.mode
    return outputs


@settings(deadline=None)
@given(EVENTS)
def test_whatever_happens_the_outputs_keep_their_promises(events):
    newest_ns = 0
    for output in played(events):
        if output is None:
            continue
        assert output.status.accepted == (output.status.reason == "")
        assert (output.odometry is not None) == output.status.mode.has_track
        if output.odometry is not None:
            assert output.odometry.stamp_ns >= newest_ns
            newest_ns = output.odometry.stamp_ns


@settings(deadline=None)
@given(EVENTS)
def test_the_same_events_give_the_same_outputs(events):
    assert pickle.dumps(played(events)) == pickle.dumps(played(events))


# --- targets that look alike in several poses ---

TURNS = [RigidTransform.from_rotation(Rotation.from_rotvec([k * np.pi / 2, 0.0, 0.0])) for k in (1, 2, 3)]
ALIKE = Equivalence.of([Symmetry((1.0, 0.0, 0.0), 4, exact=True)])


def ambiguous(time_s: float, *, by_symmetry: bool) -> Acquisition:
    best = in_sensor(time_s)
    name = SYMMETRY if by_symmetry else "turned by 90 deg"
    rivals = tuple(Rival(name, best * turn, 0.0) for turn in TURNS)
    belief = Belief(BeliefLevel.DOUBTFUL, "4 poses look alike", rivals=rivals)
    return Acquisition(replace(registration(best), belief=belief))


def test_what_is_ambiguous_by_the_targets_symmetry_alone_is_tracked():
    judging = rig(found=ambiguous(START_S, by_symmetry=True), alike=ALIKE, confirmations=1)
    output = judging.see(good(START_S))
    assert judging.mode == Mode.VERIFYING
    assert output.status.accepted
    judging.see(good(START_S + 1.0))
    assert judging.mode == Mode.TRACKING


def test_what_is_merely_ambiguous_is_told_with_its_hypotheses_and_not_tracked():
    judging = rig(found=ambiguous(START_S, by_symmetry=False))
    output = judging.see(good(START_S))
    assert judging.mode == Mode.ACQUIRING
    assert output.odometry is None
    status = output.status
    assert not status.accepted
    assert status.ambiguous
    assert status.reason == "4 poses look alike"
    assert sum(hypothesis.weight for hypothesis in status.hypotheses) == pytest.approx(1.0)
    first = status.hypotheses[0].pose
    np.testing.assert_allclose(first.as_matrix(), truth(START_S).as_matrix(), atol=1e-12)


def test_every_estimate_of_a_symmetric_target_lists_the_poses_that_look_alike():
    judging = rig(found=ambiguous(START_S, by_symmetry=True), alike=ALIKE, confirmations=1)
    for step in range(4):
        time_s = START_S + step
        status = judging.see(good(time_s)).status
        assert status.ambiguous
        hypotheses = status.hypotheses
        assert len(hypotheses) == 4
        assert sum(hypothesis.weight for hypothesis in hypotheses) == pytest.approx(1.0)
        apart = [(hypotheses[0].pose.inv() * other.pose).as_matrix() for other in hypotheses[1:]]
        np.testing.assert_allclose(apart, [turn.as_matrix() for turn in TURNS], atol=1e-12)
        error = truth(time_s).inv() * hypotheses[0].pose
        assert np.linalg.norm(error.translation) < 0.05
        assert error.rotation.magnitude() < 0.05


def test_estimates_of_a_target_without_symmetry_are_not_ambiguous():
    accepted = Acquisition(registration(in_sensor(START_S)))
    judging = rig(found=accepted, confirmations=1)
    for step in range(3):
        status = judging.see(good(START_S + step)).status
        assert not status.ambiguous
        assert status.hypotheses == ()
    assert judging.mode == Mode.TRACKING


def test_a_failed_acquisition_is_not_tracked_and_says_why():
    reason = "does not explain the scan"
    none = Acquisition(replace(registration(in_sensor(START_S)), belief=contradicted(reason)))
    judging = rig(found=none, alike=ALIKE)
    status = judging.see(good(START_S)).status
    assert judging.mode == Mode.ACQUIRING
    assert (status.accepted, status.reason) == (False, "does not explain the scan")
    assert not status.ambiguous


# --- a stream that does not support what is tracked ---


def unsupported(time_s: float, level: BeliefLevel) -> View:
    """Return a view in which the tracker finds a pose that the frame does not support."""
    belief = Belief(level, "a detail contradicts the pose")
    seen = replace(registration(in_sensor(time_s)), belief=belief)
    return View(round(time_s * SECOND_NS), tracked=seen, acquired=(registration(in_sensor(time_s)),))


@pytest.mark.parametrize("level", [BeliefLevel.DOUBTFUL, BeliefLevel.CONTRADICTED])
def test_a_track_that_every_third_frame_does_not_support_is_lost_and_does_not_come_back(level):
    made = tracking()
    modes = []
    for number in range(1, 200):
        time_s = START_S + 1.0 + number / 45.0
        view = good(time_s) if number % 3 else unsupported(time_s, level)
        output = made.see(view)
        modes.append(output.status.mode)
        if modes[-1] == Mode.LOST and Mode.LOST not in modes[:-1]:
            why = "of the recent frames do not support the tracked pose: a detail contradicts the pose"
            assert why in output.status.reason
    assert Mode.LOST in modes
    assert Mode.TRACKING not in modes[modes.index(Mode.LOST) :]


def test_a_track_that_few_frames_do_not_support_goes_on():
    made = tracking()
    for number in range(1, 200):
        time_s = START_S + 1.0 + number / 45.0
        made.see(good(time_s) if number % 6 else unsupported(time_s, BeliefLevel.CONTRADICTED))
        assert made.mode == Mode.TRACKING


def test_a_stream_that_did_not_support_a_track_is_tracked_once_it_has_agreed_for_long_enough():
    made = tracking()
    for number in range(1, 60):
        made.see(unsupported(START_S + 1.0 + number / 45.0, BeliefLevel.DOUBTFUL))
    assert made.mode != Mode.TRACKING
    modes = [made.see(good(START_S + 3.0 + number / 45.0)).status.mode for number in range(120)]
    assert modes[1] == Mode.VERIFYING
    assert modes[-1] == Mode.TRACKING


def test_the_track_goes_on_at_the_second_of_two_believed_poses_that_the_gate_refused_and_that_agree():
    made = tracking()
    first, second = (made.see(turned(START_S + 1.0 + 0.1 * n, 8.0)) for n in (1, 2))
    assert (first.status.accepted, second.status.accepted) == (False, True)
    assert second.status.mode == Mode.TRACKING
    seen = MOUNT * turned(START_S + 1.2, 8.0).tracked.T_sensor_target
    assert (second.odometry.pose.rotation * seen.rotation.inv()).magnitude() < np.deg2rad(1.0)


def test_refused_poses_that_do_not_agree_with_each_other_leave_the_track_as_it_is():
    made = tracking()
    for number, angle_deg in enumerate((8.0, -8.0, 8.0, -8.0), start=1):
        assert not made.see(turned(START_S + 1.0 + 0.1 * number, angle_deg)).status.accepted
    assert made.see(good(START_S + 1.5)).status.accepted


def test_a_track_is_lost_soon_if_believed_poses_agree_on_another_attitude():
    made = tracking()
    outputs = [made.see(turned(START_S + 1.0 + 0.1 * number, 90.0)) for number in (1, 2, 3)]
    assert [output.status.mode for output in outputs] == [Mode.TRACKING, Mode.TRACKING, Mode.LOST]
    assert outputs[-1].status.reason == "believed poses agree on another attitude than the tracked one"


def test_a_pose_outside_the_range_of_its_sensor_is_not_verified_for_ever():
    made = rig(range_m=(6.5, 50.0), confirmations=100)
    outputs = [made.see(good(START_S + 0.1 * number)) for number in range(60)]
    modes = [each.status.mode for each in outputs]
    ended = modes.index(Mode.ACQUIRING)
    assert set(modes[:ended]) == {Mode.VERIFYING}
    assert (
        outputs[ended].status.reason == "out of range: the target is predicted at 6.5 m, range_m is 6.5 to 50"
    )
    assert set(modes[ended:]) == {Mode.ACQUIRING}


def test_a_target_that_is_found_again_outside_the_range_of_its_sensor_stays_lost():
    made = lost(range_m=(6.5, 50.0))
    output = made.see(good(START_S + 6.1))
    assert output.status.reason.startswith("out of range: the target is found at 6.")
    assert (made.mode, output.status.accepted) == (Mode.LOST, False)


def test_poses_that_a_lost_track_refused_are_no_evidence_against_the_next_one():
    made = tracking(confirmations=0)
    made.see(turned(START_S + 1.1, 60.0))
    made.tick(START_S + 10.0)
    assert made.see(untracked(START_S + 20.0)).status.mode == Mode.TRACKING
    assert made.see(turned(START_S + 20.1, 60.0)).status.mode == Mode.TRACKING


def test_a_track_that_goes_on_at_agreeing_poses_is_supported_by_them():
    made = tracking()
    outputs = [made.see(turned(START_S + 1.0 + 0.1 * number, 12.0)) for number in (1, 2, 3)]
    assert [each.status.accepted for each in outputs] == [False, True, True]
    assert [each.lost for each in outputs] == ["", "", ""]


def test_an_estimate_beyond_the_alert_limit_stays_so_while_no_frame_comes():
    made = tracking(alert=AlertLimit(attitude_deg=0.01), rate_hz=0.5, until_s=START_S + 10.0)
    told = made.tick(START_S + 12.8)
    assert made.mode == Mode.TRACKING
    assert told.unusable.startswith("sigma of the attitude")


def test_a_lost_track_tells_since_when_nobody_saw_the_target_and_whether_frames_contradicted_it():
    silent = lost()
    assert silent.state.unseen_ns == round((START_S + 1.0) * SECOND_NS)
    assert silent.state.before_loss is not None

    refuted = tracking()
    belief = Belief(BeliefLevel.CONTRADICTED, "30% contradict")
    for number in range(1, 60):
        view = good(START_S + 1.0 + 0.02 * number)
        refuted.see(replace(view, tracked=replace(view.tracked, belief=belief)))
        if refuted.mode == Mode.LOST:
            break
    assert refuted.mode == Mode.LOST
    assert refuted.state.unseen_ns == round((START_S + 1.0) * SECOND_NS)
    assert refuted.state.before_loss is None

    contested = tracking()
    for number in range(1, 5):
        contested.see(turned(START_S + 1.0 + 0.1 * number, 60.0))
        if contested.mode == Mode.LOST:
            break
    assert contested.mode == Mode.LOST
    assert contested.state.unseen_ns is None, "believed poses show it at another attitude"
    assert contested.state.before_loss is None


def test_a_track_that_coasts_tells_since_when_until_it_coasts_again():
    made = tracking(alert=WIDE)
    for number in range(1, 8):
        made.see(blind(START_S + 1.0 + 0.1 * number))
    assert made.mode == Mode.COASTING
    for number in range(8, 10):
        assert made.state.unseen_ns == round((START_S + 1.0) * SECOND_NS)
        assert made.see(good(START_S + 1.0 + 0.1 * number)).status.mode == Mode.TRACKING


def test_a_track_that_was_lost_long_ago_is_not_predicted_any_more():
    made = lost(tuning={"near_search_s": 10.0})
    slow = replace(made.state.history.state, model=Slow(30.0))
    made.state = replace(made.state, history=History(slow))
    for since_s in (20.0, 3600.0):
        assert not made.see(blind(START_S + since_s)).status.accepted
        assert made.mode == Mode.LOST
        assert made.method.asked == ["acquire"]
