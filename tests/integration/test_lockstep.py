"""Lockstep on a real bus, with one sensor and with two: it ends, and each run is the other's equal.

Motion, emulator and estimator are the real ones, in threads; the test listens in the logger's place.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from threading import Event
from uuid import uuid4

import pytest
from due_frames import due_frames
from live_bus import TIMEOUT_S, daemon

from rpod_emulator.daemon import run as run_emulator
from rpod_estimator.daemon import run as run_estimator
from rpod_logger.selection import patterns
from rpod_motion.daemon import run as run_motion
from rpod_runtime import Inbox, QueryFailedError, Received
from rpod_schemas.config.emulator import (
    EmulatorConfig,
    LockstepConfig,
    MotionServiceConfig,
    SensorConfig,
)
from rpod_schemas.config.estimator import EstimatorConfig, LidarInput, PmdInput
from rpod_schemas.config.lidar import LidarConfig, ScanPatternConfig
from rpod_schemas.config.motion import FACING, MotionConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.control import Accepted, StartRequest, StatusReply
from rpod_schemas.messages import NANOSECONDS, read_status
from rpod_schemas.poses import make_pose
from rpod_schemas.rmw.cdr import encode, peek_stamp
from rpod_schemas.schedule import lockstep_steps
from rpod_schemas.topics import (
    DEPTH,
    DIAGNOSTICS,
    ESTIMATE,
    PARAMETER_EVENTS,
    POINTS,
    ROSOUT,
    STATUS,
    TRUTH,
    Topic,
)
from rpod_schemas.types import Camera, EstimatorStatus

EPOCH_NS = 1_767_225_600 * NANOSECONDS
_COMPILED_S = 200.0
"""Longest time of a step: kernels that are not compiled yet are compiled in it."""
CAMERA = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
PMD = PmdConfig(rate_hz=15.0, camera=CAMERA, T_chaser_sensor=make_pose(translation_m=[0.0, -0.05, 0.0]))
SCAN = ScanPatternConfig(azimuth_span_deg=30.0, elevation_span_deg=30.0, step_deg=1.0)
LIDAR = LidarConfig(pattern=SCAN, rate_hz=2.0)
SLOW = LidarConfig(pattern=SCAN, rate_hz=2.0, readout_s=0.3)
"""Hands a scan out when several younger images are processed."""
AT_ONCE = PMD.model_copy(update={"name": "a_side"})
"""A second camera, whose every frame is due at the very time of the first one's."""
UNEVEN = LidarConfig(pattern=SCAN, rate_hz=1.7)
"""No frame at the stamp of another sensor's."""
GUESS = make_pose(rotation=FACING, translation_m=[0.0, 0.0, 7.0])
"""Pose of the target at the start. Without it seven rivals of a first pose are tracked in parallel, for
seconds; that the messages are the same then too is tested with both sensors."""


def estimator_input(sensor: SensorConfig) -> PmdInput | LidarInput:
    return PmdInput(name=sensor.name) if isinstance(sensor, PmdConfig) else LidarInput(name=sensor.name)


@dataclass
class Played:
    """All that a run published, by topic and publisher, in the order of the publishers' numbers."""

    messages: dict[tuple[str, int], list[bytes]] = field(default_factory=dict)

    @classmethod
    def of(cls, received: Iterable[Received]) -> "Played":
        publishers: dict[tuple[str, bytes], list[tuple[int, bytes]]] = {}
        for each in received:
            if each.topic.name not in (DIAGNOSTICS.name, ROSOUT.name, PARAMETER_EVENTS.name):
                numbered = each.attachment.sequence, comparable(each)
                publishers.setdefault((each.topic.name, each.attachment.gid), []).append(numbered)
        by_content = sorted(publishers.items(), key=lambda item: (item[0][0], item[1][0][1]))
        return cls(
            {
                (topic, index): [payload for _, payload in sorted(messages)]
                for index, ((topic, _), messages) in enumerate(by_content)
            }
        )


def comparable(received: Received) -> bytes:
    """Return the payload; of a status without the time that it took."""
    if received.topic.name != STATUS.name:
        return bytes(received.payload)
    message = received.decode()
    message.processing_s = 0.0
    return bytes(encode(message))


