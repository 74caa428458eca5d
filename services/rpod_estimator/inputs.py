"""The estimator's ears: subscriptions, freshness, and the newest complete frame.

Only sensors, ``tf_static`` and the clock are subscribed; nothing here knows a topic of the truth.
"""

from collections import deque
from collections.abc import Iterator, Mapping

from rpod_estimator.intake import LEADING, Arrived, Intake
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_runtime import BusClock, Inbox, Node, Received
from rpod_runtime.assembler import Assembled, NewestFrames
from rpod_runtime.frames import PartRejectedError
from rpod_schemas.cdr import peek_stamp
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import PmdInfo

_WAITING_PARTS = 512
"""Parts between the bus and the assembler: some 200 MB of images."""
_CLOCK_LAG_S = 0.2
"""How long a clock message may be behind a frame that was published after it."""


class Inputs:
    """Everything that reaches the estimator."""

    def __init__(self, node: Node, config: EstimatorConfig) -> None:
        self._node, self._config = node, config
        self._in_lockstep = config.time_source == "clock"
        self._latched, self._waiting = Inbox(), Inbox(_WAITING_PARTS)
        self._intake = Intake(config.sensors)
        self._newest: NewestFrames[Received] = NewestFrames()
        self._refused: deque[Arrived] = deque()
        for topic in self._intake.latched:
            node.subscribe(topic, self._latched.put)
        for topic in self._intake.streams:
            # Live, what is missed is old by the time it could be had; in lockstep everybody waits for it.
            node.subscribe(topic, self._waiting.put, recover=self._in_lockstep)

    @property
    def patterns(self) -> Mapping[str, ScanPattern]:
        """Scan patterns of the LIDARs, from their latched info."""
        return self._intake.patterns

    @property
    def infos(self) -> Mapping[str, PmdInfo]:
        """What the cameras say of themselves."""
        return self._intake.infos

    def newest(self, timeout_s: float) -> Arrived | None:
        """Return the newest complete frame of the sensor that waits longest; None after the timeout.

        Frames that are refused on arrival, for their stamps, come before it, each with its reason.
        """
        self._take_in(0.0 if self._newest or self._refused else timeout_s)
        return self._next()

    def rest(self) -> Iterator[Arrived]:
        """Yield what waits at this moment: what was refused, the newest complete frame of each sensor."""
        self._take_in(0.0)
        while (arrived := self._next()) is not None:
            yield arrived

    def _take_in(self, timeout_s: float) -> None:
        parts = self._waiting.wait(timeout_s)
        for received in self._latched.wait(0.0) + parts:
            try:
                self._take(received)
            except MessageRejectedError as error:
                self._node.reject(received.topic.name, error)
        if timeout_s and not parts and not self._in_lockstep:
            for sensor, assembler in self._intake.assemblers.items():
                self._put(sensor, assembler.release())
        self._node.health.put("overflowed/inbox", self._waiting.overflowed)

    def _next(self) -> Arrived | None:
        if self._refused:
            return self._refused.popleft()
        chosen = self._newest.take()
        return self._arrived(*chosen) if chosen else None

    def _take(self, received: Received) -> None:
        if received.topic.name in self._intake.parts:
            self._take_part(received)
        else:
            self._intake.learn(received)

    def _take_part(self, received: Received) -> None:
        sensor, part = self._intake.parts[received.topic.name]
        assembler = self._intake.assemblers[sensor]
        stamp_ns = peek_stamp(received.payload)
        try:
            self._check_freshness(received, stamp_ns)
            if stamp_ns == assembler.done_ns and part in assembler.required:
                raise MessageRejectedError(Reason.DUPLICATE, "a frame of this stamp is complete already")
        except MessageRejectedError as error:
            if part in LEADING:
                self._refused.append(Arrived(sensor, stamp_ns, received.arrival_s, None, str(error)))
            raise
        self._put(sensor, assembler.add(part, stamp_ns, received))
        self._node.health.put(f"incomplete/{sensor}", assembler.incomplete)

    def _put(self, sensor: str, frames: list[Assembled[Received]]) -> None:
        for frame in frames:
            if self._newest.put(sensor, frame):
                self._node.health.count(f"dropped/{sensor}")

    def _check_freshness(self, received: Received, stamp_ns: int) -> None:
        """Judge a stamp by its arrival: what then waits for the methods is not late by its sensor's fault."""
        now_ns, clock = received.arrival_ns, self._node.clock
        if isinstance(clock, BusClock):
            clock.await_ns(stamp_ns - round(self._config.max_future_s * NANOSECONDS), _CLOCK_LAG_S)
            now_ns = clock.now_ns()
        age_s = (now_ns - stamp_ns) / NANOSECONDS
        if age_s > self._config.max_age_s:
            raise MessageRejectedError(
                Reason.LATE,
                f"{age_s:.3f} s old, limit {self._config.max_age_s:g} s; check the sensor's clock",
            )
        if age_s < -self._config.max_future_s:
            raise MessageRejectedError(
                Reason.FUTURE,
                f"{-age_s:.3f} s ahead of {self._config.time_source} time; check the sensor's clock",
            )

    def _arrived(self, sensor: str, frame: Assembled[Received]) -> Arrived:
        arrival_s = max(part.arrival_s for part in frame.parts.values())
        try:
            measurement = self._intake.measurement(sensor, frame)
        except PartRejectedError as error:
            self._node.reject(error.topic, error)
            return Arrived(sensor, frame.stamp_ns, arrival_s, None, str(error))
        return Arrived(sensor, frame.stamp_ns, arrival_s, measurement)
