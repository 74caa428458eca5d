"""A clock that was set is seen in the first frame, and what a network does to frames is none."""

import numpy as np
import pytest

from rpod_runtime.sensor_data.step_watch import StepWatch
from rpod_schemas.messages import NANOSECONDS

EPOCH_NS = 1_700_000_000 * NANOSECONDS
FRAMES = 400
SIGMA_S, WITHIN_S = 0.002, 0.1
RATES_HZ = (1.0, 8.0, 45.0, 90.0)


def watch():
    return StepWatch(SIGMA_S, WITHIN_S)


def add(one, stamp_s, arrival_s, *, source="driver", host_s=0.0):
    """Let a frame arrive; return whether it is refused."""
    return one.add(
        EPOCH_NS + round(stamp_s * NANOSECONDS),
        EPOCH_NS + round((arrival_s + host_s) * NANOSECONDS),
        arrival_s=100.0 + arrival_s,
        source=source,
    )


def in_order(arrivals_s):
    """A topic delivers its messages one after the other."""
    return np.maximum.accumulate(arrivals_s)


def jitter(rng, stamps_s):
    return stamps_s + 0.004 + rng.exponential(0.002, len(stamps_s))


def loaded(rng, stamps_s):
    """Each twentieth frame waits for up to a third of a second."""
    waits_s = np.where(rng.random(len(stamps_s)) < 0.05, rng.uniform(0.0, 0.3, len(stamps_s)), 0.0)
    return jitter(rng, stamps_s) + waits_s


def stalls(rng, stamps_s):
    """The link stands still for 3 s, three times, and lets all waiting frames through at once."""
    arrivals_s = jitter(rng, stamps_s)
    for begin_s in rng.uniform(0.2, 0.9, 3) * stamps_s[-1]:
        held = (arrivals_s > begin_s) & (arrivals_s < begin_s + 3.0)
        arrivals_s[held] = begin_s + 3.0 + rng.uniform(0.0, 0.001, held.sum())
    return arrivals_s


def load_comes(rng, stamps_s):
    """From one frame on, all take 60 ms longer."""
    return jitter(rng, stamps_s) + np.where(np.arange(len(stamps_s)) > len(stamps_s) // 2, 0.06, 0.0)


def even(_, period_s):
    return np.arange(FRAMES) * period_s


def losing(rng, period_s):
    return even(rng, period_s)[rng.random(FRAMES) > 0.2]


def changing(_, period_s):
    """The rate is halved for a while."""
    return np.cumsum(np.r_[np.full(200, period_s), np.full(100, 2.0 * period_s), np.full(100, period_s)])


def triggered(rng, period_s):
    """By hand, or by an event."""
    return np.cumsum(rng.exponential(period_s, FRAMES))


def looping(rng, period_s):
    """A driver that waits for a period in a loop, and is sometimes late."""
    return np.cumsum(period_s + rng.exponential(0.05 * period_s, FRAMES))


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("network", [jitter, loaded, stalls, load_comes], ids=lambda each: each.__name__)
@pytest.mark.parametrize(
    "stamps", [even, losing, changing, triggered, looping], ids=lambda each: each.__name__
)
def test_no_frame_of_a_right_clock_is_refused(stamps, network, rate_hz):
    for seed in range(2):
        rng, one = np.random.default_rng(seed), watch()
        stamps_s = stamps(rng, 1.0 / rate_hz)
        arrivals_s = in_order(network(rng, stamps_s))
        refused = [step for pair in zip(stamps_s, arrivals_s, strict=True) if (step := add(one, *pair))]
        assert not refused, f"seed {seed}: {len(refused)}, {refused[0].text}"


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 45.0])
@pytest.mark.parametrize("network", [loaded, load_comes], ids=lambda each: each.__name__)
def test_no_frame_of_a_driver_that_exposes_late_under_load_is_refused(network, rate_hz):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        late_s = np.where(rng.random(FRAMES) < 0.2, rng.exponential(0.03, FRAMES), 0.0)
        stamps_s = np.maximum.accumulate(even(rng, 1.0 / rate_hz) + late_s) + 1e-6 * np.arange(FRAMES)
        assert not verdicts(stamps_s, in_order(network(rng, stamps_s))).any()


def verdicts(stamps_s, arrivals_s):
    one = watch()
    return np.array([add(one, *pair) is not None for pair in zip(stamps_s, arrivals_s, strict=True)])


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("moved_s", [-0.9, -0.41, 0.047])
def test_a_clock_that_is_set_is_refused_from_the_first_frame_on_until_it_is_right_again(moved_s, rate_hz):
    for seed in range(2):
        rng, is_set = np.random.default_rng(seed), (np.arange(FRAMES) >= 100) & (np.arange(FRAMES) < 200)
        times_s = even(rng, 1.0 / rate_hz)
        arrivals_s = in_order(jitter(rng, times_s))
        np.testing.assert_array_equal(verdicts(times_s + moved_s * is_set, arrivals_s), is_set)


