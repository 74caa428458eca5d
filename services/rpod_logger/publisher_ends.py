"""Checks whether publishers that ended had sent their last numbers, and whether these messages arrived.

A gap in sequence numbers shows a loss only when a later message comes. After the last message of a publisher
none comes. So services say in their diagnostics how many messages they have published, and which of their
diagnostics is the last one. A service whose liveliness token vanishes without this last message was killed,
or lost its link: nobody knows its last number.

The module knows no bus and no clock. Times are seconds of one monotonic clock, stamps ns of UTC. Its memory
is bounded.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from threading import Lock
from typing import NamedTuple

from rpod_runtime import Received
from rpod_runtime.bus.link import Link, Outage, utc
from rpod_runtime.process.awake import AwakeTime
from rpod_schemas.control import StatusReply
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_diagnostics
from rpod_schemas.topics import DIAGNOSTICS, Topic
from rpod_schemas.types import CLOSING, PUBLISHED

GRACE_S = 1.0
"""Time, s, after which a message that has not arrived counts as lost; only the time counts in which this
process was awake. Publishers stay open for 0.3 s after their last message and tell its number each 0.2 s, so
that a receiver without it can ask for it."""
RETURN_S = 10.0
"""Time after an outage in which publishers come back, s, counted as the grace is: Zenoh tries at least each
4 s."""
_JUDGEMENT_S = 0.5
"""Longest time between two decisions, of which there are four a second, unless this process stands still, s.
Messages that arrived while it stood still are not handled yet, and have at least half of the grace left for
this."""
_OUTAGE_S = 1.0
"""Largest time between the end of a token and the loss of the link for which the link is taken as the cause,
s."""
_MOST_SESSIONS, _MOST_TOPICS, _MOST_GIDS, _MOST_NOTES = 1000, 1000, 64, 100
_NS = 1e-9


@dataclass(frozen=True)
class Endings:
    """Records of a file about publishers and the link, beside its counts."""

    reasons: tuple[str, ...] = ()
    """Reasons why the file is not complete, a sentence each."""
    unconfirmed: tuple[str, ...] = ()
    """Publishers that ended and do not say their last number, a sentence each: those of other software."""
    outages: tuple[Outage, ...] = ()
    """Times without a link while the file was open."""


class _Gone(NamedTuple):
    """Time at which a publisher's liveliness token vanished."""

    awake_s: float
    """Time in which this process was awake until then, s."""
    stamp_ns: int
    """The same moment, ns of UTC."""


@dataclass
class _Session:
    """One process on the bus."""

    instance: str = ""
    """Name of the service; empty for a process that sends no diagnostics of ours."""
    gid: bytes = b""
    first: dict[str, int] = field(default_factory=dict)
    """Numbers of published messages in the first diagnostics, by topic."""
    said: dict[str, int] = field(default_factory=dict)
    """The newest numbers of published messages, by topic."""
    reported_s: float = 0.0
    """Time of the newest numbers."""
    closing: bool = False
    arrived: dict[str, dict[bytes, int]] = field(default_factory=dict)
    """Last number that arrived, by topic and gid."""
    topics: set[str] = field(default_factory=set)
    """Recorded topics of which it has, or had, a publisher."""
    left: dict[str, _Gone] = field(default_factory=dict)
    """Time at which the publisher of a topic was gone."""
    told: dict[str, int] = field(default_factory=dict)
    """Number of messages by topic that an earlier file says are missing."""

    @property
    def gone(self) -> _Gone | None:
        """Time at which the service was gone; None if it is there."""
        return self.left.get(DIAGNOSTICS.name) if self.instance else None

    @property
    def is_there(self) -> bool:
        """Whether it is a service that has not ended."""
        return bool(self.instance) and DIAGNOSTICS.name in self.topics and self.gone is None

    def last(self, topic: str) -> int:
        """Return the number of messages of a topic up to the last one that arrived."""
        return sum(self.arrived.get(topic, {}).values())

    def shortfalls(self) -> list[str]:
        """Return what has not arrived of what was published, by topic."""
        found = []
        for topic in sorted(self.topics - {DIAGNOSTICS.name}):  # the last diagnostics arrived by themselves
            said, last = self.said.get(topic, 0), self.last(topic)
            before_the_logger = not last and said <= self.first.get(topic, 0)
            if last + self.told.get(topic, 0) < said and not before_the_logger:
                found.append(f"{topic}: {said} published, {last} arrived")
        return found


