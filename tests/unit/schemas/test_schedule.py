from itertools import islice, pairwise

import pytest
from due_frames import due_frames
from hypothesis import given
from hypothesis import strategies as st

from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.schedule import frame_at, last_number, lockstep_steps

EPOCH_NS = 1_767_225_600_000_000_000
SECOND_NS = 1_000_000_000
RATES_HZ = st.one_of(st.floats(0.1, 15.0), st.sampled_from([1.0, 3.0, 7.0, 10.0, 12.5, 15.0]))
NUMBERS = st.integers(-1000, 10**6)


def pmd(rate_hz: float, name: str = "pmd") -> PmdConfig:
    return PmdConfig(name=name, rate_hz=rate_hz)


@given(RATES_HZ, NUMBERS)
def test_the_number_of_a_frame_is_its_time_from_the_epoch_times_the_rate(rate_hz, number):
    frame = frame_at(pmd(rate_hz), number, epoch_ns=EPOCH_NS)
    assert round((frame.stamp_ns - EPOCH_NS) * rate_hz / SECOND_NS) == frame.number == number


@given(RATES_HZ, NUMBERS, st.integers(0, 10**10))
def test_the_last_frame_up_to_a_time_is_not_beyond_it_and_the_next_one_is(rate_hz, number, after_ns):
    sensor = pmd(rate_hz)
    until_ns = frame_at(sensor, number, epoch_ns=EPOCH_NS).stamp_ns + after_ns
    last = last_number(sensor, until_ns, epoch_ns=EPOCH_NS)
    assert frame_at(sensor, last, epoch_ns=EPOCH_NS).stamp_ns <= until_ns
    assert frame_at(sensor, last + 1, epoch_ns=EPOCH_NS).stamp_ns > until_ns


@given(RATES_HZ, NUMBERS)
def test_a_frame_is_the_last_one_up_to_its_own_stamp(rate_hz, number):
    sensor = pmd(rate_hz)
    stamp_ns = frame_at(sensor, number, epoch_ns=EPOCH_NS).stamp_ns
    assert last_number(sensor, stamp_ns, epoch_ns=EPOCH_NS) == number
    assert last_number(sensor, stamp_ns - 1, epoch_ns=EPOCH_NS) == number - 1


def test_the_first_frame_comes_after_the_epoch_and_the_last_at_the_end():
    frames = [step.frame for step in lockstep_steps([pmd(15.0)], epoch_ns=EPOCH_NS, duration_s=20.0)]
    assert [frame.number for frame in frames] == list(range(1, 301))
    assert frames[-1].stamp_ns == EPOCH_NS + 20 * SECOND_NS


@pytest.mark.parametrize("duration_s", [0.05, 1e-9])
def test_a_scenario_shorter_than_a_period_has_no_frame(duration_s):
    assert list(lockstep_steps([pmd(15.0)], epoch_ns=EPOCH_NS, duration_s=duration_s)) == []


@pytest.mark.parametrize("sensor", [PmdConfig(), LidarConfig()])
def test_a_frame_is_handed_out_after_exposure_or_scan_and_readout(sensor):
    frame = frame_at(sensor, 5, epoch_ns=EPOCH_NS)
    assert frame.available_ns - frame.stamp_ns == round(sensor.latency_s * SECOND_NS)
    assert sensor.latency_s > max(sensor.pose_times_s())


LIDARS = st.builds(
    lambda rate_hz, readout_s: LidarConfig(rate_hz=rate_hz, readout_s=readout_s),
    st.sampled_from([0.2, 0.5, 1.0, 2.0, 5.0]),
    st.sampled_from([0.0, 0.001, 0.3]),
)


@given(RATES_HZ, LIDARS, st.floats(0.1, 12.0))
def test_the_steps_of_lockstep_rise_and_hand_out_each_frame_that_is_due_once(rate_hz, lidar, duration_s):
    sensors = (pmd(rate_hz), pmd(rate_hz, "a_side"), lidar)
    steps = list(lockstep_steps(sensors, epoch_ns=EPOCH_NS, duration_s=duration_s))
    assert all(before.time_ns < after.time_ns for before, after in pairwise(steps))
    assert all(step.frame.available_ns <= step.time_ns < step.frame.available_ns + 3 for step in steps)
    due = list(due_frames(sensors, epoch_ns=EPOCH_NS, duration_s=duration_s))
    assert sorted(step.frame for step in steps) == due


@given(RATES_HZ, LIDARS, st.floats(0.1, 12.0))
def test_the_steps_are_the_same_whether_or_not_the_end_is_known(rate_hz, lidar, duration_s):
    sensors = (lidar, pmd(rate_hz), pmd(rate_hz, "z_side"))
    steps = list(lockstep_steps(sensors, epoch_ns=EPOCH_NS, duration_s=duration_s))
    endless = set(islice(lockstep_steps(sensors, epoch_ns=EPOCH_NS), 3 * len(steps) + 100))
    assert set(steps) <= endless
