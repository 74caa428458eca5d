"""The emulator daemon: wait for truth, emulate what is due, publish no earlier than a real sensor."""

import logging
import time
from threading import Event

import numpy as np

from rpod_emulator.channels import Channel, open_channel
from rpod_emulator.errors import TruthGapError
from rpod_emulator.faults import Fault, Faults
from rpod_emulator.truth_buffer import TruthBuffer
from rpod_runtime import Inbox, Node
from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.control import Accepted, FaultRequest, StartRequest
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import NANOSECONDS, read_vector_stamped
from rpod_schemas.schedule import DueFrame, frame_at
from rpod_schemas.topics import SUN, TRUTH
from rpod_schemas.types import Health
from rpod_target import load_target

log = logging.getLogger(__name__)

_WAIT_S = 0.05


def run(config: EmulatorConfig, *, version: str, stop: Event) -> None:
    """Emulate until stopped."""
    target = load_target(config.target)
    with Node(config, version=version, stop=stop) as node:
        node.target_digest = target.digest
        channels = [open_channel(node, config, sensor, target) for sensor in config.sensors]
        emulator = Emulator(node, config, sorted(channels, key=lambda channel: channel.sensor.name))
        node.ready(f"emulating {', '.join(channel.sensor.name for channel in channels)} of {target.name}")
        while not stop.is_set():
            emulator.take_messages(_WAIT_S)
            for channel, frame in emulator.due():
                emulator.make(channel, frame)


class Emulator:
    """The state between the frames: truth, sun, the next frame of each sensor."""

    def __init__(self, node: Node, config: EmulatorConfig, channels: list[Channel]) -> None:
        self._node, self._config = node, config
        self._channels = channels
        self._next = {channel.sensor.name: 1 for channel in channels}
        self._truth = TruthBuffer()
        self._faults = Faults()
        self._sun_W_m2 = np.zeros(3)
        self._inbox = Inbox()
        self._epoch_ns = config.epoch_ns
        node.serve("fault", FaultRequest, self._plan_fault)
        node.serve("start", StartRequest, self._start)
        node.subscribe(TRUTH, self._inbox.put, recover=True, history=True)
        node.subscribe(SUN, self._inbox.put)

    def _start(self, request: StartRequest) -> Accepted:
        self._epoch_ns = request.epoch_ns
        return Accepted()

    def _plan_fault(self, request: FaultRequest) -> Accepted:
        start_ns = max(self._truth.last_ns, 0) + round(request.start_s * NANOSECONDS)
        self._faults.add(Fault(request.fault, start_ns, start_ns + round(request.duration_s * NANOSECONDS)))
        return Accepted()

    def take_messages(self, wait_s: float) -> None:
        """Take in all truth and sun that arrived; wait for the first of it."""
        for received in self._inbox.wait(wait_s):
            try:
                if received.topic == SUN:
                    _, self._sun_W_m2 = read_vector_stamped(received.decode())
                elif not self._truth.add(received):
                    raise MessageRejectedError(Reason.LATE, "truth older than the last")
            except MessageRejectedError as error:
                self._node.reject(received.topic.name, error)
        self._node.health.put("overflowed/inbox", self._inbox.overflowed)
        if self._epoch_ns is None and not self._config.await_start:
            self._epoch_ns = self._truth.first_ns

    def due(self) -> list[tuple[Channel, DueFrame]]:
        """Return the frames whose exposure the truth covers, in order of stamp and sensor's name.

        By the wall clock only the newest of a sensor; those that it passes over are counted.
        """
        if self._epoch_ns is None:
            return []
        due: list[tuple[Channel, DueFrame]] = []
        for channel in self._channels:
            frames = self._covered(channel, self._epoch_ns)
            if frames and self._config.time_source == "wall":
                self._node.health.count(f"skipped/{channel.sensor.name}", len(frames) - 1)
                frames = frames[-1:]
            due += [(channel, frame) for frame in frames]
        return sorted(due, key=lambda item: item[1])

    def _covered(self, channel: Channel, epoch_ns: int) -> list[DueFrame]:
        sensor = channel.sensor
        after_ns = round(max(sensor.pose_times_s()) * NANOSECONDS)
        frames: list[DueFrame] = []
        while True:
            frame = frame_at(sensor, self._next[sensor.name], epoch_ns=epoch_ns)
            if frame.stamp_ns + after_ns > self._truth.last_ns:
                return frames
            frames.append(frame)
            self._next[sensor.name] += 1

    def make(self, channel: Channel, frame: DueFrame) -> None:
        """Emulate and publish one frame; where the truth has a gap, count it and go on."""
        fault = self._faults.at(frame.stamp_ns)
        if fault == "silence":
            self._node.health.count(f"silenced/{frame.sensor}")
            return
        T_sensor_chaser = channel.sensor.T_chaser_sensor.inv()
        try:
            poses = [
                T_sensor_chaser * self._truth.pose(frame.stamp_ns + round(offset_s * NANOSECONDS))
                for offset_s in channel.sensor.pose_times_s()
            ]
        except (TruthGapError, MessageRejectedError) as error:
            self._node.health.count(f"truth_gap/{frame.sensor}")
            self._node.health.report(Health.WARN, str(error))
            log.warning("no frame %d of %s: %s", frame.number, frame.sensor, error)
            return
        started_s = time.perf_counter()
        channel.emulate(poses, self._sun_W_m2, frame, fault)
        self._node.health.put(f"emulation_us/{frame.sensor}", round(1e6 * (time.perf_counter() - started_s)))
        if self._config.time_source == "wall":
            self._node.stop.wait(max(0.0, (frame.available_ns - time.time_ns()) / NANOSECONDS))
        channel.publish()
        self._node.health.count(f"frames/{frame.sensor}")
