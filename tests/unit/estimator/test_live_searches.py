"""Searches beside a live estimator: one a sensor, cancelled when nobody waits, limited when unsuccessful."""

import os
import signal
from multiprocessing import Pipe

import numpy as np
import pytest
from navigator_rig import SECOND_NS, registration
from pmd_frames import depth_frame, frame_of
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_estimator.estimator import Estimator
from rpod_estimator.frame_reader import Arrived
from rpod_estimator.live_searches import LiveSearches
from rpod_estimator.search_process import SearchProcess, found_as_in_process, packed
from rpod_pose.cancellation import CancelledError, cancelled_if
from rpod_pose.measurement import Measurement
from rpod_pose.methods import methods_of
from rpod_pose.navigation.first_pose.searches import BEGUN, FOUND, PAUSED, Found, Search
from rpod_pose.ports import Acquisition, Candidate, Candidates, Registration
from rpod_pose.search.verified_search import VerifiedSearch
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera, Source
from rpod_target import load_target

WALL = frame_of(5.0, camera=Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5))
NOTHING = Found.nothing("no target")


class Worker:
    """A worker whose searches end when the test says so."""

    def __init__(self) -> None:
        self.began: list[int] = []
        self.found: Found | None = None
        self.cancelled = 0
        self.is_ready = True

    def begin(self, search, _setup) -> None:
        self.began.append(search.event.stamp_ns)

    def result(self):
        found, self.found = self.found, None
        return found

    def cancel(self) -> None:
        self.cancelled += 1

    def end(self) -> None:
        pass


def search(stamp_ns: int, frame=WALL) -> Search:
    event = Measurement("pmd", frame.model_copy(update={"stamp_ns": stamp_ns}), RigidTransform.identity())
    return Search(event, event.data)


class Desk:
    def __init__(self) -> None:
        self.worker, self.now_s = Worker(), 0.0
        self.live = LiveSearches({"pmd": self.worker}, now_s=lambda: self.now_s).of({}, {"pmd": ()})


def test_a_search_begins_once_and_its_result_is_handed_out_when_it_is_there():
    desk, asked = Desk(), search(1)
    assert [desk.live.result(asked) for _ in range(3)] == [None] * 3
    desk.worker.found = NOTHING
    assert desk.live.result(asked) is NOTHING
    assert desk.worker.began == [1]


def test_a_search_that_nobody_waits_for_is_cancelled():
    desk = Desk()
    desk.live.result(search(1))
    desk.live.keep([search(1)])
    assert desk.worker.cancelled == 0
    desk.live.keep([])
    assert desk.worker.cancelled == 1
    assert desk.live.result(search(2)) is None
    assert desk.worker.began == [1, 2]


def test_a_result_that_waits_for_a_frame_is_told_once_and_handed_out_later():
    desk, asked = Desk(), search(1)
    assert desk.live.unreported("pmd") is None
    desk.live.result(asked)
    assert desk.live.unreported("pmd") is None, "it runs"
    desk.worker.found = NOTHING
    assert desk.live.unreported("pmd") == (asked, NOTHING)
    assert desk.live.unreported("pmd") is None
    assert desk.live.result(asked) is NOTHING


@pytest.mark.parametrize(
    ("found", "reason"),
    [(NOTHING, "no target"), (Found(Acquisition(registration(make_pose()))), FOUND)],
)
def test_a_single_frame_is_told_what_its_search_has_found(found, reason):
    config = EstimatorConfig(target="mockup", sensors=(PmdInput(),))
    desk = Desk()
    estimator = Estimator(config, load_target("mockup"), desk.live.of)
    seen = Measurement("pmd", WALL, make_pose())
    asked = estimator.process(Arrived("pmd", WALL.stamp_ns, 0.0, seen))
    assert asked.status.evidence == {BEGUN: 1.0}
    before = estimator._state
    desk.worker.found = found
    soon_ns, late_ns = WALL.stamp_ns + 2 * SECOND_NS, WALL.stamp_ns + 3 * SECOND_NS
    assert list(estimator.unreported(soon_ns, desk.live)) == [], "the next frame may come yet"
    (told,) = estimator.unreported(late_ns, desk.live)
    assert told.status.reason.startswith(reason)
    assert told.status.stamp_ns == WALL.stamp_ns
    assert not told.status.accepted
    assert told.status.evidence[BEGUN] == 1.0, "a replay knows by it when the search began"
    assert estimator._state is before
    assert list(estimator.unreported(late_ns, desk.live)) == []


