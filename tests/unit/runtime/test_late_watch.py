"""Whether late frames were held on their way, or their clock is behind."""

import pytest

from rpod_runtime.sensor_data.late_watch import LateWatch

START_NS = 1_000_000_000_000
PERIOD_S = 0.1


def ns(seconds):
    return START_NS + round(seconds * 1e9)


def play(frames, *, host_set_s=0.0, successor_from=1000):
    """Return why the last of frames is late; each has its stamp, sending and arrival, s."""
    watch = LateWatch(1.0)
    for number, (stamp_s, sent_s, arrival_s) in enumerate(frames):
        moved_s = host_set_s if number == len(frames) - 1 else 0.0
        sent_ns = 0 if sent_s is None else ns(sent_s)
        watch.add(
            ns(stamp_s), ns(arrival_s + moved_s), arrival_s=arrival_s, sent_ns=sent_ns,
            source="b" if number >= successor_from else "a",
        )  # fmt: skip
    return watch.why()


def in_time(count=20, sent=True):
    stamps_s = [number * PERIOD_S for number in range(count)]
    return [(stamp_s, stamp_s + 0.02 if sent else None, stamp_s + 0.03) for stamp_s in stamps_s]


@pytest.mark.parametrize("of_burst", [1, 5, 15])
@pytest.mark.parametrize(
    ("sent_after_s", "words"),
    [
        (0.02, "s on the link, its clock has not changed since frames came in time; look at the link"),
        (
            3.0,
            "most of it before it was sent, its clock has not changed since frames came in time; look at ",
        ),
        (None, "s on the link or in the driver, its clock has not changed"),
    ],
)
def test_a_burst_after_a_pause_was_held(of_burst, sent_after_s, words):
    burst = []
    for number in range(of_burst):
        stamp_s = (20 + number) * PERIOD_S
        sent_s = None if sent_after_s is None else min(stamp_s + sent_after_s, 4.9 + 1e-3 * number)
        burst.append((stamp_s, sent_s, 5.0 + 1e-3 * number))
    told = play(in_time(sent=sent_after_s is not None) + burst)
    held_s = burst[-1][2] - burst[-1][0] - 0.03
    assert told.startswith(f"it was delayed by {held_s:.3f} s")
    assert words in told


def test_a_link_that_grows_slower_and_slower_is_named():
    slow = [(2.0 + n * PERIOD_S, 2.02 + n * PERIOD_S, 2.03 + n * 3 * PERIOD_S) for n in range(10)]
    assert "on the link" in play(in_time() + slow)


@pytest.mark.parametrize("late_s", [1.5, 3.0])
def test_a_clock_that_is_behind_from_the_start_is_not_taken_for_the_link(late_s):
    assert play([(stamp_s - late_s, sent_s, arrival_s) for stamp_s, sent_s, arrival_s in in_time()]) == ""


def test_a_clock_that_is_set_back_is_not_taken_for_the_link():
    frames = in_time(40)
    set_back = [(stamp_s - 3.0, sent_s, arrival_s) for stamp_s, sent_s, arrival_s in frames[20:]]
    for count in (1, 2, 20):
        assert play(frames[:20] + set_back[:count]) == ""


def test_this_machines_clock_that_is_set_ahead_is_not_taken_for_the_link():
    assert play(in_time(), host_set_s=3.0) == ""


def test_another_publisher_has_a_clock_of_its_own():
    late = [(stamp_s - 3.0, sent_s, arrival_s) for stamp_s, sent_s, arrival_s in in_time(40)[39:]]
    assert play(in_time() + late, successor_from=20) == ""


def test_ages_that_vary_are_a_delay_and_perhaps_a_clock():
    burst = [(number * PERIOD_S, None, 5.0 + 1e-3 * number) for number in range(20)]
    told = play(burst)
    assert told.startswith("the age of its frames varies by 1.881 s")
    assert told.endswith("then check the sensor's clock")


@pytest.mark.parametrize("before", [0, 20])
def test_a_clock_that_loses_time_with_each_frame_is_not_taken_for_the_link(before):
    losing = [
        (stamp_s - 0.02 * n, sent_s, arrival_s) for n, (stamp_s, sent_s, arrival_s) in enumerate(in_time(60))
    ]
    shift_s = before * PERIOD_S
    later = [
        (stamp_s + shift_s, sent_s + shift_s, arrival_s + shift_s) for stamp_s, sent_s, arrival_s in losing
    ]
    assert play(in_time(before) + later) == ""


def test_a_clock_that_is_behind_on_a_link_that_varies_is_told_before_the_link():
    late = [(stamp_s - 0.9, sent_s, arrival_s) for stamp_s, sent_s, arrival_s in in_time(21)]
    late[-1] = (late[-1][0], late[-1][1], late[-1][2] + 0.2)
    told = play(late)
    assert told.startswith("the youngest of its frames were 0.930 s old: check the sensor's clock")
    assert "another 0.200 s came on the way: look at the link" in told
