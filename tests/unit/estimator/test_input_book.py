"""When an operator is told that an input is not used, and in which words."""

import logging

import pytest

from rpod_estimator.frame_reader import Arrived
from rpod_estimator.inputs.book import (
    JOINING,
    LOCKSTEP_SILENCE_S,
    OUT_OF_RANGE,
    SEARCHING,
    Loss,
    SensorBook,
    unpaired,
)
from rpod_estimator.inputs.health import InputHealth
from rpod_pose.belief import AMPLITUDE_LEFT_OUT, NOISE_M, STATED_NOISE_M
from rpod_pose.navigation.state import Cause, Output
from rpod_runtime.assembler import Assembler
from rpod_runtime.health import HealthBook
from rpod_runtime.sensor_data.stamp_watch import clock_hint
from rpod_schemas.config.estimator.estimator import NavigatorTuning
from rpod_schemas.types import EstimatorStatus, Health, Mode

LATE = Loss("late", "late: 1.200 s old, filter.max_delay_s is 1; check the sensor's clock")
REFUSED = Loss("rejected", "7.5% of 900 pixels are inconsistent with the pose, limit 5%")
FAR = Loss(OUT_OF_RANGE, "out of range: the target is predicted at 64.8 m, range_m is 0 to 17")
US = 1_000


def book_after(losses, *, rate_hz=8.0):
    """Return a book, and the time, after frames with these losses; None stands for a frame that was used."""
    book, now_s = SensorBook("pmd", "depth", now_s=0.0), 0.0
    for loss in losses:
        now_s += 1.0 / rate_hz
        book.note_arrival(now_s)
        if loss is None:
            book.use(now_s)
        else:
            book.lose(loss, now_s)
    return book, now_s


@pytest.mark.parametrize(
    ("losses", "level", "words"),
    [
        ([None] * 30, Health.OK, ""),
        ([LATE, None] * 15, Health.OK, ""),
        (
            [None, LATE, LATE] * 10,
            Health.WARN,
            "pmd: only 5 of 17 frames used in 2.0 s; 12 of 17: late: 1.200",
        ),
        ([LATE] * 30, Health.ERROR, "pmd: no frame used in 2.0 s; 17 of 17: late: 1.200 s old"),
        ([REFUSED, LATE, LATE] * 10, Health.ERROR, " of 17: late"),
        ([LATE] * 30 + [None] * 21, Health.OK, ""),
        ([LATE] * 10, Health.OK, ""),
    ],
    ids=["used", "half", "most", "all", "two reasons", "used again", "not yet two seconds"],
)
def test_the_level_follows_the_share_of_frames_that_were_not_used(losses, level, words):
    book, now_s = book_after(losses)
    state = book.state(now_s)
    assert state.level == level
    assert words in state.text
    assert bool(words) == bool(state.text)


BUSY = "this machine is busy: load 5.0 on 2 cores"


@pytest.mark.parametrize(
    ("busy", "remedy"),
    [("", "lower the sensor's rate or its image size"), (BUSY, f"{BUSY}; end other work, or lower the")],
)
def test_frames_that_are_mostly_dropped_are_told_with_the_load_of_the_machine(busy, remedy):
    book, now_s = book_after([None] * 16)
    book.note("load", busy)
    for _ in range(15):
        book.drop(now_s)
    assert book.state(now_s).level == Health.OK
    for _ in range(5):
        book.drop(now_s)
    state = book.state(now_s)
    assert state.level == Health.WARN
    assert "20 of 36 frames dropped: they come faster than they are processed" in state.text
    assert remedy in state.text
    assert "dropped" not in book.state(now_s + 3.0).text


def test_a_search_that_takes_long_on_a_busy_machine_is_told_with_its_load():
    book, now_s = book_after([Loss(SEARCHING, "its search for a first pose takes long")] * 30)
    assert "busy" not in book.state(now_s).text
    book.note("load", BUSY)
    assert BUSY in book.state(now_s).text


@pytest.mark.parametrize(("every", "level"), [(2, Health.WARN), (7, Health.WARN), (16, Health.OK)])
def test_frames_that_support_the_pose_too_little_are_told_although_they_are_used(every, level):
    book, now_s = SensorBook("pmd", "depth", now_s=0.0), 0.0
    for number in range(60):
        now_s += 1.0 / 15.0
        book.note_arrival(now_s)
        book.use(now_s, "66% of the edges are in their place" if number % every == 0 else "")
    state = book.state(now_s)
    assert state.level == level
    words = "frames support the pose too little: 66% of the edges are in their place"
    assert (words in state.text) == (level == Health.WARN)


