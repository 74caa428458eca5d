"""The emulator daemon: waits for truth, computes the frames that are due, and publishes them in time."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from threading import Event

import numpy as np

from rpod_emulator.channels import Channel, Showing, open_channel
from rpod_emulator.errors import TruthGapError
from rpod_emulator.faults import Faults, FaultyNode, turned
from rpod_emulator.joints import MovingJoints
from rpod_emulator.rehearsal import rehearse
from rpod_emulator.truth_buffer import TruthBuffer
from rpod_runtime import Inbox, Node, Received
from rpod_runtime.errors import RefusedError
from rpod_runtime.fault_book import FaultBook
from rpod_runtime.process.notify import manager
from rpod_runtime.requests.sole import Sole
from rpod_runtime.ros import trigger
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.emulator import EmulatorConfig, SensorConfig
from rpod_schemas.control import Accepted, FaultRequest, StartRequest
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import NANOSECONDS, read_stamp, read_vector_stamped
from rpod_schemas.schedule import DueFrame, Step, frame_at, last_number, lockstep_steps
from rpod_schemas.topics import CLOCK, REFERENCE, SUN, TRUTH
from rpod_schemas.types import Health
from rpod_target import load_target

log = logging.getLogger(__name__)

_WAIT_S = 0.05
_DARKNESS = 0, np.zeros(3)
_SUN_PERIOD_NS = NANOSECONDS
"""Time between two messages of the sun, ns (ICD section 2)."""


def run(config: EmulatorConfig, *, version: str, stop: Event) -> None:
    """Emulate until stopped."""
    target = load_target(config.target)
    rehearse(config, target)
    with Node(config, version=version, stop=stop, sole=Sole()) as node:
        node.target_digest, node.target_content = target.digest, target.content_digest
        joints = MovingJoints(config, target)
        faults = Faults.of(config)
        outlets = [FaultyNode(node, sensor, faults, seed=config.seed) for sensor in config.sensors]
        channels = [
            open_channel(outlet, config, sensor, joints.at(0.0))
            for outlet, sensor in zip(outlets, config.sensors, strict=True)
        ]
        channels.sort(key=lambda channel: channel.sensor.name)
        emulator = Emulator(node, config, channels, joints, faults)
        node.ready(f"emulating {', '.join(channel.sensor.name for channel in channels)} of {target.name}")
        while not stop.is_set():
            manager.alive()
            emulator.take_messages()
            for channel, frame in emulator.due():
                emulator.make(channel, frame)
            emulator.publish_made()
            emulator.publish_faults()
            for outlet in outlets:
                outlet.refresh()


def _exposure_end_ns(sensor: SensorConfig) -> int:
    """Return the time from the stamp to the last pose that an exposure or scan needs, ns."""
    return round(max(sensor.pose_times_s()) * NANOSECONDS)


@dataclass(frozen=True)
class _Made:
    """A frame that is not published before a real sensor would have it ready."""

    frame: DueFrame
    publish: Callable[[], None]


class Emulator:
    """State between frames: truth, sun, the next frame of each sensor, and frames not published yet."""

    def __init__(
        self,
        node: Node,
        config: EmulatorConfig,
        channels: list[Channel],
        joints: MovingJoints | None = None,
        faults: Faults | None = None,
    ) -> None:
        self._node, self._config = node, config
        self._in_lockstep = config.in_lockstep
        self._channels, self._joints = channels, joints
        self._exposure_end_ns = {
            channel.sensor.name: _exposure_end_ns(channel.sensor) for channel in channels
        }
        self._faults = faults or Faults.of(config)
        self._fault_book = FaultBook(node)
        self._suns: deque[tuple[int, FloatArray]] = deque([_DARKNESS], maxlen=4)
        self._inbox = Inbox()
        self._starts: SimpleQueue[StartRequest] = SimpleQueue()
        self._awaits_start = config.await_start
        self._begin(config.epoch_ns, None)
        node.serve("fault", FaultRequest, self._plan_fault)
        node.serve("start", StartRequest, self._ask_to_start, ros=trigger(StartRequest))
        if self._in_lockstep:
            node.follow_clock(self._inbox.put)
        moved = REFERENCE if config.motion == REFERENCE.name else TRUTH
        node.subscribe(moved, self._inbox.put, recover=True, history=True)
        node.subscribe(SUN, self._inbox.put, recover=True)

    def _begin(self, epoch_ns: int | None, duration_s: float | None) -> None:
        self._epoch_ns, self._duration_s = epoch_ns, duration_s
        self._faults.begin(self._config, epoch_ns)
        self._clock_ns = 0
        self._steps: Iterator[Step] | None = None
        self._step: Step | None = None
        self._next = {channel.sensor.name: 1 for channel in self._channels}
        self._truth = TruthBuffer()
        self._made: list[_Made] = []
        self._in_gap = False

    def _ask_to_start(self, request: StartRequest) -> Accepted:
        if request.epoch_ns is None and self._in_lockstep:
            raise RefusedError("lockstep counts frames from motion's epoch: ask for a start with epoch_ns")
        self._starts.put(request)
        return Accepted()

    def _plan_fault(self, request: FaultRequest) -> Accepted:
        self._faults.request(request, self._truth.last_ns)
        return Accepted()

    def take_messages(self) -> None:
        """Process all truth, sun and clock messages; wait for the first one, or for a frame to publish.

        A start query comes before any message of its run, so it is processed before the messages.
        """
        messages = self._inbox.wait(self._spare_s())
        self._take_starts()
        for received in messages:
            try:
                self._take(received)
            except MessageRejectedError as error:
                self._node.reject(received.topic.name, error)
        self._node.health.put("overflowed/inbox", self._inbox.overflowed)
        if self._epoch_ns is None and not self._awaits_start:
            self._epoch_ns = self._truth.first_ns
            self._faults.begin(self._config, self._epoch_ns)

    def _take_starts(self) -> None:
        while True:
            try:
                request = self._starts.get_nowait()
            except Empty:
                return
            self._begin(request.epoch_ns, request.duration_s)
            self._awaits_start = False
            if self._in_lockstep:
                self._suns.append(_DARKNESS)  # until the first sun message of this run

    def _take(self, received: Received) -> None:
        if received.topic == SUN:
            self._suns.append(read_vector_stamped(received.decode()))
        elif received.topic == CLOCK:
            self._clock_ns = max(self._clock_ns, read_stamp(received.decode()))
        else:
            self._truth.add(received, latest_ns=None if self._in_lockstep else received.arrival_ns)

    def _spare_s(self) -> float:
        ahead_s = [(made.frame.available_ns - time.time_ns()) / NANOSECONDS for made in self._made]
        return max(0.0, min([_WAIT_S, *ahead_s]))

    def due(self) -> list[tuple[Channel, DueFrame]]:
        """Return the frames to make now.

        By the wall clock these are the frames whose exposure the truth covers, in the order of stamp and
        sensor name. Of each sensor only the newest frame is made; the others are counted as skipped. In
        lockstep these are the frames of the steps up to the time of the clock for which truth and sun have
        arrived. So the same frames are made in the same order, whichever message arrives first, and none
        later than the clock.
        """
        if self._epoch_ns is None:
            return []
        if self._in_lockstep:
            by_name = {channel.sensor.name: channel for channel in self._channels}
            return [(by_name[frame.sensor], frame) for frame in self._stepped(self._epoch_ns)]
        due = [
            (channel, frame)
            for channel in self._channels
            if (frame := self._newest(channel.sensor, epoch_ns=self._epoch_ns))
        ]
        return sorted(due, key=lambda item: item[1])

    def _stepped(self, epoch_ns: int) -> Iterator[DueFrame]:
        """Yield the frames up to the clock's time for which truth and sun have arrived."""
        if self._steps is None:
            sensors = [channel.sensor for channel in self._channels]
            self._steps = lockstep_steps(sensors, epoch_ns=epoch_ns, duration_s=self._duration_s)
            self._step = next(self._steps, None)
        while (step := self._step) is not None and step.time_ns <= self._clock_ns:
            frame = step.frame
            truth_has_come = frame.stamp_ns + self._exposure_end_ns[frame.sensor] <= self._truth.last_ns
            sun_has_come = frame.stamp_ns < self._suns[-1][0] + _SUN_PERIOD_NS
            if not (truth_has_come and sun_has_come):
                return
            self._step = next(self._steps, None)
            yield frame

    def _newest(self, sensor: SensorConfig, *, epoch_ns: int) -> DueFrame | None:
        """Return the newest frame whose exposure the truth covers; None where there is no new one."""
        covered_ns = self._truth.last_ns - self._exposure_end_ns[sensor.name]
        first, last = self._next[sensor.name], last_number(sensor, covered_ns, epoch_ns=epoch_ns)
        if last < first:
            return None
        self._next[sensor.name] = last + 1
        self._node.health.count(f"skipped/{sensor.name}", last - first)
        return frame_at(sensor, last, epoch_ns=epoch_ns)

    def make(self, channel: Channel, frame: DueFrame) -> None:
        """Compute one frame; a frame in a gap of the truth is counted and left out."""
        active = self._faults.at(frame.sensor, frame.stamp_ns)
        if "silence" in [window.fault.name for window in active]:
            self._node.health.count(f"silenced/{frame.sensor}")
            return
        T_sensor_chaser = channel.sensor.T_chaser_sensor.inv()
        try:
            stamps_ns = [
                frame.stamp_ns + round(offset_s * NANOSECONDS) for offset_s in channel.sensor.pose_times_s()
            ]
            poses = [turned(pose, active) for pose in self._truth.poses(stamps_ns, T_sensor_chaser)]
        except TruthGapError as error:
            self._node.health.count(f"truth_gap/{frame.sensor}")
            self._node.health.report(
                Health.WARN, "frames are left out where the truth has gaps; check whether motion is too slow"
            )
            if not self._in_gap:
                log.warning("no frame %d of %s: %s", frame.number, frame.sensor, error)
            self._in_gap = True
            return
        self._in_gap = False
        started_s = time.perf_counter()
        if self._joints is not None and self._joints.turn and isinstance(channel, Showing):
            channel.show(self._joints.at((frame.stamp_ns - (self._epoch_ns or 0)) / NANOSECONDS))
        self._made.append(_Made(frame, channel.emulate(poses, self._sun_W_m2(frame.stamp_ns), frame)))
        self._node.health.put(f"emulation_us/{frame.sensor}", round(1e6 * (time.perf_counter() - started_s)))
        self._node.health.report(Health.OK, "emulating")

    def _sun_W_m2(self, stamp_ns: int) -> FloatArray:  # noqa: N802 - watt
        """Return the newest sun up to a stamp, or the oldest one if all are newer."""
        return next((sun for sun_ns, sun in reversed(self._suns) if sun_ns <= stamp_ns), self._suns[0][1])

    def publish_faults(self) -> None:
        """Publish which faults have begun."""
        if self._epoch_ns is not None:
            self._fault_book.publish(self._faults.begun(self._truth.last_ns, self._epoch_ns))

    def publish_made(self) -> None:
        """Publish the frames that a real sensor would have ready by now; in lockstep all of them."""
        now_ns = time.time_ns()
        waiting = []
        for made in self._made:
            if not self._in_lockstep and made.frame.available_ns > now_ns:
                waiting.append(made)
                continue
            made.publish()
            self._node.health.count(f"frames/{made.frame.sensor}")
        self._made = waiting
