"""Readings that accompany the sensors' frames, received from the bus up to each frame's stamp."""

import logging
import time
from abc import ABC, abstractmethod
from typing import Generic, Protocol, TypeVar

from rpod_runtime import Inbox, Node, Received
from rpod_runtime.delivery.holders import Holders
from rpod_runtime.sensor_data.stamp_watch import clock_hint
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.rmw.cdr import NANOSECONDS, peek_stamp
from rpod_schemas.topics import Topic

log = logging.getLogger(__name__)

_LOCKSTEP_S = 5.0
"""Longest wait in lockstep, where readings are sent before the frame and a machine may be loaded."""
_WAITING = 8192
_MOST_AHEAD_S = 1.0
"""Largest time by which a reading's stamp may be ahead of the wall clock: no clock that is kept is worse."""


class Track(Protocol):
    """Readings of one topic over time."""

    def covers(self, stamp_ns: int) -> bool:
        """Return whether all readings up to a stamp have arrived."""
        ...


TrackT = TypeVar("TrackT", bound=Track)


class StampedInput(ABC, Generic[TrackT]):
    """Receives readings, waits until a frame's stamp is covered, and reports missing readings.

    Args:
        node: the estimator's node.
        tracks: where the readings of each topic go.
        in_lockstep: whether the estimator follows the clock of a lockstep run.
    """

    name: str
    """Name in the diagnostics."""
    lack: str
    """Name of the counter of frames for which readings are missing."""
    late_s: float
    """Longest wait for readings up to a frame's stamp, by the wall clock; usually they take a few ms."""
    alarm: str
    """Message for the operator if readings of ``{topics}`` are missing."""
    again: str
    """Line in the log when all readings arrive again."""

    def __init__(self, node: Node, tracks: dict[Topic, TrackT], *, in_lockstep: bool) -> None:
        self._node = node
        self._tracks = {topic.name: track for topic, track in tracks.items()}
        self._in_lockstep, self._wait_s = in_lockstep, _LOCKSTEP_S if in_lockstep else self.late_s
        self._inbox, self._holders = Inbox(_WAITING), Holders()
        self._missing: tuple[str, ...] = ()
        for topic in tracks:
            node.subscribe(topic, self._inbox.put, recover=in_lockstep)

    @abstractmethod
    def use(self, track: TrackT, received: Received) -> bool:
        """Add a reading and return True; return False if it is not newer than all before.

        Raises:
            MessageRejectedError: the reading cannot be used.
        """

    def is_known(self, track: TrackT, stamp_ns: int) -> bool:
        """Return whether the readings suffice for a stamp."""
        return track.covers(stamp_ns)

    def take_in(self) -> None:
        """Process the readings that have arrived, without waiting; a coasting track needs them."""
        if self._tracks:
            self._take(self._inbox.wait(0.0))

    def take_until(self, stamp_ns: int) -> None:
        """Process the readings that have arrived, and wait shortly for readings up to a frame's stamp.

        After one wait without a result, later frames do not wait until readings arrive again.
        """
        if not self._tracks:
            return
        self._take(self._inbox.wait(0.0))
        ends_s = time.monotonic() + (0.0 if self._missing else self._wait_s)
        while not all(track.covers(stamp_ns) for track in self._tracks.values()) and (
            (left_s := ends_s - time.monotonic()) > 0.0
        ):
            self._take(self._inbox.wait(left_s))
        self._report_missing(
            tuple(name for name, track in self._tracks.items() if not self.is_known(track, stamp_ns))
        )

    def _take(self, messages: list[Received]) -> None:
        for received in messages:
            name = received.topic.name
            try:
                self._check_future(received)
                self._holders.check(name, received.peer, received.arrival_s)
                if not self.use(self._tracks[name], received):
                    raise MessageRejectedError(
                        Reason.DUPLICATE, "a reading with this stamp or a newer one is already in use"
                    )
                self._holders.hold(name, received.peer, received.arrival_s)
            except MessageRejectedError as error:
                self._node.reject(name, error)
        self._node.health.put(f"overflowed/{self.name}", self._inbox.overflowed)

    def _check_future(self, received: Received) -> None:
        """Check that a stamp is not ahead of the wall clock: later readings would count as older ones."""
        if self._in_lockstep:
            return
        stamp_ns = peek_stamp(received.payload)
        ahead_s = (stamp_ns - received.arrival_ns) / NANOSECONDS
        if ahead_s > _MOST_AHEAD_S:
            raise MessageRejectedError(
                Reason.FUTURE, f"{ahead_s:.3f} s ahead of the wall clock; {clock_hint(ahead_s, stamp_ns)}"
            )

    def _report_missing(self, missing: tuple[str, ...]) -> None:
        """Report when readings begin to be missing, and when they arrive again."""
        if missing:
            self._node.health.count(f"{self.name}/{self.lack}")
        if missing == self._missing:
            return
        self._missing = missing
        text = self.alarm.format(topics=", ".join(missing))
        self._node.health.alarm(self.name, text if missing else "")
        log.log(logging.WARNING if missing else logging.INFO, "%s", text if missing else self.again)