def test_the_share_of_little_support_that_is_told_is_the_navigators():
    book, now_s = (
        SensorBook("pmd", "depth", now_s=0.0, limits=NavigatorTuning(max_contradicted_share=0.6)),
        0.0,
    )
    told = []
    for every in (4, 2):
        for number in range(40):
            now_s += 1.0 / 15.0
            book.note_arrival(now_s)
            book.use(now_s, "66% of the edges" if number % every == 0 else "")
        told.append(book.state(now_s).text)
    assert told[0] == ""
    assert "a track ends if more than 60% of the frames are such, and none begins above 30%" in told[1]


@pytest.mark.parametrize(
    ("cause", "paused", "state", "dropped"),
    [
        (Cause.OTHER, False, Health.ERROR, 0),
        (Cause.SLOW_SEARCH, False, Health.WARN, 0),
        (Cause.OTHER, True, Health.ERROR, 30),
    ],
)
def test_a_search_that_takes_long_is_no_error_and_a_frame_that_is_not_searched_is_counted(
    cause, paused, state, dropped
):
    counted = HealthBook("estimator")
    health = InputHealth(counted, {"pmd": "depth"}, now_s=0.0)
    for number in range(30):
        now_s = number / 10.0
        status = EstimatorStatus(stamp_ns=number, frame_id="chaser", mode=Mode.ACQUIRING, reason="in words")
        health.books["pmd"].note_arrival(now_s)
        arrived = Arrived("pmd", number, now_s, None)
        health.judge(arrived, Output(status, None, cause=cause, paused=paused), now_s)
    assert health.books["pmd"].state(2.9).level == state
    assert counted.counters().get("dropped/pmd", 0) == dropped


LEFT_OUT = {AMPLITUDE_LEFT_OUT: 1.0}, "its amplitude is not used"
NOISY = {NOISE_M: 0.08, STATED_NOISE_M: 0.02}, "its ranges have a noise of 0.08 m, not of 0.02 m as stated"


@pytest.mark.parametrize(("every", "level"), [(1, Health.WARN), (3, Health.OK)])
@pytest.mark.parametrize(("told", "words"), [LEFT_OUT, NOISY])
def test_what_most_frames_tell_is_told_although_they_are_used(told, words, every, level):
    health, now_s = InputHealth(HealthBook("estimator"), {"pmd": "depth"}, now_s=0.0), 0.0
    for number in range(30):
        now_s += 1.0 / 8.0
        health.books["pmd"].note_arrival(now_s)
        evidence = told if number % every == 0 else {}
        status = EstimatorStatus(
            stamp_ns=number, frame_id="chaser", mode=Mode.TRACKING, accepted=True, evidence=evidence
        )
        health.judge(Arrived("pmd", number, now_s, None), Output(status, None), now_s)
    state = health.books["pmd"].state(now_s)
    assert state.level == level
    assert (words in state.text) == (level == Health.WARN)


@pytest.mark.parametrize(("shift_ns", "level"), [(0, Health.OK), (5_000_000, Health.WARN)])
def test_an_amplitude_that_belongs_to_no_frame_is_told_although_depth_is_used(shift_ns, level):
    assembler = Assembler(
        frozenset({"depth"}), frozenset({"amplitude"}), leading="depth", within_ns=1_000_000
    )
    health = InputHealth(HealthBook("estimator"), {"pmd": "depth"}, now_s=0.0)
    book = health.books["pmd"]
    for number in range(60):
        now_s, stamp_ns = number / 15.0, 10**9 + number * 66_666_667
        book.note_arrival(now_s)
        complete = assembler.add("depth", stamp_ns, 1)
        for _ in (*complete, *assembler.add("amplitude", stamp_ns + shift_ns, 1)):
            book.use(now_s)
        for given_up in assembler.take_given_up():
            health.give_up("pmd", given_up, now_s)
    assert book.used > 50
    assert book.state(now_s).level == level
    words = "amplitude is not used without depth: the nearest one is stamped 5.000 ms earlier"
    assert (words in book.state(now_s).text) == (level == Health.WARN)


