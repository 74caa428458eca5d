"""Lockstep on a real bus, with one sensor and with two: it ends, and each run is the other's equal.

Motion, emulator and estimator are the real ones, in threads; the test listens in the logger's place. Runs of
one seed are compared by threes, in processes of which each is busy beside the others.
"""

from collections.abc import Iterable

import pytest
from due_frames import due_frames
from lockstep_bench import (
    DURATION_S,
    EPOCH_NS,
    GUESS,
    LIDAR,
    PMD,
    SCAN,
    SENSORS,
    Bench,
    Played,
    Runs,
    answered,
    play_all,
    player,
    statuses_of,
)

from rpod_runtime import Received
from rpod_schemas.config.emulator import SensorConfig
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.rmw.cdr import peek_stamp
from rpod_schemas.schedule import lockstep_steps
from rpod_schemas.topics import DEPTH, ESTIMATE, POINTS, TRUTH, Topic

SLOW = LidarConfig(pattern=SCAN, rate_hz=2.0, readout_s=0.3)
"""Hands a scan out when several younger images are processed."""
AT_ONCE = PMD.model_copy(update={"name": "a_side"})
"""A second camera, whose every frame is due at the very time of the first one's."""
UNEVEN = LidarConfig(pattern=SCAN, rate_hz=1.7)
"""No frame at the stamp of another sensor's."""


@pytest.fixture
def bench(bus) -> Bench:
    return Bench(bus)


def steps(*sensors: SensorConfig, duration_s: float) -> list[tuple[int, str]]:
    """Return stamp and sensor of the frames that are due, in the order in which they are handed out."""
    due = lockstep_steps(sensors, epoch_ns=EPOCH_NS, duration_s=duration_s)
    return [(step.frame.stamp_ns, step.frame.sensor) for step in due]


def frames_of(messages: Iterable[Received], sensor: SensorConfig) -> list[int]:
    """Return the stamps of a sensor's frames."""
    topic = (DEPTH if isinstance(sensor, PmdConfig) else POINTS).of(sensor.name).name
    return sorted(peek_stamp(each.payload) for each in messages if each.topic.name == topic)


def payloads(messages: dict[str, list[str]], topic: Topic) -> list[str]:
    """Return the digests of a topic's messages."""
    return [digest for name, of in messages.items() if name.split("#")[0] == topic.name for digest in of]


@pytest.fixture(scope="module")
def runs() -> list[Runs]:
    """The same runs in three processes with three hash seeds, of which one gets less of the processors."""
    with player(hash_seed=1) as other, player(hash_seed=2, niceness=5) as least:
        return [play_all(), other(), least()]


def test_three_processes_have_three_hash_seeds(runs):
    assert len({run.hash_of_a_text for run in runs}) == 3


@pytest.mark.parametrize("name", SENSORS)
def test_three_runs_of_one_seed_come_out_the_same_to_the_last_message(runs, name):
    first, *others = (run.played[name] for run in runs)
    assert first.accepted > 0
    for run in (first, *others):
        assert run.answered == steps(*SENSORS[name], duration_s=DURATION_S)
    for other in others:
        assert {key: len(messages) for key, messages in other.messages.items()} == {
            key: len(messages) for key, messages in first.messages.items()
        }
        assert [key for key in first.messages if first.messages[key] != other.messages[key]] == []


def test_another_seed_gives_other_frames_of_the_same_truth(bench, runs):
    first = runs[0].played["both"].messages
    sensors = SENSORS["both"]
    other = Played.of(bench.play(*sensors, heard=sensors, duration_s=DURATION_S, seed=6)).messages
    for topic in (POINTS.of("lidar"), DEPTH.of("pmd"), ESTIMATE):
        five, six = (set(payloads(run, topic)) for run in (first, other))
        assert five
        assert six
        assert not five & six, topic
    five, six = (payloads(run, TRUTH) for run in (first, other))
    assert five == six != []


@pytest.mark.parametrize(
    "sensors",
    [(PMD, SLOW), (PMD, UNEVEN), (PMD, AT_ONCE, LIDAR)],
    ids=["handed out late", "uneven rates", "three at once"],
)
def test_every_frame_of_several_sensors_is_made_once_and_answered_in_its_turn(bench, sensors):
    run = bench.play(*sensors, heard=sensors, duration_s=1.2, initial_pose=GUESS)
    assert answered(run) == steps(*sensors, duration_s=1.2)
    due = list(due_frames(sensors, epoch_ns=EPOCH_NS, duration_s=1.2))
    for sensor in sensors:
        assert frames_of(run, sensor) == [frame.stamp_ns for frame in due if frame.sensor == sensor.name]


def test_a_sensor_whose_frames_are_all_refused_holds_nobody_up(bench):
    run = bench.play(
        PMD, SLOW, heard=(PMD, SLOW), duration_s=1.2, filter=FilterConfig(max_delay_s=0.2), initial_pose=GUESS
    )
    assert answered(run) == steps(PMD, SLOW, duration_s=1.2)
    refused = [status.reason for status in statuses_of(run) if status.sensor == SLOW.name]
    assert len(refused) == 2
    assert all(reason.startswith("late") for reason in refused)


def test_a_sensor_that_the_estimator_does_not_use_holds_nobody_up(bench):
    run = bench.play(PMD, LIDAR, heard=(PMD,), duration_s=1.0, initial_pose=GUESS)
    assert answered(run) == steps(PMD, duration_s=1.0)
    assert len(frames_of(run, LIDAR)) == 2
