"""Finds wrong stamps of logged messages: those that belong to none of the log's clocks."""

from itertools import islice

import numpy as np

from rpod_analysis.log.log import Log
from rpod_analysis.log.logged import Logged
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.rmw.cdr import NANOSECONDS, begins_with_stamp, is_known, peek_stamp
from rpod_schemas.topics import VALIDITY, is_latched

_SAMPLED = 25
"""Number of first messages of each topic whose stamps show the clocks of a log."""
_LEAST_OF_A_CLOCK = 3
"""Least number of sampled stamps that agree on a clock of the log."""
_DAY_NS = 86_400 * NANOSECONDS
_FARTHEST_NS = 2**61
"""Difference of two stamps, ns, beyond which its size is not reported: 73 years."""
_FASTEST = 1_000
"""Largest speed of a log in lockstep, in multiples of the wall clock's."""


class StampCheck:
    """Finds wrong stamps: those that are days away from every clock by which the log's messages are stamped.

    A log may have several clocks: in lockstep the sensors use that of the scenario, diagnostics the wall
    clock. So the differences between stamp and arrival are sampled, and each difference on which several
    messages agree is a valid clock. Without this check, one stamp of another year would extend the run over
    years.
    """

    def __init__(self, log: Log) -> None:
        self._start_ns = log.start_ns
        self._offsets_ns = _offsets_ns(log)

    def check(self, logged: Logged, stamp_ns: int) -> int:
        """Return a message's stamp. Raises ``MessageRejectedError`` if it cannot belong to this log."""
        offset_ns = stamp_ns - logged.log_ns
        ahead_ns = min((offset_ns - known_ns for known_ns in self._offsets_ns), key=abs)
        if abs(ahead_ns) <= _DAY_NS + _FASTEST * abs(logged.log_ns - self._start_ns):
            return stamp_ns
        days = abs(ahead_ns) / _DAY_NS
        where, reason = ("ahead of", Reason.FUTURE) if ahead_ns > 0 else ("behind", Reason.LATE)
        raise MessageRejectedError(
            reason, f"stamp is {days:,.0f} days {where} the log's other messages; check the publisher's clock"
        )

    def peek(self, logged: Logged) -> int | None:
        """Return the checked stamp of a message that begins with one, None for a message of another type.

        A stamp of 0 means "no stamp" in two cases: in lockstep a sensor announces itself (latched) before the
        clock runs, and a validity before the first estimate has no estimate whose stamp it could have.

        Raises:
            MessageRejectedError: the stamp is missing, or it cannot belong to this log.
        """
        if not is_known(logged.type) or not begins_with_stamp(logged.type):
            return None
        stamp_ns = peek_stamp(logged.payload)
        if stamp_ns == 0 and (is_latched(logged.topic) or logged.type == VALIDITY.type):
            return None
        return self.check(logged, stamp_ns)


def _offsets_ns(log: Log) -> list[int]:
    """Return how far the clocks of a log's stamps are ahead of the arrivals; 0 if there is no stamp."""
    sampled: list[int] = []
    for name, info in log.topics.items():
        if not is_known(info.type) or not begins_with_stamp(info.type):
            continue
        for logged in islice(log.messages(name), _SAMPLED):
            try:
                ahead_ns = peek_stamp(logged.payload) - logged.log_ns
                sampled.append(max(-_FARTHEST_NS, min(ahead_ns, _FARTHEST_NS)))
            except MessageRejectedError:
                continue
    ordered = np.sort(np.array(sampled, np.int64))
    clocks = np.split(ordered, np.flatnonzero(np.diff(ordered) > _DAY_NS) + 1)
    most = max((len(clock) for clock in clocks), default=0)
    least = min(_LEAST_OF_A_CLOCK, most)
    return [int(np.median(clock)) for clock in clocks if len(clock) and len(clock) >= least] or [0]
