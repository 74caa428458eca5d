"""The time of a log: that of its ``clock`` (after a run in lockstep), else that of the arrivals."""

from bisect import bisect_left

from rpod_analysis.errors import BeyondEndError
from rpod_analysis.log import Log, Logged
from rpod_analysis.log.stamp_check import StampCheck
from rpod_schemas.rmw.cdr import NANOSECONDS, peek_stamp
from rpod_schemas.topics import CLOCK

_NEVER_NS = 1 << 62


class Timeline:
    """The time of a log: that of its ``clock``, else that of the arrivals."""

    def __init__(self, log: Log) -> None:
        self._log, self._stamps = log, StampCheck(log)
        self.recorded = CLOCK.name in log.topics and log.topics[CLOCK.name].count > 0
        self.now_ns = self._clock_from(log.start_ns) if self.recorded else log.start_ns
        self.start_ns = self.now_ns

    def at(self, time_s: float) -> int:
        """Return the time, ns, at a number of seconds from the beginning."""
        return self.start_ns + round(time_s * NANOSECONDS)

    def begin(self, start_s: float) -> int:
        """Return the time, ns, from which a log is played. Raises ``BeyondEndError``: it ends before."""
        time_ns = self.at(start_s)
        end_ns = self._last_ns() if self.recorded else self._log.end_ns
        if time_ns > end_ns:
            length_s = (end_ns - self.start_ns) / NANOSECONDS
            raise BeyondEndError(self._log.paths[0], start_s, length_s)
        return time_ns

    def _last_ns(self) -> int:
        """Return the last time on ``clock``."""
        step_ns, since_ns = NANOSECONDS, self._log.end_ns
        while self._clock_from(since_ns) == _NEVER_NS and since_ns > self._log.start_ns:
            since_ns, step_ns = since_ns - step_ns, 2 * step_ns
        last_ns = self.start_ns
        for logged in self._log.messages(CLOCK, start_ns=since_ns):
            with self._log.unreadable.left_out(logged):
                last_ns = max(self._checked_stamp_ns(logged), last_ns)
        return last_ns

    def advance(self, logged: Logged) -> int:
        """Return the time after a message has arrived."""
        if not self.recorded:
            self.now_ns = logged.log_ns
        elif logged.topic == CLOCK.name:
            with self._log.unreadable.left_out(logged):
                self.now_ns = max(self._checked_stamp_ns(logged), self.now_ns)
        return self.now_ns

    def arrival_of(self, time_ns: int) -> int:
        """Return the time of arrival at which the log had reached a time."""
        if not self.recorded:
            return time_ns
        arrivals = range(self._log.start_ns, self._log.end_ns + 1)
        return arrivals.start + bisect_left(arrivals, time_ns, key=self._clock_from)

    def _clock_from(self, arrival_ns: int) -> int:
        """Return the first time on ``clock`` from an arrival on; after the last one, the time of the end."""
        for logged in self._log.messages(CLOCK, start_ns=arrival_ns):
            with self._log.unreadable.left_out(logged):
                return self._checked_stamp_ns(logged)
        return _NEVER_NS

    def _checked_stamp_ns(self, logged: Logged) -> int:
        return self._stamps.check(logged, peek_stamp(logged.payload))
