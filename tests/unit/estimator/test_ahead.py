"""Registration of a scan while images are processed."""

from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, Desk, good, tracking_by_lidar

from rpod_estimator.ahead import Ahead, AheadTracker, Held
from rpod_estimator.frame_reader import Arrived
from rpod_pose.measurement import Measurement
from rpod_schemas.config.estimator import EstimatorConfig, LidarInput, PmdInput
from rpod_schemas.poses import make_pose
from rpod_schemas.types import LidarScan, Mode

WAIT_S = 10.0
AWAY, NEAR = make_pose(translation_m=[0.0, 0.0, 9.0]), make_pose(translation_m=[0.0, 0.0, 8.0])
CONFIG = EstimatorConfig(target="mockup", sensors=(LidarInput(), PmdInput()))


def scan(first_m: float = 9.0) -> LidarScan:
    points_m = np.array([[0.0, 0.0, first_m], [np.nan] * 3], np.float32)
    return LidarScan(stamp_ns=1, frame_id="lidar", points_m=points_m)


class Counting:
    def __init__(self) -> None:
        self.calls = 0

    def track(self, measurement: LidarScan, _: object) -> tuple[int, float]:
        self.calls += 1
        return self.calls, float(measurement.points_m[0, 2])


def test_a_registration_that_was_made_ahead_is_used_once_for_an_equal_frame_and_prediction():
    tracker = AheadTracker(counting := Counting())
    tracker.prepare(scan(), AWAY)
    assert tracker.track(scan(), make_pose(translation_m=[0.0, 0.0, 9.0])) == (1, 9.0)
    assert tracker.track(scan(), AWAY) == (2, 9.0)
    assert counting.calls == 2


@pytest.mark.parametrize(("frame", "predicted"), [(scan(9.1), AWAY), (scan(), NEAR)])
def test_another_frame_or_prediction_is_registered_anew(frame, predicted):
    tracker = AheadTracker(Counting())
    tracker.prepare(scan(), AWAY)
    assert tracker.track(frame, predicted) == (2, pytest.approx(frame.points_m[0, 2]))


def ahead_of(desk: Desk) -> tuple[Ahead, dict]:
    """Return the decision for a desk, whose methods follow it from now on."""
    ahead = Ahead(CONFIG)
    methods = desk.navigator._methods
    methods["lidar"] = ahead.following("lidar", methods["lidar"])
    methods["pmd"] = ahead.following("pmd", replace(methods["pmd"], deskew=None))
    return ahead, methods


def event(sensor: str, time_s: float) -> Measurement:
    return Measurement(sensor, good(time_s), MOUNT)


def test_a_scan_that_was_registered_ahead_gives_the_same_estimate_without_being_registered_again():
    outputs = []
    for goes_ahead in (False, True):
        desk = tracking_by_lidar()
        ahead, methods = ahead_of(desk)
        event_of_scan = event("lidar", START_S + 3.5)
        if goes_ahead:
            ahead.of(desk.state, event_of_scan, methods["lidar"])()
        desk.asked["lidar"].asked.clear()
        desk.state, _ = desk.navigator.step(desk.state, event("pmd", START_S + 3.6))
        desk.state, output = desk.navigator.step(desk.state, event_of_scan)
        assert desk.asked["lidar"].asked == ([] if goes_ahead else ["track"])
        assert output.status.accepted
        outputs.append(output.odometry.model_dump_json())
    assert outputs[0] == outputs[1]


def test_frames_are_not_registered_ahead_without_a_track_of_their_sensor_that_scans():
    desk = tracking_by_lidar()
    ahead, methods = ahead_of(desk)
    assert ahead.of(desk.state, event("lidar", START_S + 3.5), methods["lidar"]) is not None
    assert ahead.of(desk.state, event("pmd", START_S + 3.5), methods["pmd"]) is None
    without = replace(desk.state, established=frozenset({"pmd"}))
    assert ahead.of(without, event("lidar", START_S + 3.5), methods["lidar"]) is None
    for mode in (Mode.VERIFYING, Mode.COASTING, Mode.LOST):
        state = replace(desk.state, mode=mode)
        assert ahead.of(state, event("lidar", START_S + 3.5), methods["lidar"]) is None
    too_old = event("lidar", START_S - 5.0)
    assert ahead.of(desk.state, too_old, methods["lidar"]) is None


def always(*_: object) -> bool:
    return True


def arrived(sensor: str, time_s: float) -> Arrived:
    return Arrived(sensor, round(time_s * SECOND_NS), 0.0, None)


def test_images_pass_a_scan_until_it_is_registered():
    may_end, woken = Event(), Event()
    with Held(1.0, woken.set) as held:
        held.hold(first := arrived("lidar", 10.0), lambda: may_end.wait(WAIT_S))
        assert not held.is_free
        assert held.due() is None
        assert held.due_before(arrived("pmd", 10.9), always) is None
        may_end.set()
        assert woken.wait(WAIT_S)
        assert held.due_before(arrived("pmd", 10.9), always) is first
        assert held.is_free
        assert held.due() is None


def test_no_image_passes_a_scan_where_the_scans_before_it_support_the_track_no_more():
    desk = tracking_by_lidar()  # a scan a second
    ahead, _ = ahead_of(desk)
    at_ns = {late_s: round((START_S + 3.0 + late_s) * SECOND_NS) for late_s in (1.4, 1.6)}
    assert ahead.may_pass(desk.state, "lidar", at_ns[1.4])
    assert not ahead.may_pass(desk.state, "lidar", at_ns[1.6])
    with Held(9.0, lambda: None) as held:
        held.hold(first := arrived("lidar", 10.0), lambda: None)
        assert held.due_before(arrived("pmd", 10.1), lambda *_: False) is first


@pytest.mark.parametrize("later", [arrived("lidar", 10.5), arrived("pmd", 11.0)])
def test_the_next_scan_and_an_image_after_which_it_would_be_too_old_wait_for_a_scan(later):
    done = []
    with Held(1.0, lambda: None) as held:
        held.hold(first := arrived("lidar", 10.0), lambda: done.append(Event().wait(0.01)))
        assert held.due_before(later, always) is first
        assert len(done) == 1
        assert held.rest() is None


def test_an_error_of_a_registration_is_raised_where_its_scan_is_due():
    def failing() -> None:
        raise ValueError("no registration")

    with Held(1.0, lambda: None) as held:
        held.hold(arrived("lidar", 10.0), failing)
        with pytest.raises(ValueError, match="no registration"):
            held.rest()
