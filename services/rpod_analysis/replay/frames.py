"""Sensor data of a log as input of an estimator, in the order of arrival or as the live run used them."""

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace

from rpod_analysis.log import Logged
from rpod_analysis.log.sensors import as_received
from rpod_analysis.log.stamp_check import StampCheck
from rpod_analysis.replay.holders import LoggedHolders
from rpod_estimator.frame_reader import Arrived, FrameReader
from rpod_pose.measurement import Tick
from rpod_pose.navigation.integrity.wrong_streams import CLOCK_MOVED_S
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.frames import PartRejectedError
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_status
from rpod_schemas.rmw.cdr import NANOSECONDS
from rpod_schemas.types import EstimatorStatus

_ARRIVALS = Reason.LATE, Reason.FUTURE, Reason.CLOCK_STEP, Reason.DUPLICATE, Reason.SECOND_PUBLISHER
_BY_ARRIVAL = tuple(f"{reason}:" for reason in _ARRIVALS)
"""Reasons for which a live run refused a frame by its time of arrival, which only that run can know."""
_PATIENCE_NS = NANOSECONDS
"""Largest delay between the arrival of a status and that of its frame."""
_MOST_WAITING = 64
"""Largest number of frames that wait for their status; older ones were dropped by the live run."""

Event = Arrived | Tick
"""Input of the estimator."""


@dataclass
class Frames:
    """Converts a log's messages, one by one, to inputs of the estimator.

    A log may be old, or use another clock: only stamps that differ by days from the log's other stamps are
    refused. Messages of other topics are ignored.
    """

    reader: FrameReader
    stamps: StampCheck | None = None
    """Check that finds stamps that cannot belong to the log; None for no check."""
    holders: LoggedHolders | None = None
    """Which publisher of a topic is used where there are several; None for all."""
    refused: Counter[str] = field(default_factory=Counter)
    """Number of messages that could not be used, by topic."""
    missing: int = 0
    """Number of frames that the live run used and that are not in the log."""

    def __post_init__(self) -> None:
        self._latched = {topic.name for topic in self.reader.latched}

    def take(self, logged: Logged) -> list[Event]:
        """Process a message; return the frames that it completes, oldest first."""
        events: list[Event] = []
        for sensor, frame in self._complete(logged):
            events += self._held(sensor, frame)
        self._let_leave(logged)
        return events

    def _held(self, sensor: str, frame: Assembled[Received]) -> list[Event]:
        """Return a frame as an input of the estimator; nothing if another publisher holds its topics."""
        if self.holders is not None and not self.holders.allows(frame):
            return []
        return [self._held_by_its_publishers(sensor, frame)]

    def _held_by_its_publishers(self, sensor: str, frame: Assembled[Received]) -> Arrived:
        """Return a frame, whose publishers hold their topics from now on if it is valid."""
        arrived = self._arrived(sensor, frame)
        if self.holders is not None and arrived.measurement is not None:
            self.holders.hold(frame, self.reader.leading[sensor])
        return arrived

    def _let_leave(self, logged: Logged) -> None:
        """Release the topics of the publishers that have ended with this message."""
        session = self.holders.ended(as_received(logged)) if self.holders else ""
        for topic in self.reader.latched if session else ():
            self.reader.leave(session, topic)

    def reset(self, keep_gid: str | None) -> None:
        """Accept publishers and sensors as they are now, as a live estimator does at a reset."""
        keep = self.holders.release(keep_gid) if self.holders else ""
        self.reader.forget(keep=keep)

    def rest(self) -> list[Event]:
        """Return the frames that still wait for an optional part at the end of the log."""
        return [
            self._arrived(sensor, frame)
            for sensor, assembler in self.reader.assemblers.items()
            for frame in assembler.release()
        ]

    def _complete(self, logged: Logged) -> Iterator[tuple[str, Assembled[Received]]]:
        received = as_received(logged)
        try:
            if part := self.reader.parts.get(logged.topic):
                sensor, name = part
                stamp_ns = self.reader.stamp_ns(sensor, received)
                if self.stamps is not None:
                    self.stamps.check(logged, stamp_ns)
                for each, message in self._admitted(sensor, name, received):
                    for frame in self.reader.assemblers[sensor].add(each, stamp_ns, message):
                        yield sensor, frame
            elif logged.topic in self._latched:
                self.reader.learn(received)
        except MessageRejectedError:
            self.refused[logged.topic] += 1

    def _admitted(self, sensor: str, part: str, received: Received) -> Iterator[tuple[str, Received]]:
        """Yield a part of a frame if its publisher may be used, after kept messages that count from it on."""
        if self.holders is None:
            yield part, received
        elif self.holders.admit(received, lasts=self.reader.lasting(received.topic)):
            if part == self.reader.leading[sensor]:
                yield from self.reader.due(sensor, self.holders.kept, received)
            yield part, received

    def _arrived(self, sensor: str, frame: Assembled[Received]) -> Arrived:
        try:
            return self.reader.arrived(sensor, frame, 0.0)
        except PartRejectedError as error:
            self.refused[error.topic] += 1
            return Arrived.unusable(sensor, frame.stamp_ns, error)


@dataclass
class FramesAsLive(Frames):
    """Converts only the frames of the live run, which its status messages name, in its order."""

    status_topic: str = ""
    _waiting: dict[tuple[str, int], Assembled[Received]] = field(default_factory=dict)
    _due: deque[tuple[int, EstimatorStatus]] = field(default_factory=deque)

    def take(self, logged: Logged) -> list[Event]:
        """Process a message; return the inputs that the live run used after it."""
        if logged.topic == self.status_topic:
            with suppress(MessageRejectedError):
                self._due.append((logged.log_ns, read_status(logged.decode())))
        for sensor, frame in self._complete(logged):
            self._waiting[sensor, frame.stamp_ns] = frame
        self._let_leave(logged)
        return list(self._events(logged.log_ns - _PATIENCE_NS))

    def rest(self) -> list[Event]:
        """Return the inputs that the last statuses name."""
        for sensor, assembler in self.reader.assemblers.items():
            self._waiting |= {(sensor, frame.stamp_ns): frame for frame in assembler.release()}
        return list(self._events(None))

    def _events(self, given_up_ns: int | None) -> Iterator[Event]:
        """Yield the due inputs; a frame is missing if its status arrived before ``given_up_ns``."""
        while self._due:
            log_ns, status = self._due[0]
            frame = self._waiting.pop((status.sensor, status.stamp_ns), None)
            event = self._event(status, frame)
            if event is None:
                if given_up_ns is not None and log_ns > given_up_ns:
                    break
                self.missing += 1
            else:
                yield event
            self._due.popleft()
        while len(self._waiting) > _MOST_WAITING:
            self._waiting.pop(next(iter(self._waiting)))

    def _event(self, status: EstimatorStatus, frame: Assembled[Received] | None) -> Event | None:
        if not status.sensor:
            return Tick(status.stamp_ns)
        moved_s = status.evidence.get(CLOCK_MOVED_S, 0.0)
        if status.reason.startswith(_BY_ARRIVAL):
            return Arrived(status.sensor, status.stamp_ns, 0.0, None, status.reason, clock_moved_s=moved_s)
        if frame is None:
            return None
        arrived = self._held_by_its_publishers(status.sensor, frame)
        return replace(arrived, evidence=status.evidence, clock_moved_s=moved_s)
