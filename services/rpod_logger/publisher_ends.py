"""Checks whether publishers that ended had sent their last numbers, and whether these messages arrived.

A gap in sequence numbers shows a loss only when a later message comes. After the last message of a publisher
none comes. So services say in their diagnostics how many messages they have published, and which of their
diagnostics is the last one. A service whose liveliness token vanishes without this last message was killed,
or lost its link: nobody knows its last number.

The module knows no bus and no clock. Times are seconds of one monotonic clock, stamps ns of UTC. Its memory
is bounded.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from threading import Lock

from rpod_logger.bus_process import BusProcess, Departure
from rpod_runtime import Received
from rpod_runtime.bus.link import Link, Outage
from rpod_runtime.process.awake import AwakeTime
from rpod_schemas.control import StatusReply
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_diagnostics
from rpod_schemas.topics import DIAGNOSTICS, Topic

GRACE_S = 1.0
"""Time, s, after which a message that has not arrived counts as lost; only the time counts in which this
process was awake. Publishers stay open for 0.3 s after their last message and state its number each 0.2 s, so
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
_MOST_PROCESSES, _MOST_NOTES = 1000, 100
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


class PublisherEnds:
    """Follows publishers until they end. Safe to use from several threads."""

    def __init__(self, recorded: Callable[[Topic], bool], link: Link, *, own: str) -> None:
        self._recorded, self._link, self._own = recorded, link, own
        self._lock = Lock()
        self._processes: dict[str, BusProcess] = {}
        """Processes by the Zenoh identity of their session."""
        self._forgotten = 0
        self._awake = AwakeTime(_JUDGEMENT_S)
        self._regained: tuple[int, float] = (0, float("-inf"))
        """When the last outage ended, ns of UTC, and the time in which this process was awake until then."""
        self._reasons: list[str] = []
        self._unconfirmed: list[str] = []

    # --- from the bus ---

    def receive(self, received: Received) -> None:
        """Note a message."""
        if not received.session or received.session == self._own:
            return
        with self._lock:
            process = self._process(received.session)
            process.note_message(received)
            if received.topic.name == DIAGNOSTICS.name:
                _take_diagnostics(process, received)

    def came(self, session: str, topic: Topic) -> None:
        """Note the liveliness token of a publisher, by the Zenoh identity of its session."""
        if session != self._own and self._recorded(topic):
            with self._lock:
                self._process(session).note_publisher(topic.name)

    def gone(self, session: str, topic: Topic, *, now_s: float, now_ns: int) -> None:
        """Note that the token of a publisher is gone."""
        with self._lock:
            if session in self._processes:
                departure = Departure(self._awake.at(now_s), now_ns)
                self._processes[session].note_departure(topic.name, departure)

    def confirm(self, statuses: Iterable[StatusReply], *, now_s: float) -> None:
        """Note the answers of services; each holds its numbers as its diagnostics do."""
        with self._lock:
            for status in statuses:
                named = [each for each in self._processes.values() if each.service == status.name]
                running = [each for each in named if each.is_running_service]
                if len(running) == 1:
                    running[0].note_report(status.counters, now_s)

    def _process(self, session: str) -> BusProcess:
        """Return the process of a session; a new one may take the place of the oldest, best of no service."""
        known = self._processes
        if session not in known and len(known) >= _MOST_PROCESSES:
            others = (each for each, process in known.items() if not process.service)
            oldest = known.pop(next(others, next(iter(known))))
            self._forgotten += bool(oldest.service or oldest.topics)
        return known.setdefault(session, BusProcess(session))

    # --- decisions ---

    def decide(self, now_s: float) -> None:
        """Decide about the publishers that are gone and of which nothing comes any more."""
        with self._lock:
            self._note_link(self._awake.at(now_s))  # in each turn: a pause of this process is a short time
            for process in list(self._processes.values()):
                if process.service:
                    self._decide_service(process, now_s)
                else:
                    self._decide_others(process, now_s)
            del self._reasons[_MOST_NOTES:], self._unconfirmed[_MOST_NOTES:]

    def _decide_service(self, process: BusProcess, now_s: float) -> None:
        departed = process.departed
        if departed is None:
            return
        if process.closing and not process.missing():
            del self._processes[process.session]
        elif self._is_final(departed, now_s):
            self._reasons.append(process.incomplete_at_end(departed))
            del self._processes[process.session]

    def _decide_others(self, process: BusProcess, now_s: float) -> None:
        for topic, departure in list(process.departures.items()):
            if self._is_final(departure, now_s):
                self._unconfirmed.append(process.unconfirmed_end(topic, departure))
                process.forget_publisher(topic)
                if not process.topics:
                    del self._processes[process.session]

    def _is_final(self, departure: Departure, now_s: float) -> bool:
        """Return whether a publisher that is gone has had the time to come back, and its messages to come."""
        awake_s = self._awake.at(now_s)
        if self._lost_with_link(departure):
            return not self._link.lost and awake_s - self._regained[1] > RETURN_S
        return awake_s - departure.awake_s > GRACE_S

    def _note_link(self, awake_s: float) -> None:
        for outage in self._link.outages()[-1:]:
            if outage.end_ns is not None and outage.end_ns != self._regained[0]:
                self._regained = outage.end_ns, awake_s

    def _lost_with_link(self, departure: Departure) -> bool:
        """Return whether a publisher has gone because the link was lost."""
        return any(
            abs(departure.stamp_ns - outage.begin_ns) * _NS < _OUTAGE_S for outage in self._link.outages()
        )

    def is_open(self, since_s: float) -> bool:
        """Return whether something may still arrive that decides about a publisher.

        Args:
            since_s: time since which each service that is there should have reported its numbers.
        """
        if self._link.lost:
            return False
        with self._lock:
            return any(self._may_still_report(process, since_s) for process in self._processes.values())

    def _may_still_report(self, process: BusProcess, since_s: float) -> bool:
        """Return whether a process may still report its numbers, or its missing messages arrive."""
        if process.departed is not None:
            # a service that was lost with the link may be away for long
            return not self._lost_with_link(process.departed)
        return process.is_running_service and (process.is_silent(since_s) or bool(process.missing()))

    def conclude(self, since_s: float) -> None:
        """Add the reasons that follow from services that are still there, when a file is closed.

        Args:
            since_s: time since which each service that is there should have reported its numbers.
        """
        with self._lock:
            for process in list(self._processes.values()):
                if reason := process.incomplete_at_close(since_s):
                    self._reasons.append(reason)
                    process.note_missing_as_reported()
                if process.departed is not None:
                    del self._processes[process.session]

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
                    f"there were more than {_MOST_PROCESSES} sessions; it is not known whether all messages "
                    f"of {self._forgotten} of them arrived"
                )
            endings = Endings(tuple(reasons), tuple(self._unconfirmed), outages)
            self._reasons, self._unconfirmed, self._forgotten = [], [], 0
        return endings


def _take_diagnostics(process: BusProcess, received: Received) -> None:
    try:
        diagnostics = read_diagnostics(received.decode())
    except MessageRejectedError:
        return
    for diagnostic in diagnostics[:1]:  # a service of rpod sends one
        process.note_diagnostic(diagnostic, received)
