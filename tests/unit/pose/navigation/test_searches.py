"""Searches whose results come with a later frame: what is applied when, and what is dropped."""

from dataclasses import replace

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, Method, View, blind, good, tracking, untracked

from rpod_analysis.replay.recorded_searches import RecordedSearches
from rpod_estimator.search_process import found_as_in_process
from rpod_pose.measurement import Measurement, Tick
from rpod_pose.navigation.first_pose.searches import AGE_S, BEGUN, SEARCHED, Found, Search
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.navigation.state import Cause, Output
from rpod_pose.ports import Methods
from rpod_pose.search.verified_search import VerifiedSearch
from rpod_schemas.config.estimator import EstimatorSettings, LidarInput, PmdInput
from rpod_schemas.types import EstimatorStatus, Mode


class Slow:
    """A port whose searches end when the test says so."""

    def __init__(self, methods) -> None:
        self._methods = methods
        self.running: dict[str, int] = {}
        self.ended: set[str] = set()

    def result(self, search: Search) -> Found | None:
        if search.sensor in self.ended and search.waited:
            self.ended.discard(search.sensor)
            self.running.pop(search.sensor, None)
            return found_as_in_process(search, self._methods[search.sensor])
        self.running[search.sensor] = search.event.stamp_ns
        return None

    def keep(self, searches) -> None:
        wanted = {search.sensor for search in searches}
        self.running = {name: stamp_ns for name, stamp_ns in self.running.items() if name in wanted}


class Desk:
    """A navigator with a LIDAR and a camera, and a port of searches."""

    def __init__(self, searches=None) -> None:
        settings = EstimatorSettings(sensors=(LidarInput(), PmdInput()))
        self.asked = {"lidar": Method(), "pmd": Method()}
        methods = {
            name: Methods(VerifiedSearch(method, method, "first"), method, lambda data, *_, **__: data)
            for name, method in self.asked.items()
        }
        self.searches = searches.of(methods, {}) if searches else Slow(methods)
        self.navigator = Navigator(settings, methods, centre_of_mass_m=np.zeros(3), searches=self.searches)
        self.state = self.navigator.start()

    def see(self, sensor: str, view: View):
        self.asked[sensor].asked.clear()
        self.state, output = self.navigator.step(self.state, Measurement(sensor, view, MOUNT))
        self.searches.keep(self.state.searches.values())
        return output

    def tick(self, time_s: float):
        self.state, _ = self.navigator.step(self.state, Tick(round(time_s * SECOND_NS)))


def test_a_result_is_applied_at_its_stamp_and_verified_by_the_present_frame():
    desk = Desk()
    first = desk.see("lidar", untracked(START_S))
    assert (first.status.mode, first.status.evidence) == (Mode.ACQUIRING, {BEGUN: 1.0})
    assert desk.asked["lidar"].asked == [], "nothing is searched in the step"
    between = desk.see("lidar", good(START_S + 1.0))
    assert between.status.reason == "searching: the result of the frame 1.00 s ago is awaited"
    desk.searches.ended.add("lidar")
    applied = desk.see("lidar", good(START_S + 2.0))
    assert (applied.status.mode, applied.status.accepted) == (Mode.TRACKING, True)
    assert applied.status.evidence[AGE_S] == 2.0
    assert applied.odometry.stamp_ns == round((START_S + 2.0) * SECOND_NS)
    origin = desk.state.history.origin
    assert origin.stamp_ns == round(START_S * SECOND_NS), "the filter starts at the searched frame"
    assert not desk.state.searches


def test_the_uncertainty_of_a_found_pose_grows_over_the_time_of_the_search():
    sigmas_m = []
    for age_s in (1.0, 3.0):
        desk = Desk()
        desk.see("lidar", good(START_S))
        desk.searches.ended.add("lidar")
        desk.see("lidar", blind(START_S + age_s))
        predicted = desk.state.history.at(
            round((START_S + age_s) * SECOND_NS), desk.navigator._settings.filter
        )
        assert desk.state.mode == Mode.VERIFYING, "its surroundings are being searched"
        sigmas_m.append(float(np.sqrt(predicted.covariance[0, 0])))
    assert sigmas_m[0] > 1.0
    assert sigmas_m[1] > 2.9 * sigmas_m[0]


def test_a_search_in_vain_is_told_with_its_age_and_the_present_frame_is_searched():
    desk = Desk()
    desk.see("lidar", blind(START_S))
    desk.searches.ended.add("lidar")
    output = desk.see("lidar", blind(START_S + 1.0))
    assert output.status.mode == Mode.ACQUIRING
    assert ", in the frame 1.00 s ago; searching: a search in this frame has begun" in output.status.reason
    assert output.status.evidence == {AGE_S: 1.0, BEGUN: 1.0}


def test_a_search_delays_no_other_sensor_and_is_cancelled_by_its_track():
    desk = Desk()
    desk.see("lidar", blind(START_S))
    desk.see("pmd", good(START_S + 0.1))
    assert desk.searches.running.keys() == {"lidar", "pmd"}
    desk.searches.ended.add("pmd")
    assert desk.see("pmd", good(START_S + 0.2)).status.mode == Mode.TRACKING
    assert desk.searches.running == {}, "the tracked pose is offered to the LIDAR"
    assert desk.see("lidar", good(START_S + 0.3)).status.reason.startswith("offered: ")
    assert desk.asked["lidar"].asked == ["track"]


