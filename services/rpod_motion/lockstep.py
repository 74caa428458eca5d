"""Lockstep: motion owns time and goes on when the others are done (ICD section 4)."""

import time
from queue import Empty, SimpleQueue

from rpod_motion.truth import TruthPublisher
from rpod_runtime import Node, Received
from rpod_runtime.errors import LockstepError, QueryFailedError
from rpod_schemas.config.emulator import MotionServiceConfig
from rpod_schemas.control import StatusReply
from rpod_schemas.messages import NANOSECONDS, read_status, write_clock
from rpod_schemas.schedule import due_frames
from rpod_schemas.topics import CLOCK, STATUS, TRUTH
from rpod_schemas.types import EstimatorStatus

_BATCH = 60
"""Truth messages between two acknowledgements: fewer than the publisher's cache holds."""
_POLL_S = 0.002


class Lockstep:
    """Plays a scenario as fast as estimator and logger follow."""

    def __init__(self, node: Node, config: MotionServiceConfig, truth: TruthPublisher) -> None:
        self._node, self._config, self._truth = node, config, truth
        self._statuses: SimpleQueue[EstimatorStatus] = SimpleQueue()
        self._clock = node.publisher(CLOCK)
        self._truth_sent = 0
        self._frames_done = 0
        self._begun_ns = time.time_ns()
        node.subscribe(STATUS, self._take, recover=True)

    def _take(self, received: Received) -> None:
        """Keep a status of this run: those of an earlier one, of the same stamps, may be recovered too."""
        if received.attachment.stamp_ns >= self._begun_ns:
            self._statuses.put(read_status(received.decode()))

    def play(self, first_tick: int, last_tick: int) -> None:
        """Publish all truth, frame by frame.

        Raises:
            LockstepError: a service did not deliver in time.
        """
        next_tick = first_tick
        epoch_ns = self._truth.stamp_ns(0)
        for frame in due_frames(self._config.sensors, epoch_ns=epoch_ns, duration_s=self._config.duration_s):
            self._clock.publish(write_clock(frame.available_ns))
            until = min(last_tick, self._truth.tick((frame.available_ns - epoch_ns) / NANOSECONDS) + 1)
            self._publish(range(next_tick, until + 1))
            next_tick = max(next_tick, until + 1)
            self._await_status(frame.sensor, frame.stamp_ns)
            if self._node.stop.is_set():
                return
        self._publish(range(next_tick, last_tick + 1))

    def _publish(self, ticks: range) -> None:
        for tick in ticks:
            self._truth.publish(tick)
            self._truth_sent += 1
            if self._truth_sent % _BATCH == 0:
                self._await_logger(TRUTH.name, self._truth_sent)

    def _await_status(self, sensor: str, stamp_ns: int) -> None:
        deadline_s = time.monotonic() + self._config.lockstep.timeout_s
        while not self._node.stop.is_set():
            self._check(
                deadline_s, self._config.lockstep.estimator, f"a status for {sensor} at {stamp_ns} ns"
            )
            try:
                status = self._statuses.get(timeout=0.05)
            except Empty:
                continue
            self._frames_done += 1
            if (status.sensor, status.stamp_ns) == (sensor, stamp_ns):
                break
        self._await_logger(STATUS.name, self._frames_done)

    def _await_logger(self, topic: str, count: int) -> None:
        logger = self._config.lockstep.logger
        if logger is None:
            return
        deadline_s = time.monotonic() + self._config.lockstep.timeout_s
        while not self._node.stop.is_set():
            try:
                counters = self._node.ask(logger, "status", StatusReply, timeout_s=1.0).counters
            except QueryFailedError:
                counters = {}
            if counters.get(f"received/{topic}", 0) >= count:
                return
            self._check(deadline_s, logger, f"message {count} of {topic}")
            self._node.stop.wait(_POLL_S)

    def _check(self, deadline_s: float, service: str, waited_for: str) -> None:
        if time.monotonic() > deadline_s:
            raise LockstepError(service, waited_for, self._config.lockstep.timeout_s)