@pytest.mark.parametrize("rate_hz", [1.0, 8.0])
def test_a_clock_that_is_set_back_is_seen_on_a_loaded_machine_in_the_first_frame_that_does_not_wait(rate_hz):
    for seed in range(2):
        rng, is_set = np.random.default_rng(seed), np.arange(FRAMES) >= 100
        times_s = even(rng, 1.0 / rate_hz)
        arrivals_s = in_order(loaded(rng, times_s))
        refused = verdicts(times_s - 0.41 * is_set, arrivals_s)
        assert not refused[:100].any()
        assert refused[101:].all(), "one frame may be taken for a delayed one"


@pytest.mark.parametrize("rate_hz", [8.0, 45.0])
def test_a_clock_that_loses_time_with_each_frame_is_refused_as_soon_as_its_jitter_shows_it(rate_hz):
    rng, lost_s = np.random.default_rng(1), 0.02 * np.clip(np.arange(FRAMES) - 99, 0, 40)
    times_s = even(rng, 1.0 / rate_hz)
    arrivals_s = in_order(jitter(rng, times_s))
    refused = verdicts(times_s - lost_s, arrivals_s)
    assert not refused[:100].any()
    assert refused[101:].all()


@pytest.mark.parametrize("jitter_s", [0.003, 0.006])
def test_a_clock_that_loses_less_with_each_frame_than_its_jitter_is_refused_within_a_second_or_two(jitter_s):
    for seed in range(10):
        rng, numbers = np.random.default_rng(seed), np.arange(200)
        times_s = 0.1 * numbers + rng.exponential(jitter_s, numbers.size)
        arrivals_s = in_order(jitter(rng, times_s))
        refused = verdicts(times_s - 0.02 * np.clip(numbers - 99, 0, 50), arrivals_s)
        assert not refused[:100].any()
        assert refused[120:150].all()


def test_a_clock_that_loses_time_from_a_pause_on_is_refused_within_some_frames():
    rng, numbers = np.random.default_rng(1), np.arange(200)
    times_s = 0.1 * numbers + 0.137 * (numbers >= 100)
    arrivals_s = in_order(jitter(rng, times_s))
    refused = verdicts(times_s - 0.02 * np.clip(numbers - 99, 0, 40), arrivals_s)
    assert not refused[:100].any()
    assert refused[105:].all()


@pytest.mark.parametrize(("moved_s", "held"), [(0.3, 9), (-0.05, 9), (-0.4, 100)])
def test_a_clock_that_was_corrected_is_used_again_once_it_is_steady(moved_s, held):
    """A clock that was behind, one that was set by less than an exposure may change, and one that was not."""
    rng, is_set = np.random.default_rng(2), np.arange(200) >= 100
    times_s = np.arange(200) * 0.125
    arrivals_s = in_order(jitter(rng, times_s)) + 0.35
    assert verdicts(times_s + moved_s * is_set, arrivals_s).sum() == held


def test_a_jump_of_this_machines_own_clock_is_none_of_the_sensors():
    one = watch()
    for number in range(100):
        host_s = -0.4 if number > 50 else 0.0
        assert add(one, 0.1 * number, 0.1 * number + 0.01, host_s=host_s) is None


def test_a_successor_has_a_clock_of_its_own():
    one = watch()
    for number in range(100):
        stamp_s = 0.1 * number - (0.4 if number > 50 else 0.0)
        assert add(one, stamp_s, 0.1 * number + 0.01, source="second" if number > 50 else "first") is None


def test_a_reset_accepts_the_clock_as_it_is_and_the_text_has_figures_and_remedy():
    one = watch()
    for number in range(60):
        step = add(one, 0.1 * number - (0.4 if number >= 50 else 0.0), 0.1 * number + 0.01)
        assert (step is not None) == (number >= 50)
    assert step.text.startswith(
        "its stamps have moved by -0.400 s against their arrival, while the jitter of"
    )
    assert "explains 0.008 s" in step.text
    assert "synchronise it by PTP or chrony" in step.text
    one.forget()
    assert add(one, 6.0 - 0.4, 6.01) is None


def test_a_frame_that_is_sent_again_tells_nothing_of_the_clock():
    one = watch()
    for n in range(40):
        assert not add(one, 0.1 * n, 0.1 * n + 0.005)
        assert not add(one, 0.1 * n, 0.1 * n + 0.055)
    assert add(one, 4.0 - 0.43, 4.005)


def test_frames_out_of_order_are_no_clock_that_was_set():
    """Each tenth frame is overtaken by the next one."""
    one, numbers = watch(), np.arange(200)
    late_s = np.where((numbers % 10 == 0) & (numbers >= 40), 0.105, 0.0)
    arrivals_s = 0.1 * numbers + 0.01 + late_s
    for number in np.argsort(arrivals_s):
        assert add(one, 0.1 * number, arrivals_s[number]) is None
    assert one.overtaken == 16


def test_a_clock_that_is_set_back_into_a_gap_is_seen_with_the_second_frame():
    one = watch()
    numbers = [number for number in range(60) if number != 50]
    assert all(add(one, 0.1 * number, 0.1 * number + 0.01) is None for number in numbers)
    told = [add(one, 0.1 * number - 1.0, 0.1 * number + 0.01) for number in range(60, 65)]
    assert told[0] is None
    assert all(each is not None for each in told[1:])
