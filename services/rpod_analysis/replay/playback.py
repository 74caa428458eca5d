"""Publishes a log on the bus: the recorded bytes at their recorded times.

For a receiver whose time comes from ``clock`` it is equivalent to the sensors: keys, attachments, latched
topics and stamps are the same.
"""

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from threading import Event

import zenoh

from rpod_analysis.errors import NothingToPlayError
from rpod_analysis.log import Log, Logged
from rpod_analysis.replay.timeline import Timeline
from rpod_runtime import Node
from rpod_runtime.delivery.publisher import Publisher
from rpod_schemas.messages import write_clock
from rpod_schemas.rmw.cdr import NANOSECONDS, begins_with_stamp, is_known, restamped
from rpod_schemas.topics import CLOCK, DIAGNOSTICS, PARAMETER_EVENTS, ROSOUT, STATUS, TF, Topic, is_latched

_CLOCK_PERIOD_NS = NANOSECONDS // 250
_BETWEEN_LAPS_NS = NANOSECONDS // 10
_SETTLE_S = 0.3
"""Wait before the first message and after the last, so that subscribers find the publishers and recover
missed messages."""


@dataclass(frozen=True)
class Playback:
    """Options of a playback."""

    speed: float = 1.0
    """Speed relative to the recording."""
    start_s: float = 0.0
    """Beginning, s after the log's first message."""
    end_s: float | None = None
    """End, s after the log's first message; None for the end of the log."""
    loop: bool = False
    """Whether to start again at the end; stamps and clock continue to rise."""
    topics: tuple[str, ...] = ()
    """Patterns such as ``pmd/*``; by default all topics except those of estimators and services, tf and
    clock."""
    clock: bool = True
    """Whether ``clock`` is published."""


@dataclass
class Played:
    """Result of a playback."""

    messages: Counter[str] = field(default_factory=Counter)
    """Number of messages by topic."""
    left_out: tuple[str, ...] = ()
    """Requested topics whose message type is not known, or whose name no key can have."""
    laps: int = 0
    """Number of times that the end was reached."""
    behind_s: float = 0.0
    """Largest delay of a message, s."""


def play(log: Log, node: Node, playback: Playback, *, stop: Event) -> Played:
    """Publish a log's messages as they were recorded, until its end or until stopped.

    Raises:
        NothingToPlayError: no topic of a known type matches.
        DamagedLogError: the log has damaged bytes in this part.
    """
    return _Player(log, node, playback, stop).play()


def chosen_topics(log: Log, patterns: tuple[str, ...] = ()) -> list[str]:
    """Return the topics that are played; without patterns those of sensors, truth and environment."""
    if patterns:
        return [name for name in log.topics if any(fnmatchcase(name, pattern) for pattern in patterns)]
    estimators = {
        name.rsplit("/", 1)[0] + "/" for name, info in log.topics.items() if info.type == STATUS.type
    }
    others = {DIAGNOSTICS.name, ROSOUT.name, PARAMETER_EVENTS.name, TF.name}
    return [name for name in log.topics if name not in others and not name.startswith(tuple(estimators))]


class _Player:
    def __init__(self, log: Log, node: Node, playback: Playback, stop: Event) -> None:
        self._log, self._playback, self._stop = log, playback, stop
        self._timeline = Timeline(log)
        self._played = Played()
        names = [name for name in chosen_topics(log, playback.topics) if name != CLOCK.name]
        self._publishers: dict[str, Publisher] = {}
        for name in names:
            if is_known(log.topics[name].type):
                with suppress(zenoh.ZError):  # a name that no key can have
                    topic = Topic(name, log.topics[name].type, is_latched(name))
                    self._publishers[name] = node.publisher(topic)
        if not self._publishers:
            raise NothingToPlayError(log.paths[0], playback.topics)
        self._played.left_out = tuple(name for name in names if name not in self._publishers)
        self._clock: Publisher | None = node.publisher(CLOCK) if playback.clock else None
        self._clock_ns = 0

    def play(self) -> Played:
        begin_ns = self._timeline.begin(self._playback.start_s)
        self._stop.wait(_SETTLE_S)
        self._announce(begin_ns)
        started_s, shift_ns = time.monotonic(), 0
        while not self._stop.is_set():
            played = False
            for logged, now_ns in self._timed(begin_ns):
                played = True
                elapsed_s = (now_ns + shift_ns - begin_ns) / NANOSECONDS / self._playback.speed
                if self._wait_until(started_s + elapsed_s):
                    break
                self._publish(logged, now_ns, shift_ns)
            self._played.laps += not self._stop.is_set()
            shift_ns += self._timeline.now_ns - begin_ns + _BETWEEN_LAPS_NS
            if not self._playback.loop or not played:
                break
        self._stop.wait(_SETTLE_S)
        return self._played

    def _announce(self, begin_ns: int) -> None:
        """Publish the time, and the messages that were latched before the beginning."""
        self._tell_time(begin_ns)
        latched = [name for name in self._publishers if is_latched(name)]
        newest: dict[tuple[str, bytes], Logged] = {}
        for logged in (
            self._log.messages(*latched, end_ns=self._timeline.arrival_of(begin_ns)) if latched else ()
        ):
            newest[logged.topic, logged.payload] = logged  # each of several sensors latches its own tf_static
        for logged in newest.values():
            self._send(logged, 0)

    def _timed(self, begin_ns: int) -> Iterator[tuple[Logged, int]]:
        """Yield messages with their time, from the beginning to the end."""
        end_s, timeline = self._playback.end_s, self._timeline
        end_ns = None if end_s is None else timeline.at(end_s)
        timeline.now_ns = begin_ns
        names = [*self._publishers, *([CLOCK.name] if timeline.recorded else [])]
        for logged in self._log.messages(*names, start_ns=timeline.arrival_of(begin_ns)):
            now_ns = timeline.advance(logged)
            if end_ns is not None and now_ns >= end_ns:
                return
            yield logged, now_ns

    def _wait_until(self, due_s: float) -> bool:
        """Wait until a message is due; return whether the playback was stopped."""
        ahead_s = due_s - time.monotonic()
        self._played.behind_s = max(self._played.behind_s, -ahead_s)
        return self._stop.wait(ahead_s) if ahead_s > 0 else self._stop.is_set()

    def _publish(self, logged: Logged, now_ns: int, shift_ns: int) -> None:
        if logged.topic == CLOCK.name or now_ns + shift_ns - self._clock_ns >= _CLOCK_PERIOD_NS:
            self._tell_time(now_ns + shift_ns)
        if logged.topic != CLOCK.name and not (shift_ns and is_latched(logged.topic)):
            self._send(logged, shift_ns)

    def _tell_time(self, now_ns: int) -> None:
        if self._clock is not None and now_ns > self._clock_ns:
            self._clock.publish(write_clock(now_ns))
            self._clock_ns = now_ns

    def _send(self, logged: Logged, shift_ns: int) -> None:
        moved = shift_ns and begins_with_stamp(logged.type)
        with self._log.unreadable.left_out(logged):
            payload = restamped(logged.payload, shift_ns) if moved else logged.payload
            self._publishers[logged.topic].put(payload)
            self._played.messages[logged.topic] += 1
