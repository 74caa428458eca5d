"""Subscriptions of the estimator: they check the age of messages and keep the newest complete frame.

The estimator subscribes to sensors, ``tf_static``, diagnostics and the clock only, never to the truth.
"""

import logging
import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import replace
from queue import SimpleQueue
from threading import Lock
from typing import Any

import numpy as np

from rpod_estimator.frame_reader import Arrived, FrameReader
from rpod_estimator.inputs.book import LOCKSTEP_SILENCE_S, WINDOW_S
from rpod_estimator.inputs.health import InputHealth
from rpod_estimator.inputs.published import Published
from rpod_estimator.inputs.sensor_clock import ClockStepError, SensorClock
from rpod_pose.measurement import Measurement
from rpod_runtime import BusClock, Inbox, Node, Received
from rpod_runtime.assembler import Assembled, NewestFrames
from rpod_runtime.delivery.holders import Holders, Peer, SecondPublisherError
from rpod_runtime.delivery.kept import KeptMessages
from rpod_runtime.errors import RefusedError
from rpod_runtime.frames import PartRejectedError
from rpod_runtime.process.standing import Stand, StandWatch
from rpod_runtime.sensor_data.extrinsics import in_words
from rpod_runtime.sensor_data.stamp_watch import clock_hint
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.control import ResetRequest
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import NANOSECONDS, read_diagnostics
from rpod_schemas.topics import DIAGNOSTICS, Topic
from rpod_schemas.types import Mode

log = logging.getLogger(__name__)

_WAITING_PARTS = 512
"""Largest number of parts that wait between the bus and the assembler; about 200 MB of images."""
_MOST_REFUSED = 500
"""Largest number of refused frames that wait for their status; further ones are counted as dropped."""
_MOST_MOUNTS = 50
"""Largest number of mounts that are written to the log."""
_CLOCK_LAG_S, _STANDING_S = 0.2, 5.0
"""Longest time that a clock message may arrive after a frame that was published later; and that time in
lockstep, where the clock waits for the frame and a machine may be loaded."""


class FrameRefusedError(MessageRejectedError):
    """The leading part of a frame is refused: the frame gets a status, and its sensor's book counts it."""