class PublisherEnds:
    """Follows publishers until they end. Safe to use from several threads."""

    def __init__(self, recorded: Callable[[Topic], bool], link: Link, *, own: str) -> None:
        self._recorded, self._link, self._own = recorded, link, own
        self._lock = Lock()
        self._sessions: dict[str, _Session] = {}
        self._forgotten = 0
        self._awake = AwakeTime(_JUDGEMENT_S)
        self._regained: tuple[int, float] = (0, float("-inf"))
        """When the last outage ended, ns of UTC, and the time in which this process was awake until then."""
        self._reasons: list[str] = []
        self._unconfirmed: list[str] = []

    # --- what the bus tells ---

    def receive(self, received: Received) -> None:
        """Note a message."""
        if not received.session or received.session == self._own:
            return
        name, gid = received.topic.name, received.attachment.gid
        with self._lock:
            session = self._session(received.session)
            by_gid = session.arrived.setdefault(name, {})
            if gid in by_gid or len(by_gid) < _MOST_GIDS:
                by_gid[gid] = received.attachment.sequence
            if name == DIAGNOSTICS.name:
                self._take_numbers(session, received)

    def came(self, name: str, topic: Topic) -> None:
        """Note the liveliness token of a publisher, by the Zenoh identity of its session."""
        if name == self._own or not self._recorded(topic):
            return
        with self._lock:
            session = self._session(name)
            session.left.pop(topic.name, None)
            if len(session.topics) < _MOST_TOPICS:
                session.topics.add(topic.name)

    def gone(self, name: str, topic: Topic, *, now_s: float, now_ns: int) -> None:
        """Note that the token of a publisher is gone."""
        with self._lock:
            session = self._sessions.get(name)
            if session is not None and topic.name in session.topics:
                session.left[topic.name] = _Gone(self._awake.at(now_s), now_ns)

    def confirm(self, statuses: Iterable[StatusReply], *, now_s: float) -> None:
        """Note the answers of services; each holds its numbers as its diagnostics do."""
        with self._lock:
            for status in statuses:
                named = [each for each in self._sessions.values() if each.instance == status.name]
                there = [each for each in named if each.is_there]
                if len(there) == 1:
                    self._say(there[0], status.counters, now_s)

    def _session(self, name: str) -> _Session:
        if name not in self._sessions and len(self._sessions) >= _MOST_SESSIONS:
            known = iter(self._sessions)
            others = (each for each in self._sessions if not self._sessions[each].instance)
            oldest = self._sessions.pop(next(others, next(known)))
            self._forgotten += bool(oldest.instance or oldest.topics)
        return self._sessions.setdefault(name, _Session())

    def _take_numbers(self, session: _Session, received: Received) -> None:
        try:
            diagnostics = read_diagnostics(received.decode())
        except MessageRejectedError:
            return
        for diagnostic in diagnostics[:1]:  # a service of ours sends one
            counters = {name: int(text) for name, text in diagnostic.values.items() if text.isdecimal()}
            if any(name.startswith(PUBLISHED) for name in counters):
                session.instance, session.gid = diagnostic.name, received.attachment.gid
                session.closing = diagnostic.values.get(CLOSING) == "true"
                self._say(session, counters, received.arrival_s)

    def _say(self, session: _Session, counters: dict[str, int], now_s: float) -> None:
        numbers = {
            name.removeprefix(PUBLISHED): n for name, n in counters.items() if name.startswith(PUBLISHED)
        }
        session.said = {name: numbers[name] for name in sorted(numbers)[:_MOST_TOPICS]}
        session.first = session.first or dict(session.said)
        session.reported_s = now_s

    # --- what follows from it ---

    def decide(self, now_s: float) -> None:
        """Decide about the publishers that are gone and of which nothing comes any more."""
        with self._lock:
            self._note_link(self._awake.at(now_s))  # in each turn: a pause of this process is a short time
            for name, session in list(self._sessions.items()):
                if session.instance:
                    self._decide_service(name, session, now_s)
                else:
                    self._decide_others(name, session, now_s)
            del self._reasons[_MOST_NOTES:], self._unconfirmed[_MOST_NOTES:]

    def _decide_service(self, name: str, session: _Session, now_s: float) -> None:
        if session.gone is None:
            return
        if session.closing and not session.shortfalls():
            del self._sessions[name]
        elif self._is_final(session.gone, now_s):
            self._reasons.append(_incomplete_at_end(name, session, session.gone.stamp_ns))
            del self._sessions[name]

    def _decide_others(self, name: str, session: _Session, now_s: float) -> None:
        for topic, gone in list(session.left.items()):
            if self._is_final(gone, now_s):
                last = max(session.arrived.get(topic, {}).values(), default=0)
                self._unconfirmed.append(
                    f"{topic}: a publisher of session {name} ended at {utc(gone.stamp_ns)} and does not "
                    f"say its last number; the last that arrived is {last}"
                )
                del session.left[topic]
                session.topics.discard(topic)
                if not session.topics:
                    del self._sessions[name]

    def _is_final(self, gone: _Gone, now_s: float) -> bool:
        """Return whether a publisher that is gone has had the time to come back, and its messages to come."""
        awake_s = self._awake.at(now_s)
        if self._left_with_link(gone.stamp_ns):
            return not self._link.lost and awake_s - self._regained[1] > RETURN_S
        return awake_s - gone.awake_s > GRACE_S

    def _note_link(self, awake_s: float) -> None:
        for outage in self._link.outages()[-1:]:
            if outage.end_ns is not None and outage.end_ns != self._regained[0]:
                self._regained = outage.end_ns, awake_s

    def _left_with_link(self, gone_ns: int) -> bool:
        return any(abs(gone_ns - outage.begin_ns) * _NS < _OUTAGE_S for outage in self._link.outages())

    def is_open(self, since_s: float) -> bool:
        """Return whether something may still arrive that decides about a publisher.

        Args:
            since_s: time since which each service that is there should have reported its numbers.
        """
        if self._link.lost:
            return False
        with self._lock:
            return any(self._waits_for(session, since_s) for session in self._sessions.values())

    def _waits_for(self, session: _Session, since_s: float) -> bool:
        if session.gone is not None:
            # a service that was lost with the link may be away for long
            return not self._left_with_link(session.gone.stamp_ns)
        silent = session.reported_s < since_s and not session.closing
        return session.is_there and (silent or bool(session.shortfalls()))

    def conclude(self, since_s: float) -> None:
        """Add the reasons that follow from services that are still there, when a file is closed.

        Args:
            since_s: time since which each service that is there should have reported its numbers.
        """
        with self._lock:
            for name, session in list(self._sessions.items()):
                if reason := _incomplete_at_close(name, session, since_s):
                    self._reasons.append(reason)
                    session.told = {topic: n - session.last(topic) for topic, n in session.said.items()}
                if session.gone is not None:
                    del self._sessions[name]

    def add_reason(self, reason: str) -> None:
        """Add a reason why the file that is open is not complete."""
        with self._lock:
            self._reasons.append(reason)

    def take(self, since_ns: int) -> Endings:
        """Return the records for a file that was opened at a stamp, and forget them."""
        outages = self._link.outages(since_ns)
        with self._lock:
            reasons = [f"the bus was lost: {outage}" for outage in outages] + self._reasons
            if self._forgotten:
                reasons.append(
                    f"the ends of {self._forgotten} of more than {_MOST_SESSIONS} sessions are not known"
                )
            endings = Endings(tuple(reasons), tuple(self._unconfirmed), outages)
            self._reasons, self._unconfirmed, self._forgotten = [], [], 0
        return endings


def _who(name: str, session: _Session) -> str:
    return f"{session.instance} (session {name}, gid {session.gid.hex()})"


def _incomplete_at_close(name: str, session: _Session, since_s: float) -> str:
    """Return why the last numbers of a service are not known when a file is closed; empty if they are."""
    if session.gone is not None:
        return (
            f"{_who(name, session)} was there until {utc(session.gone.stamp_ns)} and has not come back since"
        )
    if not session.is_there:
        return ""
    if session.reported_s < since_s and not session.closing:
        return f"{_who(name, session)} did not answer at the close: its last numbers are not known"
    missing = session.shortfalls()
    return f"{_who(name, session)}, at the close: {'; '.join(missing)}" if missing else ""


def _incomplete_at_end(name: str, session: _Session, gone_ns: int) -> str:
    """Return the sentence about a service that ended without its last messages."""
    text = f"{_who(name, session)} ended at {utc(gone_ns)}"
    if not session.closing:
        text += " without saying its last numbers: it was killed or lost its link"
    return "; ".join([text, *session.shortfalls()])
