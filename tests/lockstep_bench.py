"""Runs in lockstep for tests: motion, emulator and estimator in threads, and the test in the logger's place.

As a process, ``python -m lockstep_bench``, it plays the runs of ``SENSORS`` on a bus of its own and writes
digests of what they published, for comparisons with runs in other processes.
"""

import hashlib
import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from threading import Event
from typing import Any
from unittest.mock import patch
from uuid import uuid4

from bus_processes import router_process
from live_bus import TIMEOUT_S, Bus, daemon
from search_thread import SearchThread

import rpod_estimator.daemon
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
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.topics import DIAGNOSTICS, PARAMETER_EVENTS, ROSOUT, STATUS
from rpod_schemas.types import Camera, EstimatorStatus

EPOCH_NS = 1_767_225_600 * NANOSECONDS
_COMPILED_S = 200.0
"""Longest time of a step: kernels that are not compiled yet are compiled in it."""
CAMERA = Camera(width=88, height=72, fx=170.0, fy=170.0, cx=43.5, cy=35.5)
PMD = PmdConfig(rate_hz=15.0, camera=CAMERA, T_chaser_sensor=make_pose(translation_m=[0.0, -0.05, 0.0]))
SCAN = ScanPatternConfig(azimuth_span_deg=30.0, elevation_span_deg=30.0, step_deg=1.0)
LIDAR = LidarConfig(pattern=SCAN, rate_hz=2.0)
GUESS = make_pose(rotation=FACING, translation_m=[0.0, 0.0, 7.0])
"""Pose of the target at the start. Without it seven rivals of a first pose are tracked in parallel, for
seconds; that the messages are the same then too is tested with both sensors."""
SENSORS: Mapping[str, tuple[SensorConfig, ...]] = {"pmd": (PMD,), "lidar": (LIDAR,), "both": (PMD, LIDAR)}
"""Sensors of the runs that are compared, by the name of the run."""
DURATION_S = 1.0


def estimator_input(sensor: SensorConfig) -> PmdInput | LidarInput:
    return PmdInput(name=sensor.name) if isinstance(sensor, PmdConfig) else LidarInput(name=sensor.name)


@dataclass
class Played:
    """Digests of all that a run published, by topic and publisher, in the order of the numbers."""

    messages: dict[str, list[str]] = field(default_factory=dict)
    """By the topic's name and the publisher's place among its publishers, as ``clock#0``."""
    answered: list[tuple[int, str]] = field(default_factory=list)
    """Stamp and sensor of the statuses."""
    accepted: int = 0
    """Number of accepted frames."""

    @classmethod
    def of(cls, received: Iterable[Received]) -> "Played":
        received = list(received)
        publishers: dict[tuple[str, bytes], list[tuple[int, bytes]]] = {}
        for each in received:
            if each.topic.name not in (DIAGNOSTICS.name, ROSOUT.name, PARAMETER_EVENTS.name):
                numbered = each.attachment.sequence, comparable(each)
                publishers.setdefault((each.topic.name, each.attachment.gid), []).append(numbered)
        by_content = sorted(publishers.items(), key=lambda item: (item[0][0], item[1][0][1]))
        return cls(
            {
                f"{topic}#{index}": [hashlib.sha256(payload).hexdigest() for _, payload in sorted(messages)]
                for index, ((topic, _), messages) in enumerate(by_content)
            },
            answered(received),
            sum(status.accepted for status in statuses_of(received)),
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
                **shared,
                zenoh_id=uuid4().hex.lstrip("0"),
                sensors=inputs,
                time_source="clock",
                **estimator,
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


def statuses_of(messages: Iterable[Received]) -> list[EstimatorStatus]:
    """Return the statuses in the order of their numbers."""
    heard = [each for each in messages if each.topic.name == STATUS.name]
    heard.sort(key=lambda each: each.attachment.sequence)
    return [read_status(each.decode()) for each in heard]


def answered(messages: Iterable[Received]) -> list[tuple[int, str]]:
    """Return stamp and sensor of the statuses in the order of their numbers."""
    return [(status.stamp_ns, status.sensor) for status in statuses_of(messages)]


@dataclass
class Runs:
    """What one process played."""

    played: dict[str, Played]
    """By the names in ``SENSORS``."""
    hash_of_a_text: int
    """Hash of a text, which another hash seed changes."""


def play_all() -> Runs:
    """Play the runs of ``SENSORS`` in this process. One sensor alone gets a guess of the pose."""
    threads = patch.object(rpod_estimator.daemon, "SearchProcess", SearchThread)
    with threads, router_process() as (_, endpoint), ExitStack() as stack:
        bench = Bench(Bus(endpoint, stack))
        played = {}
        for name, sensors in SENSORS.items():
            guess = {"initial_pose": GUESS} if len(sensors) == 1 else {}
            played[name] = Played.of(bench.play(*sensors, heard=sensors, duration_s=DURATION_S, **guess))
    return Runs(played, hash("a text"))


@contextmanager
def player(*, hash_seed: int, niceness: int = 0) -> Iterator[Any]:
    """Play the runs in another process; yields a function that waits for its end and returns them."""
    changed = {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONHASHSEED": str(hash_seed)}
    command = ["nice", "-n", str(niceness), sys.executable, "-m", "lockstep_bench"]
    process = subprocess.Popen(command, env=os.environ | changed, stdout=subprocess.PIPE, text=True)
    try:

        def ended() -> Runs:
            said, _ = process.communicate(timeout=10.0 * TIMEOUT_S)
            assert process.returncode == 0
            document = json.loads(said)
            return Runs(
                {
                    name: Played(
                        played["messages"], [tuple(each) for each in played["answered"]], played["accepted"]
                    )
                    for name, played in document["played"].items()
                },
                document["hash_of_a_text"],
            )

        yield ended
    finally:
        process.terminate()  # so that it ends its router too
        process.wait()


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    sys.stdout.write(json.dumps(asdict(play_all())))