@pytest.mark.parametrize("kind", [OUT_OF_RANGE, JOINING])
def test_a_sensor_that_waits_is_in_order_and_only_its_clock_is_judged(kind):
    book, now_s = book_after([Loss(kind, FAR.text)] * 30)
    book.note("defect", "22 pixels have a negative depth")
    assert book.state(now_s) == (Health.OK, f"pmd: {FAR.text}; its frames are not used meanwhile")
    book.note("clock", "its stamps are ahead")
    assert book.state(now_s).level == Health.WARN
    assert book.state(now_s).text.endswith("meanwhile; its stamps are ahead")


def test_a_sensor_that_others_do_not_confirm_in_ten_seconds_is_told():
    joins = Loss(JOINING, "offered: the sensor joins the track when the next frames of lidar agree")
    book, now_s = book_after([joins] * 80)
    assert book.state(now_s).level == Health.OK
    book, now_s = book_after([None] * 8 + [joins] * 90)
    assert book.state(now_s).level == Health.ERROR
    assert "17 of 17: offered: the sensor joins" in book.state(now_s).text
    assert "rpod driver check pmd" in book.state(now_s).text


def test_frames_out_of_range_do_not_count_where_others_are_judged():
    book, now_s = book_after([LATE, FAR, None, LATE] * 8)
    assert book.state(now_s).text.startswith("pmd: only 4 of 13 frames used in 2.0 s; 9 of 13: late")
    book, now_s = book_after([LATE, FAR, None, None] * 8)
    assert book.state(now_s) == (Health.OK, "")


def test_a_sensor_that_comes_into_range_is_logged_once_each_way(caplog):
    caplog.set_level(logging.INFO)
    health = InputHealth(HealthBook("estimator"), {"pmd": "depth"}, now_s=0.0)
    for number in range(80):
        now_s, near = 0.1 * number, number >= 50
        health.books["pmd"].note_arrival(now_s)
        status = EstimatorStatus(
            stamp_ns=number,
            frame_id="chaser",
            mode=Mode.TRACKING,
            accepted=near,
            reason="" if near else FAR.text,
        )
        cause = Cause.OTHER if near else Cause.OUT_OF_RANGE
        health.judge(Arrived("pmd", number, now_s, None), Output(status, None, cause=cause), now_s)
        health.report(Mode.TRACKING, now_s)
    assert [(each.levelname, each.message) for each in caplog.records] == [
        ("INFO", f"pmd: {FAR.text}; its frames are not used meanwhile"),
        ("INFO", "pmd: in order again"),
    ]
    assert health.books["pmd"].lost == {OUT_OF_RANGE: 50}


def test_of_a_slow_sensor_the_last_three_frames_are_judged():
    assert book_after([LATE] * 2, rate_hz=0.3)[0].state(10.0).level == Health.OK
    book, now_s = book_after([LATE] * 5, rate_hz=0.3)
    assert book.state(now_s).level == Health.ERROR


def test_frames_before_a_silence_do_not_count():
    book, now_s = book_after([LATE] * 30)
    assert book.state(now_s + 3.0).text == "pmd: no frame for 3 s; look at its driver, and at the link to it"
    book.note_arrival(now_s + 3.0)
    book.use(now_s + 3.0)
    assert book.state(now_s + 3.1).level == Health.OK


def test_a_state_that_is_not_ok_is_logged_at_once_and_each_minute_and_so_is_its_end(caplog):
    caplog.set_level(logging.INFO)
    health = InputHealth(HealthBook("estimator"), {"pmd": "depth"}, now_s=0.0)
    book = health.books["pmd"]
    for second in range(1, 140):
        book.note_arrival(second)
        if second < 130:
            book.lose(Loss("late", f"late: {second}.000 s old"), second)
        else:
            book.use(second)
        health.report(Mode.LOST, second)
    lines = [record.getMessage() for record in caplog.records]
    assert [line.partition(" used")[0] for line in lines] == [
        *["pmd: no frame"] * 3, "pmd: only 1 of 3 frames", "pmd: in order again"
    ]  # fmt: skip


def test_a_sensor_that_never_sends_is_told():
    book = SensorBook("pmd", "depth", now_s=0.0)
    assert book.state(1.0).level == Health.OK
    state = book.state(5.0)
    assert state == (Health.WARN, "pmd: no frame yet in 5 s; is its driver running?")
    book.note_others(4.0)
    assert "no depth for 5 s, only other parts" in book.state(5.0).text


