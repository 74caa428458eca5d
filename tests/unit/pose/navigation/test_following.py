"""A first pose whose search took long, of a target that has turned since."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, failed, registration
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_estimator.search_process import found_as_in_process
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.first_pose.following import MOST_KEPT, kept
from rpod_pose.navigation.first_pose.searches import AGE_S, BEGUN, FOLLOWED, Found, Search
from rpod_pose.navigation.navigator import Navigator
from rpod_pose.ports import Acquisition, Methods
from rpod_schemas.config.estimator import EstimatorSettings, PmdInput
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import Mode

RATE_DEG_S, CAPTURE_DEG = 10.0, 8.0


@dataclass(frozen=True)
class Frame:
    """A frame that shows the target, or nothing."""

    stamp_ns: int
    shows: bool = True
    lasting_s: float = 0.0

    @property
    def pose(self) -> RigidTransform:
        """T_sensor_target."""
        turn_rad = np.radians(RATE_DEG_S) * (self.stamp_ns / SECOND_NS - START_S)
        return make_pose(rotation=Rotation.from_rotvec([0.0, turn_rad, 0.0]), translation_m=(0.0, 0.1, 6.0))


@dataclass
class Method:
    """A search that finds the target, and a tracker that converges from nearby only."""

    tracked: list[int] = field(default_factory=list)

    def acquire(self, frame: Frame) -> Acquisition:
        return Acquisition(registration(frame.pose) if frame.shows else failed())

    def near(self, *_: object) -> Acquisition:
        return Acquisition(failed())

    def track(self, frame: Frame, T_sensor_target: RigidTransform):
        self.tracked.append(frame.stamp_ns)
        off_rad, _ = pose_error(frame.pose, T_sensor_target)
        near = frame.shows and np.degrees(np.linalg.norm(off_rad)) < CAPTURE_DEG
        return registration(frame.pose) if near else failed()


class Port:
    """Searches that end at frames that the test names."""

    def __init__(self, methods: Methods, ends: list[float]) -> None:
        self._methods, self._ends = methods, [round(end_s * SECOND_NS) for end_s in ends]
        self.now_ns = 0

    def result(self, search: Search) -> Found | None:
        if not search.waited or self.now_ns not in self._ends:
            return None
        return found_as_in_process(search, self._methods)


def run(*, ends: list[float], until_s: float, hidden=(), rate_hz: float = 10.0):
    """Return the outputs of frames from the start on, by their time since then, s."""
    method = Method()
    methods = Methods(method, method, None)
    port = Port(methods, [START_S + end_s for end_s in ends])
    settings = EstimatorSettings(sensors=(PmdInput(),))
    navigator = Navigator(settings, {"pmd": methods}, centre_of_mass_m=np.zeros(3), searches=port)
    state, outputs = navigator.start(), {}
    for number in range(round(until_s * rate_hz) + 1):
        since_s = number / rate_hz
        stamp_ns = port.now_ns = round((START_S + since_s) * SECOND_NS)
        frame = Frame(stamp_ns, shows=not any(begin <= since_s <= end for begin, end in hidden))
        state, outputs[since_s] = navigator.step(state, Measurement("pmd", frame, MOUNT))
    return outputs, method


def test_a_target_that_turned_by_60_deg_during_the_search_is_tracked_once_the_pose_is_followed():
    outputs, _ = run(ends=[6.0, 7.0], until_s=8.0)
    ended, caught = outputs[6.0].status, outputs[7.0].status
    assert ended.mode == Mode.ACQUIRING
    assert (ended.reason, ended.evidence) == (FOLLOWED, {AGE_S: 6.0, BEGUN: 1.0})
    assert caught.evidence[AGE_S] == 1.0, "the age of the frame up to which the pose was followed"
    assert caught.accepted
    assert outputs[8.0].status.mode == Mode.TRACKING


def test_frames_that_give_no_pose_on_the_way_are_left_out():
    outputs, _ = run(ends=[6.0, 6.5], until_s=7.5, hidden=[(1.9, 2.2)])
    assert outputs[7.5].status.mode == Mode.TRACKING


def test_a_target_that_the_last_frames_do_not_show_is_tracked_from_the_last_one_that_does():
    outputs, _ = run(ends=[6.0, 6.5], until_s=6.5, hidden=[(5.6, 6.0)])
    assert outputs[6.5].status.accepted


def test_a_target_that_was_hidden_for_too_long_is_searched_again_and_the_reason_is_told():
    outputs, _ = run(ends=[6.0, 6.5], until_s=6.5, hidden=[(0.4, 6.0)])
    assert outputs[6.5].status.mode == Mode.ACQUIRING
    assert (
        "the pose found in the frame 6.00 s before is not followed to this one: "
        in outputs[6.5].status.reason
    )


def test_a_pose_that_the_present_frame_verifies_is_not_followed():
    outputs, method = run(ends=[0.7], until_s=0.7)
    assert outputs[0.7].status.accepted
    assert set(method.tracked) == {round((START_S + 0.7) * SECOND_NS)}


def test_frames_are_kept_half_a_second_apart_and_farther_apart_where_they_are_many():
    frames, since_ns = (), round(START_S * SECOND_NS)
    for number in range(1, 1000):
        event = Measurement("pmd", Frame(since_ns + number * SECOND_NS // 10), MOUNT)
        frames = kept(frames, event, since_ns=since_ns, apart_ns=SECOND_NS // 2)
        if number == 20:
            assert [(each.stamp_ns - since_ns) / SECOND_NS for each in frames] == [0.5, 1.0, 1.5, 2.0]
    steps_s = np.diff([since_ns, *(each.stamp_ns for each in frames)]) / SECOND_NS
    assert MOST_KEPT / 2 <= len(frames) <= MOST_KEPT
    assert steps_s.min() == pytest.approx(steps_s.max(), rel=0.6)
    assert frames[-1].stamp_ns / SECOND_NS > START_S + 97.0
