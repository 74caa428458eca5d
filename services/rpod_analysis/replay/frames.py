"""Sensor data of a log as input of an estimator: in the order of arrival, or as the live run used them."""

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from rpod_analysis.log import Logged
from rpod_analysis.log.sensors import as_received
from rpod_analysis.log.unreadable import StampCheck
from rpod_estimator.frame_reader import Arrived, FrameReader
from rpod_pose.measurement import Tick
from rpod_runtime import Received
from rpod_runtime.assembler import Assembled
from rpod_runtime.frames import PartRejectedError
from rpod_schemas.cdr import NANOSECONDS, peek_stamp
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_status
from rpod_schemas.types import EstimatorStatus

_BY_ARRIVAL = tuple(f"{reason}:" for reason in (Reason.LATE, Reason.FUTURE, Reason.DUPLICATE))
"""Why a live run refused a frame before it looked at it: what only that run can know."""
_PATIENCE_NS = NANOSECONDS
"""Largest delay between the arrival of a status and that of its frame."""
_MOST_WAITING = 64
"""Frames whose status has not come yet; older ones were passed over."""

Event = Arrived | Tick
"""Input of the estimator."""


@dataclass
class Frames:
    """Takes a log's messages one by one, and returns what they make the estimator do.

    A log may be old, or of another clock: only stamps that differ by days from the log's others are refused.
    Other messages do nothing.
    """

    intake: FrameReader
    stamps: StampCheck | None = None
    """Tells stamps that cannot be of the log; without it none is judged."""
    refused: Counter[str] = field(default_factory=Counter)
    """Messages that could not be used, by topic."""
    missing: int = 0
    """Frames that a live run took and the log has not."""

    def __post_init__(self) -> None:
        self._latched = {topic.name for topic in self.intake.latched}

    def take(self, logged: Logged) -> list[Event]:
        """Take a message; return the frames that are complete with it, oldest first."""
        return [self._arrived(sensor, frame) for sensor, frame in self._complete(logged)]

    def rest(self) -> list[Event]:
        """Return the frames that wait for an optional part in vain."""
        return [
            self._arrived(sensor, frame)
            for sensor, assembler in self.intake.assemblers.items()
            for frame in assembler.release()
        ]

    def _complete(self, logged: Logged) -> Iterator[tuple[str, Assembled[Received]]]:
        received = as_received(logged)
        try:
            if part := self.intake.parts.get(logged.topic):
                sensor, name = part
                stamp_ns = peek_stamp(received.payload)
                if self.stamps is not None:
                    self.stamps.check(logged, stamp_ns)
                for frame in self.intake.assemblers[sensor].add(name, stamp_ns, received):
                    yield sensor, frame
            elif logged.topic in self._latched:
                self.intake.learn(received)
        except MessageRejectedError:
            self.refused[logged.topic] += 1

    def _arrived(self, sensor: str, frame: Assembled[Received]) -> Arrived:
        try:
            return Arrived(sensor, frame.stamp_ns, 0.0, self.intake.measurement(sensor, frame))
        except PartRejectedError as error:
            self.refused[error.topic] += 1
            return Arrived(sensor, frame.stamp_ns, 0.0, None, str(error))


@dataclass
class FramesAsLive(Frames):
    """Frames of the live run only, in its order: those that its status messages name."""

    status_topic: str = ""
    _waiting: dict[tuple[str, int], Assembled[Received]] = field(default_factory=dict)
    _due: deque[tuple[int, EstimatorStatus]] = field(default_factory=deque)

    def take(self, logged: Logged) -> list[Event]:
        """Take a message; return what the live run did once it had it."""
        if logged.topic == self.status_topic:
            with suppress(MessageRejectedError):
                self._due.append((logged.log_ns, read_status(logged.decode())))
        for sensor, frame in self._complete(logged):
            self._waiting[sensor, frame.stamp_ns] = frame
        return list(self._events(logged.log_ns - _PATIENCE_NS))

    def rest(self) -> list[Event]:
        """Return what the last statuses name."""
        for sensor, assembler in self.intake.assemblers.items():
            self._waiting |= {(sensor, frame.stamp_ns): frame for frame in assembler.release()}
        return list(self._events(None))

    def _events(self, given_up_ns: int | None) -> Iterator[Event]:
        """Yield what is due; a frame that has not come once its status is that old is missing."""
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
        if status.reason.startswith(_BY_ARRIVAL):
            return Arrived(status.sensor, status.stamp_ns, 0.0, None, status.reason)
        return None if frame is None else self._arrived(status.sensor, frame)