class Bench:
    """Plays in lockstep and keeps what was published."""

    def __init__(self, bus) -> None:
        self.bus = bus
        self.node = bus.node("listener")
        self.inbox = Inbox(100_000)
        self.node.subscribe_all(patterns(), self.inbox.put)

    def play(
        self,
        *sensors: SensorConfig,
        heard: Iterable[SensorConfig],
        duration_s: float,
        seed: int = 5,
        **estimator,
    ) -> list[Received]:
        inputs = tuple(estimator_input(sensor) for sensor in heard)
        configs = self._configs(sensors, inputs, duration_s, seed, **estimator)
        self.inbox.wait(0.0)
        with (
            daemon(run_estimator, configs[0]),
            daemon(run_emulator, configs[1]),
            daemon(run_motion, configs[2]) as motion,
        ):
            for instance in ("estimator", "emulator", "motion"):
                self.until(instance, "ready")
            for instance in ("emulator", "motion"):
                request = StartRequest(epoch_ns=EPOCH_NS, duration_s=duration_s)
                assert self.node.ask(instance, "start", Accepted, request, timeout_s=TIMEOUT_S).accepted
            self.until("motion", "finished", ended=motion)
        return self.inbox.wait(0.0)

    def _configs(self, sensors, inputs, duration_s, seed, **estimator):
        shared = {"target": "mockup", "bus": self.bus.config}
        return (
            EstimatorConfig(
                **shared, zenoh_id=uuid4().hex.lstrip("0"), sensors=inputs, time_source="clock", **estimator
            ),
            EmulatorConfig(**shared, sensors=sensors, seed=seed, await_start=True, time_source="clock"),
            MotionServiceConfig(
                **shared,
                motion=MotionConfig(),
                duration_s=duration_s,
                sensors=sensors,
                await_start=True,
                speed="max",
                lockstep=LockstepConfig(
                    logger=None, answered=tuple(each.name for each in inputs), timeout_s=_COMPILED_S
                ),
            ),
        )

    def until(self, instance: str, state: str, ended: Event | None = None) -> None:
        for _ in range(600):
            assert ended is None or not ended.is_set(), f"{instance} has ended before it was {state}"
            try:
                if self.node.ask(instance, "status", StatusReply, timeout_s=TIMEOUT_S).state == state:
                    return
            except QueryFailedError:
                pass
            self.node.stop.wait(0.1)
        raise AssertionError(f"{instance} is never {state}")


@pytest.fixture
def bench(bus) -> Bench:
    return Bench(bus)


def statuses_of(messages: Iterable[Received]) -> list[EstimatorStatus]:
    """Return the statuses in the order of their numbers."""
    heard = [each for each in messages if each.topic.name == STATUS.name]
    heard.sort(key=lambda each: each.attachment.sequence)
    return [read_status(each.decode()) for each in heard]


def answered(messages: Iterable[Received]) -> list[tuple[int, str]]:
    """Return stamp and sensor of the statuses in the order of their numbers."""
    return [(status.stamp_ns, status.sensor) for status in statuses_of(messages)]


def steps(*sensors: SensorConfig, duration_s: float) -> list[tuple[int, str]]:
    """Return stamp and sensor of the frames that are due, in the order in which they are handed out."""
    due = lockstep_steps(sensors, epoch_ns=EPOCH_NS, duration_s=duration_s)
    return [(step.frame.stamp_ns, step.frame.sensor) for step in due]


def frames_of(messages: Iterable[Received], sensor: SensorConfig) -> list[int]:
    """Return the stamps of a sensor's frames."""
    topic = (DEPTH if isinstance(sensor, PmdConfig) else POINTS).of(sensor.name).name
    return sorted(peek_stamp(each.payload) for each in messages if each.topic.name == topic)


def payloads(messages: dict[tuple[str, int], list[bytes]], topic: Topic) -> list[bytes]:
    """Return the messages of a topic."""
    return [payload for (name, _), of in messages.items() if name == topic.name for payload in of]


def assert_the_same(bench: Bench, *sensors: SensorConfig, **estimator) -> dict[tuple[str, int], list[bytes]]:
    """Play twice, and compare all that was published; return it."""
    runs = [bench.play(*sensors, heard=sensors, duration_s=1.0, **estimator) for _ in range(2)]
    for run in runs:
        assert answered(run) == steps(*sensors, duration_s=1.0)
    first, other = (Played.of(run).messages for run in runs)
    assert any(status.accepted for status in statuses_of(runs[0]))
    assert {key: len(messages) for key, messages in other.items()} == {
        key: len(messages) for key, messages in first.items()
    }
    assert [key for key in first if first[key] != other[key]] == []
    return first


@pytest.mark.parametrize("sensor", [PMD, LIDAR], ids=["pmd", "lidar"])
def test_a_run_with_one_sensor_comes_out_the_same_to_the_last_message(bench, sensor):
    assert_the_same(bench, sensor, initial_pose=GUESS)


def test_a_run_comes_out_the_same_and_another_seed_gives_other_frames_of_the_same_truth(bench):
    sensors = PMD, LIDAR
    first = assert_the_same(bench, *sensors)
    other = Played.of(bench.play(*sensors, heard=sensors, duration_s=1.0, seed=6)).messages
    runs = first, other
    for topic in (POINTS.of("lidar"), DEPTH.of("pmd"), ESTIMATE):
        five, six = (set(payloads(run, topic)) for run in runs)
        assert five
        assert six
        assert not five & six, topic
    five, six = (payloads(run, TRUTH) for run in runs)
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
    run = bench.play(PMD, SLOW, heard=(PMD, SLOW), duration_s=1.2, max_age_s=0.2, initial_pose=GUESS)
    assert answered(run) == steps(PMD, SLOW, duration_s=1.2)
    refused = [status.reason for status in statuses_of(run) if status.sensor == SLOW.name]
    assert len(refused) == 2
    assert all(reason.startswith("late") for reason in refused)


def test_a_sensor_that_the_estimator_does_not_use_holds_nobody_up(bench):
    run = bench.play(PMD, LIDAR, heard=(PMD,), duration_s=1.0, initial_pose=GUESS)
    assert answered(run) == steps(PMD, duration_s=1.0)
    assert len(frames_of(run, LIDAR)) == 2