def test_another_search_takes_the_place_of_the_one_that_runs():
    desk = Desk()
    desk.live.result(search(1))
    desk.live.result(search(2))
    assert (desk.worker.cancelled, desk.worker.began) == (1, [1, 2])


def test_searches_in_vain_take_a_tenth_of_the_time_after_ten_seconds():
    desk, searched_s, number = Desk(), 0.0, 0
    while desk.now_s < 110.0:
        number += 1
        asked = search(number)
        if desk.live.result(asked) is None:
            desk.now_s += 0.5
            desk.worker.found = NOTHING
            assert desk.live.result(asked) is NOTHING
            searched_s += 0.5 if desk.now_s > 10.5 else 0.0
        desk.now_s += 0.02
    assert searched_s == pytest.approx(10.0, abs=1.0)
    assert desk.live.pause_s == pytest.approx(5.0)
    assert desk.live.result(search(number + 1)).acquisition.belief.refusal == PAUSED
    desk.live.end_pauses()
    assert desk.live.result(search(number + 2)) is None


def test_arrays_stay_read_only_on_their_way_to_a_process():
    import pickle  # noqa: PLC0415 - the way back

    image = np.zeros((3, 4), np.float32)
    image.setflags(write=False)
    frozen, free = pickle.loads(packed((image, np.ones(2))))  # noqa: S301 - our own
    assert (frozen.flags.writeable, free.flags.writeable) == (False, True)


def test_a_process_finds_what_a_search_in_this_process_finds_and_replaces_itself(caplog):
    camera = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
    pose = make_pose(
        rotation=Rotation.from_euler("ZYX", [12.0, 25.0, 5.0], degrees=True), translation_m=[0.05, 0.0, 4.0]
    )
    target, sensor = load_target("mockup"), PmdInput()
    frame = depth_frame(target, pose, noise_m=0.01, camera=camera)
    asked = search(7, frame)
    process = SearchProcess("mockup", sensor)
    stops = signal.SIGTERM, signal.SIGINT, signal.SIGHUP  # to all of a group: the estimator ends this process
    try:
        for each in stops:
            os.kill(process._process.pid, each)  # it is still being started
        process.begin(asked, ())
        found = awaited(process)
        for each in stops:
            os.kill(process._process.pid, each)
        expected = found_as_in_process(asked, methods_of(sensor, target))
        one, other = (each.acquisition.pose.as_matrix() for each in (found, expected))
        np.testing.assert_array_equal(one, other)
        process.begin(asked, ())
        process.cancel()
        process.begin(search(8, frame), ())
        assert awaited(process).acquisition.pose is not None, "the dropped result is not this one's"
    finally:
        process.end()
    assert not caplog.records, "an orderly stop does not shout"


def test_a_search_that_nobody_waits_for_ends_at_its_next_step():
    ours, theirs = Pipe()
    wanted = iter((True, True, False))

    class Tracker:
        asked = 0

        def track(self, *_: object) -> Registration:
            self.asked += 1
            if not next(wanted):
                ours.send_bytes(b"cancel")
            return Registration.none(Source.NONE, "nothing to see")

    class Candidates8:
        def search(self, _: object) -> Candidates:
            return Candidates((Candidate(make_pose(), 0.0),) * 8)

    tracker = Tracker()
    acquirer = VerifiedSearch(Candidates8(), tracker, "first")
    with pytest.raises(CancelledError), cancelled_if(theirs.poll):
        acquirer.acquire(WALL)
    assert tracker.asked == 3
    wanted = iter([True] * 8)
    acquirer.acquire(WALL)
    assert tracker.asked == 11, "without anybody to lose interest all candidates are tried"


def test_a_process_that_ends_is_told_and_started_again_after_pauses_that_grow(caplog):
    now_s = 0.0
    process = SearchProcess("no such target", PmdInput(), now_s=lambda: now_s)
    try:
        for begin_s, pause_s in ((0.0, 3.0), (4.0, 6.0)):
            now_s = begin_s
            process.begin(search(1), ())
            found = awaited(process)
            assert f"started again after {pause_s:.0f} s" in found.acquisition.belief.refusal
            assert process.result() is None
    finally:
        process.end()
    assert [record.levelname for record in caplog.records] == ["ERROR"] * 2


def awaited(process: SearchProcess) -> Found:
    for _ in range(600):
        if (found := process.result()) is not None:
            return found
        process._connection.poll(0.1)
    raise AssertionError("no result")