def test_a_result_waits_while_another_sensor_verifies_its_first_pose():
    desk = Desk()
    desk.see("lidar", good(START_S))
    desk.see("pmd", good(START_S + 0.1))
    desk.searches.ended.add("pmd")
    desk.see("pmd", blind(START_S + 0.2))
    assert desk.state.mode == Mode.VERIFYING
    desk.searches.ended.add("lidar")
    assert desk.see("lidar", good(START_S + 1.0)).status.reason.startswith("offered: another sensor verifies")
    desk.searches.ended.add("pmd")
    desk.see("pmd", blind(START_S + 1.1))
    assert desk.state.mode == Mode.ACQUIRING, "the camera's pose was not verified"
    assert desk.see("lidar", good(START_S + 2.0)).status.mode == Mode.TRACKING


def test_a_frame_near_the_prediction_ends_the_search_after_a_loss():
    desk = Desk()
    desk.see("lidar", good(START_S))
    desk.searches.ended.add("lidar")
    desk.see("lidar", good(START_S + 1.0))
    desk.state = replace(desk.state, mode=Mode.LOST, lost_ns=round((START_S + 1.0) * SECOND_NS))
    assert desk.see("lidar", blind(START_S + 2.0)).status.evidence == {BEGUN: 1.0}
    assert desk.see("lidar", good(START_S + 3.0)).status.mode == Mode.VERIFYING
    assert desk.searches.running == {}


def test_a_replay_applies_the_results_at_the_recorded_frames():
    """A pose that is not verified, two searches in vain, one that succeeds, and one that is cancelled."""
    frames = [("lidar", blind(START_S))]
    frames += [("pmd", untracked(START_S + 0.1 * number)) for number in range(1, 4)]
    frames += [("lidar", blind(START_S + 1.0)), ("pmd", blind(START_S + 1.05))]
    frames += [("pmd", good(START_S + 1.0 + 0.1 * number)) for number in range(1, 12)]
    live, ends = Desk(), {3: "pmd", 5: "pmd", 8: "pmd", 12: "pmd"}
    outputs = []
    for number, (sensor, view) in enumerate(frames):
        live.searches.ended |= {ends[number]} if number in ends else set()
        outputs.append(live.see(sensor, view))
    assert outputs[-1].status.mode == Mode.TRACKING
    assert sum(AGE_S in each.status.evidence for each in outputs) == 3
    recorded = RecordedSearches()
    again = Desk(recorded)
    for (sensor, view), output in zip(frames, outputs, strict=True):
        recorded.evidence = output.status.evidence
        repeated = again.see(sensor, view)
        assert repeated.status.model_dump_json() == output.status.model_dump_json()
        if output.odometry is not None:
            np.testing.assert_array_equal(
                repeated.odometry.pose.as_matrix(), output.odometry.pose.as_matrix()
            )


@pytest.mark.parametrize("delay", [1, 3])
def test_a_configured_delay_counts_the_frames_of_the_sensor(delay):
    settings = EstimatorSettings(sensors=(PmdInput(),)).model_copy()
    limits = settings.navigator
    tuning = limits.tuning.model_copy(update={"search_delay_frames": delay})
    settings = settings.model_copy(update={"navigator": limits.model_copy(update={"tuning": tuning})})
    method = Method()
    methods = {"pmd": Methods(VerifiedSearch(method, method, "first"), method)}
    navigator = Navigator(settings, methods, centre_of_mass_m=np.zeros(3))
    state, modes = navigator.start(), []
    for number in range(5):
        state, output = navigator.step(state, Measurement("pmd", good(START_S + 0.1 * number), MOUNT))
        modes.append(output.status.mode)
    assert modes == [Mode.ACQUIRING] * delay + [Mode.TRACKING] * (5 - delay)


def test_a_tracked_frame_is_not_delayed_by_the_search_around_a_vague_prediction():
    rig = tracking()
    searches = Slow({"pmd": rig.navigator._methods["pmd"]})
    rig.navigator._searches = searches
    missed = [rig.see(blind(START_S + 1.0 + 0.1 * number)) for number in range(1, 9)]
    assert any(BEGUN in output.status.evidence for output in missed)
    assert all(output.odometry is not None for output in missed if output.status.mode.has_track)


def test_what_is_told_of_a_search_is_kept_apart_from_the_frames_own_reason():
    words = "a sensor's own words; searching: nothing"
    status = EstimatorStatus(stamp_ns=1, frame_id="chaser", mode=Mode.LOST, reason=words)
    told = Output(status, None)
    assert (told.why, told.search) == (words, "")
    both = replace(told, search=SEARCHED).explained(words, Cause.SLOW_SEARCH)
    assert both.status.reason == f"{words}; {SEARCHED}"
    assert (both.why, both.cause) == (words, Cause.SLOW_SEARCH)
    assert replace(told, search=SEARCHED).explained("", Cause.OTHER).why == ""


@pytest.mark.parametrize("cause", [Cause.OTHER, Cause.OUT_OF_RANGE])
def test_where_neither_the_searched_frame_nor_this_one_is_used_the_cause_is_that_of_the_reason_in_front(
    cause,
):
    def output(reason: str, cause: Cause) -> Output:
        status = EstimatorStatus(stamp_ns=1, frame_id="chaser", mode=Mode.LOST, reason=reason)
        return Output(status, None, cause=cause)

    both = output("too far", Cause.OUT_OF_RANGE).after_search(output("of the search", cause), 0.5)
    assert both.status.reason.startswith("of the search, in the frame 0.50 s ago; too far")
    assert both.cause is cause
