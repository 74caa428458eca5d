"""Lockstep: motion sets the time and advances when the other services have finished (ICD section 4)."""

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from itertools import takewhile
from queue import Empty, SimpleQueue

from rpod_motion.truth import TruthPublisher
from rpod_runtime import Node, Received
from rpod_runtime.errors import LockstepError, QueryFailedError
from rpod_runtime.process.notify import manager
from rpod_schemas.config.emulator import MotionServiceConfig
from rpod_schemas.control import StatusReply
from rpod_schemas.messages import NANOSECONDS, read_status, write_clock
from rpod_schemas.schedule import DueFrame, Step, lockstep_steps
from rpod_schemas.topics import CLOCK, STATUS, TRUTH
from rpod_schemas.types import EstimatorStatus

_BATCH = 60
"""Number of truth messages between two acknowledgements; the publisher's cache holds more."""
_POLL_S = 0.002


class Lockstep:
    """Plays a scenario as fast as emulator, estimator and logger process it."""

    def __init__(self, node: Node, config: MotionServiceConfig, truth: TruthPublisher) -> None:
        self._node, self._config, self._truth = node, config, truth
        self._statuses: SimpleQueue[EstimatorStatus] = SimpleQueue()
        self._clock = node.publisher(CLOCK)
        self._truth_sent = 0
        self._statuses_heard = 0
        self._answered: set[tuple[str, int]] = set()
        """Sensor and stamp of frames whose status arrived before lockstep waited for it."""
        self._published: Counter[str] = Counter()
        """Number of frames that the emulator must have published by now, by sensor."""
        self._begun_ns = time.time_ns()
        node.subscribe(STATUS, self._take, recover=True)

    def _take(self, received: Received) -> None:
        """Store a status of this run; statuses of an earlier run with the same stamps may arrive too."""
        if received.attachment.stamp_ns >= self._begun_ns:
            self._statuses.put(read_status(received.decode()))

    def play(self, first_tick: int, last_tick: int) -> None:
        """Publish all truth step by step; each step is one frame and ends when its status has arrived.

        The last clock message is that of the last step; the last truth is that of ``last_tick``.

        Raises:
            LockstepError: a service did not deliver in time.
        """
        next_tick, epoch_ns = first_tick, self._truth.stamp_ns(0)
        for step in self._steps(epoch_ns, last_tick):
            manager.alive()
            self._clock.publish(write_clock(step.time_ns))
            until = min(last_tick, self._truth.tick((step.time_ns - epoch_ns) / NANOSECONDS) + 1)
            self._publish(range(next_tick, until + 1))
            next_tick = max(next_tick, until + 1)
            self._await_frame(step.frame)
            if self._node.stop.is_set():
                return
        self._publish(range(next_tick, last_tick + 1))

    def _steps(self, epoch_ns: int, last_tick: int) -> Iterator[Step]:
        """Yield the steps up to the end of the truth, without which no frame can be made."""
        last_ns = self._truth.stamp_ns(last_tick)
        steps = lockstep_steps(self._config.sensors, epoch_ns=epoch_ns, duration_s=self._config.duration_s)
        return takewhile(lambda step: step.time_ns <= last_ns, steps)

    def _publish(self, ticks: range) -> None:
        for tick in ticks:
            self._truth.publish(tick)
            self._truth_sent += 1
            if self._truth_sent % _BATCH == 0:
                self._await_count(self._config.lockstep.logger, f"received/{TRUTH.name}", self._truth_sent)

    def _await_frame(self, frame: DueFrame) -> None:
        lockstep = self._config.lockstep
        if lockstep.answered is None or frame.sensor in lockstep.answered:
            self._await_status(frame)
            self._await_count(lockstep.logger, f"received/{STATUS.name}", self._statuses_heard)
        else:
            self._published[frame.sensor] += 1
            self._await_count(lockstep.emulator, f"frames/{frame.sensor}", self._published[frame.sensor])

    def _await_status(self, frame: DueFrame) -> None:
        """Wait for the status of a frame; statuses of other frames may arrive before it."""
        deadline_s = time.monotonic() + self._config.lockstep.timeout_s
        answer = frame.sensor, frame.stamp_ns
        waited_for = f"a status for {frame.sensor} at {frame.stamp_ns} ns"
        while answer not in self._answered and not self._node.stop.is_set():
            self._check(deadline_s, self._config.lockstep.estimator, waited_for)
            with suppress(Empty):
                status = self._statuses.get(timeout=0.05)
                self._statuses_heard += 1
                self._answered.add((status.sensor, status.stamp_ns))
        self._answered.discard(answer)

    def _await_count(self, service: str | None, counter: str, count: int) -> None:
        """Wait until a counter of a service reaches a value; return at once if no service is given."""
        if service is None:
            return
        deadline_s = time.monotonic() + self._config.lockstep.timeout_s
        while not self._node.stop.is_set():
            try:
                counters = self._node.ask(service, "status", StatusReply, timeout_s=1.0).counters
            except QueryFailedError:
                counters = {}
            if counters.get(counter, 0) >= count:
                return
            self._check(deadline_s, service, f"{count} counted as {counter}")
            self._node.stop.wait(_POLL_S)

    def _check(self, deadline_s: float, service: str, waited_for: str) -> None:
        if time.monotonic() > deadline_s:
            raise LockstepError(service, waited_for, self._config.lockstep.timeout_s)