@pytest.mark.parametrize(
    ("ahead_s", "stamp_ns", "words"),
    [
        (37.0, 10**18, "is it TAI?"),
        (-5.0, 10**18, "source.clock_offset_s"),
        (7200.01, 10**18, "is it local time?"),
        (-1.7e9, 10**9, "count from the start of the device"),
        (-1.7e9, 0, "let the driver set header.stamp"),
        (-1.7e9 + 1.7e3, 1_700_000_000_123, "are they milliseconds in place of nanoseconds?"),
    ],
)
def test_a_clock_that_is_off_gets_a_hint(ahead_s, stamp_ns, words):
    assert words in clock_hint(ahead_s, stamp_ns)


@pytest.mark.parametrize(
    ("step_ns", "words"),
    [
        (None, "depth without camera_info, which does not come at all: let the driver publish it"),
        (
            US,
            "camera_info: the nearest one is stamped 0.001 ms later; give all parts of a frame",
        ),
        (-US, "0.001 ms earlier"),
    ],
)
def test_a_frame_without_a_part_says_which_one_and_how_far_off_it_is(step_ns, words):
    assembler = Assembler[int](frozenset({"depth", "camera_info"}))
    for number in range(20):
        stamp_ns = number * 10**8
        assembler.add("depth", stamp_ns, number)
        if step_ns is not None:
            assembler.add("camera_info", stamp_ns + step_ns, number)
    losses = [unpaired(frame, "depth") for frame in assembler.take_given_up() if "depth" in frame.parts]
    assert len(losses) >= 12
    assert {loss.kind for loss in losses} == {"unpaired"}
    assert all(words in loss.text for loss in losses)
    assert assembler.take_given_up() == []


def test_a_doubt_about_used_frames_is_told():
    book, now_s = book_after([None] * 30)
    book.note("defect", "all pixels of its amplitude are 128; correct its driver")
    assert book.state(now_s) == (Health.WARN, "pmd: all pixels of its amplitude are 128; correct its driver")


def test_in_lockstep_a_sensor_is_silent_by_the_time_of_the_bus(caplog):
    books = InputHealth(
        HealthBook("estimator"), {"pmd": "depth", "lidar": "points"}, now_s=0.0, silence_s=LOCKSTEP_SILENCE_S
    )
    for step in range(60):  # 6 s of the bus's time in 12 s of the machine's; the camera ends after 3 s
        now_s, bus_s = 0.2 * step, 1000.0 + 0.1 * step
        if bus_s < 1003.0:
            books.books["pmd"].note_arrival(now_s, bus_s)
        if step % 10 == 0:
            books.books["lidar"].note_arrival(now_s, bus_s)  # once a second
        books.report(Mode.ACQUIRING, now_s, bus_s)
    told = [record.getMessage() for record in caplog.records]
    assert told == ["pmd: no frame for 2 s of bus time; look at its driver, and at the link to it"]


def test_in_lockstep_a_sensor_that_never_sends_is_told_by_the_time_of_the_bus():
    book = SensorBook("pmd", "depth", now_s=0.0, silence_s=LOCKSTEP_SILENCE_S)
    assert book.state(0.1, None).level == Health.OK
    assert book.state(0.2, 1000.0).level == Health.OK
    assert book.state(0.5, 1001.9).level == Health.OK
    state = book.state(1.0, 1002.5)
    assert state == (Health.WARN, "pmd: no frame yet in 2 s of bus time; is its driver running?")


def test_the_time_that_a_frame_takes_itself_is_no_silence():
    book = SensorBook("lidar", "points", now_s=0.0, silence_s=LOCKSTEP_SILENCE_S)
    book.note_arrival(1.0)
    book.use(70.0)
    assert book.state(70.5) == (Health.OK, "")
    assert book.state(70.5 + LOCKSTEP_SILENCE_S).text.startswith("lidar: no frame for 60 s")


def test_in_lockstep_a_sensor_is_silent_after_a_minute_of_the_wall_clock(caplog):
    health = HealthBook("estimator")
    books = InputHealth(health, {"pmd": "depth"}, now_s=0.0, silence_s=LOCKSTEP_SILENCE_S)
    books.report(Mode.ACQUIRING, 59.0)
    assert not caplog.records
    books.report(Mode.ACQUIRING, 61.0)
    assert "pmd: no frame yet in 61 s" in caplog.text