class Subscriptions:
    """Receives all messages of the estimator and hands out frames."""

    def __init__(self, node: Node, config: EstimatorConfig, stands: StandWatch | None = None) -> None:
        self._node, self._config, self._stands = node, config, stands
        self._told_stand: Stand | None = None
        self._in_lockstep = config.in_lockstep
        self._latched, self._waiting = Inbox(), Inbox(_WAITING_PARTS)
        self._reader = FrameReader(config.sensors)
        self._newest: NewestFrames[Received] = NewestFrames()
        self._refused: deque[Arrived] = deque()
        self._mounts: set[str] = set()
        self._ended = False
        self.heard_until_s = time.monotonic()
        """Time up to which all received messages have been processed, monotonic clock."""
        silence_s = LOCKSTEP_SILENCE_S if config.in_lockstep else WINDOW_S
        self.health = InputHealth(
            node.health,
            self._reader.leading,
            now_s=self.heard_until_s,
            silence_s=silence_s,
            limits=config.navigator.tuning,
        )
        self._clocks = {
            sensor.name: SensorClock(sensor, config, self.health.books[sensor.name], node.health)
            for sensor in config.sensors
        }
        self._holders, self._gone = Holders(), SimpleQueue[tuple[str, Topic, bool, float]]()
        self._kept = KeptMessages(self._holders)
        self._used_with: dict[str, tuple[Peer, Peer]] = {}
        self._leaders: dict[str, tuple[Peer, float]] = {}
        """Publisher of each sensor's frames, and when the last frame of the publisher before it arrived."""
        self._led_s: dict[str, float] = {}
        self._resets: SimpleQueue[str] = SimpleQueue()
        self._lock = Lock()
        self._published = Published()
        node.watch_publishers(self._leave, self._published.came)
        self._published.watch(node)
        for topic in self._reader.latched:
            node.subscribe(topic, self._latched.put)
        node.subscribe(DIAGNOSTICS, self._latched.put)
        for topic in self._reader.streams:
            # A live message that was missed would be too old when it is recovered; in lockstep all services
            # wait.
            lasting = self._reader.lasting(topic)
            node.subscribe(topic, self._put_part, recover=self._in_lockstep, history=lasting)

    def _leave(self, session: str, topic: Topic) -> None:
        is_last = self._published.gone(session, topic)
        self._gone.put((session, topic, is_last, time.monotonic()))

    @property
    def infos(self) -> Mapping[str, Any]:
        """Newest info message of each sensor, by sensor name; None if a sensor has sent none."""
        return self._reader.infos

    def pin(self, pinned: bool) -> None:
        """Set whether the setups of the sensors must not change."""
        self._reader.pinned = pinned

    def request_reset(self, request: ResetRequest) -> None:
        """Give each topic to its next valid publisher, or to the one of the session of ``keep_gid``.

        Raises:
            RefusedError: no publisher has this gid.
        """
        if request.keep_gid is None:
            self._resets.put("")
            return
        with self._lock:
            peers = {*self._holders.peers, *self._reader.peers}
        found = [peer for peer in peers if peer.gid.hex() == request.keep_gid]
        if not found or not found[0].session:
            known = ", ".join(sorted(map(str, peers))) or "none"
            raise RefusedError(
                f"keep_gid: no publisher with this gid and a session is known; known are {known}"
            )
        self._resets.put(found[0].session)

    def newest(self, timeout_s: float) -> Arrived | None:
        """Return the newest complete frame with the oldest stamp over all sensors; None after the timeout.

        Frames that were refused for their stamps come first, each with its reason.
        """
        self._take_in(0.0 if self._newest or self._refused else timeout_s)
        return self._next()

    def rest(self) -> Iterator[Arrived]:
        """Yield the waiting frames: the refused ones first, then the newest complete frame of each sensor.

        Frames that arrive from now on are dropped, and counted.
        """
        self._ended = True
        self._take_in(0.0)
        self._release()
        while (arrived := self._next()) is not None:
            yield arrived

    def wake(self) -> None:
        """Make ``newest`` return at once, or the next call of it."""
        self._waiting.wake()

    def _put_part(self, received: Received) -> None:
        """Enqueue a part; count frames that are dropped because the inbox is full or the estimator ends."""
        for dropped in [received] if self._ended else self._waiting.put(received):
            sensor, part = self._reader.parts[dropped.topic.name]
            if part == self._reader.leading[sensor]:
                self.health.drop(sensor, time.monotonic())

    def _release(self) -> None:
        for sensor, assembler in self._reader.assemblers.items():
            self._put(sensor, assembler.release())

    def _take_in(self, timeout_s: float) -> None:
        parts, woken = self._waiting.wait(timeout_s), self._waiting.take_wake()
        self.heard_until_s = time.monotonic()
        with self._lock:
            self._take_all(parts)
        if timeout_s and not (parts or woken or self._in_lockstep):
            self._release()
        for name, (sensor, part) in self._reader.parts.items():
            if part == self._reader.leading[sensor] and self.health.books[sensor].is_unheard:
                refused = self._node.health.rejection(name)
                self.health.books[sensor].note("instead", self._published.instead(name, refused))
        self._node.health.put("overflowed/inbox", self._waiting.overflowed)

    def _take_all(self, parts: list[Received]) -> None:
        while not self._gone.empty():
            session, topic, is_last, gone_s = self._gone.get()
            self._holders.leave(topic.name, session, last=is_last, now_s=gone_s)
            self._kept.leave(topic.name, session)
            self.health.refusals.leave(topic.name, session)
            if topic in self._reader.latched:
                self._reader.leave(session, topic)
        while not self._resets.empty():
            keep = self._resets.get()
            self._holders.release(keep=keep, now_s=time.monotonic())
            self._reader.forget(keep=keep)
            for clock in self._clocks.values():
                clock.accept_step()
            self.health.refusals.forget()
        for received in self._latched.wait(0.0) + parts:
            try:
                self._take(received)
                self.health.refusals.accept(received)
            except FrameRefusedError as error:
                self._node.reject(received.topic.name, error)
            except MessageRejectedError as error:
                self._node.reject(received.topic.name, error)
                self.health.refusals.refuse(received, error)
        self.health.rivals = [*self._holders.rivals(time.monotonic()), *self._reader.rivals]

    def _next(self) -> Arrived | None:
        if self._refused:
            return self._refused.popleft()
        chosen = self._newest.take()
        with self._lock:
            return self._arrived(*chosen) if chosen else None

    def _take(self, received: Received) -> None:
        if received.topic.name in self._reader.parts:
            self._take_part(received)
        elif received.topic.name == DIAGNOSTICS.name:
            for diagnostic in read_diagnostics(received.decode()):
                if diagnostic.name != self._config.instance:  # its own repeat what drivers say
                    self.health.take_diagnostic(diagnostic)
        else:
            self._reader.learn(received)

    def _take_part(self, received: Received) -> None:
        sensor, part = self._reader.parts[received.topic.name]
        assembler = self._reader.assemblers[sensor]
        stamp_ns = self._reader.stamp_ns(sensor, received)
        leads = part == self._reader.leading[sensor]
        if leads and not self._in_lockstep and self._stand(received, stamp_ns) is None:
            self._clocks[sensor].note_arrival(received, stamp_ns)
        try:
            self._check_part(sensor, part, received, stamp_ns)
        except MessageRejectedError as error:
            if leads:
                self._note_arrival(sensor, received, stamp_ns)
                if len(self._refused) < _MOST_REFUSED:
                    refused = Arrived.unusable(sensor, stamp_ns, error, received.arrival_s)
                    moved_s = error.moved_s if isinstance(error, ClockStepError) else 0.0
                    self._refused.append(replace(refused, clock_moved_s=moved_s))
                else:
                    self.health.drop(sensor, time.monotonic())
                assembler.refuse(stamp_ns)
                raise FrameRefusedError(error.reason, error.text) from error
            raise
        if part in assembler.lasting:
            self._kept.admit(received)
        else:
            self._holders.admit(received.topic.name, received.peer, received.arrival_s)
        if leads:
            self._note_arrival(sensor, received, stamp_ns)
            for lasting, kept in self._reader.due(sensor, self._kept, received):
                self._put(sensor, assembler.add(lasting, stamp_ns, kept))
        self._put(sensor, assembler.add(part, stamp_ns, received))
        for frame in assembler.take_given_up():
            self.health.give_up(sensor, frame, received.arrival_s)
        self._node.health.put(f"incomplete/{sensor}", assembler.incomplete)

    def _check_part(self, sensor: str, part: str, received: Received, stamp_ns: int) -> None:
        """Check the stamp of a part of a frame."""
        assembler = self._reader.assemblers[sensor]
        if part not in assembler.lasting:
            self._check_freshness(sensor, received, stamp_ns)
        leads = part == self._reader.leading[sensor]
        if leads and not self._in_lockstep and self._stand(received, stamp_ns) is None:
            self._check_step(sensor, received, stamp_ns)
        if stamp_ns == assembler.done_ns and part in assembler.required:
            raise MessageRejectedError(
                Reason.DUPLICATE,
                f"the frame of {stamp_ns} ns is already complete; the driver sends a part twice, or gives "
                "two frames one stamp",
            )

    def _note_arrival(self, sensor: str, received: Received, stamp_ns: int) -> None:
        bus_s = stamp_ns / NANOSECONDS if self._in_lockstep else None
        self.health.books[sensor].note_arrival(received.arrival_s, bus_s)
        if self._leaders.get(sensor, (None,))[0] != received.peer:
            self._leaders[sensor] = received.peer, self._led_s.get(sensor, -np.inf)
        self._led_s[sensor] = received.arrival_s

    def report_health(self, mode: Mode) -> None:
        """Write the health of the inputs into the diagnostics, at the time up to which all was processed."""
        bus_ns = self._node.clock.settled_ns() if self._in_lockstep else 0
        self.health.report(mode, self.heard_until_s, bus_ns / NANOSECONDS if bus_ns else None)

    def _log_mount(self, sensor: str, measurement: Measurement) -> None:
        """Write a mount to the log for the operator, because the data of one sensor do not show its error."""
        text = f"{sensor}: it is {in_words(measurement.T_chaser_sensor)}"
        if text not in self._mounts and len(self._mounts) < _MOST_MOUNTS:
            self._mounts.add(text)
            log.info("%s", text)

    def _put(self, sensor: str, frames: list[Assembled[Received]]) -> None:
        for frame in frames:
            if self._newest.put(sensor, frame):
                self.health.drop(sensor, time.monotonic())

    def _check_freshness(self, sensor: str, received: Received, stamp_ns: int) -> None:
        """Check a stamp against the time of arrival: the estimator's own delay does not count."""
        now_ns, clock = received.arrival_ns, self._node.clock
        if isinstance(clock, BusClock):
            earliest_ns = stamp_ns - round(self._config.max_future_s * NANOSECONDS)
            clock.await_ns(earliest_ns, _CLOCK_LAG_S, standing_s=_STANDING_S)
            now_ns = clock.now_ns()
        age_s = (now_ns - stamp_ns) / NANOSECONDS
        if age_s > (max_delay_s := self._config.filter.max_delay_s):
            stand = self._stand(received, stamp_ns)
            why = self._clocks[sensor].why_late() or clock_hint(-age_s, stamp_ns)
            why = why if stand is None else stand.text
            raise MessageRejectedError(
                Reason.LATE, f"{age_s:.3f} s old, filter.max_delay_s is {max_delay_s:g}; {why}"
            )
        if age_s < -self._config.max_future_s:
            raise MessageRejectedError(
                Reason.FUTURE,
                f"{-age_s:.3f} s ahead of {self._config.time_source} time, max_future_s is "
                f"{self._config.max_future_s:g}; {clock_hint(-age_s, stamp_ns)}",
            )

    def _stand(self, received: Received, stamp_ns: int) -> Stand | None:
        """Return the time in which this process stood still while a message waited for it; None for none.

        The arrival of such a message tells nothing about the sensor's clock, or its link.
        """
        stand = None if self._stands is None or self._in_lockstep else self._stands.look()
        if stand is None or not stand.holds_up(stamp_ns, received.arrival_s):
            return None
        if stand != self._told_stand:
            self._told_stand = stand
            log.warning("%s", stand.text)
        return stand

    def _check_step(self, sensor: str, received: Received, stamp_ns: int) -> None:
        """Check that the sensor's clock was not set since the previous frames, if its publisher is used."""
        try:
            self._holders.check(received.topic.name, received.peer, received.arrival_s)
        except SecondPublisherError:
            return
        self._clocks[sensor].check_step(received, stamp_ns)

    def _is_of_its_frames(self, part: Received, leading: Received) -> bool:
        """Return whether a part comes from the publisher of the frames, so that it is as new as its frame.

        If sessions are unknown, the part belongs to the publisher with whose frames it was used first, unless
        it arrived while another publisher sent the frames. This first use is noted here.
        """
        if part.session or leading.session:
            return part.session == leading.session
        name = part.topic.name
        _, before_s = self._leaders.get(self._reader.parts[name][0], (None, -np.inf))
        if part.arrival_s <= before_s:
            return False
        user, frames = self._used_with.get(name, (None, None))
        if user != part.peer:
            frames = leading.peer
            self._used_with[name] = part.peer, leading.peer
        return frames == leading.peer

    def _arrived(self, sensor: str, frame: Assembled[Received]) -> Arrived:
        arrival_s = max(part.arrival_s for part in frame.parts.values())
        try:
            for part in frame.parts.values():
                self._holders.check(part.topic.name, part.peer, part.arrival_s)
            arrived = self._reader.arrived(sensor, frame, arrival_s)
            leading = frame.parts[self._reader.leading[sensor]]
            for part in frame.parts.values():
                now_s = arrival_s if self._is_of_its_frames(part, leading) else part.arrival_s
                if self._kept.may_hold(part):
                    self._holders.hold(part.topic.name, part.peer, now_s)
            if arrived.measurement is not None:
                self._log_mount(sensor, arrived.measurement)
                if not self._in_lockstep and self._stand(leading, frame.stamp_ns) is None:
                    last = self._reader.last(sensor, arrived.measurement.data)
                    self._clocks[sensor].note_end(last, leading, frame.stamp_ns)
        except SecondPublisherError as error:
            return Arrived.unusable(sensor, frame.stamp_ns, error, arrival_s)
        except PartRejectedError as error:
            self._node.reject(error.topic, error)
            return Arrived.unusable(sensor, frame.stamp_ns, error, arrival_s)
        moved_s = self._clocks[sensor].take_correction_s()
        return replace(arrived, clock_moved_s=moved_s) if moved_s else arrived
