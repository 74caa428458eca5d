"""Whether this process itself stood still: stopped, on a suspended machine, or without a processor.

Messages that waited meanwhile arrive all at once afterwards, and look as if their senders' clocks or links
had failed. A thread looks at a clock that goes on while the machine sleeps. A long time between two looks is
one in which nothing of this process ran.
"""

import time
from collections.abc import Callable
from threading import Lock
from typing import NamedTuple

from rpod_runtime.process.awake import Ticking

_TICK_S = 0.05
"""Time between two looks."""
STANDS_S = 0.5
"""Time between two looks from which on the process stood still: ten looks are missing."""
_BACKLOG_S = 2.0
"""Time after which messages that waited have arrived."""


class Stand(NamedTuple):
    """A time in which this process did not run."""

    begin_s: float
    """Begin, monotonic clock."""
    end_s: float
    """End, monotonic clock."""
    end_ns: int
    """End, ns of UTC."""
    length_s: float
    """Length, with the time in which the machine slept."""

    def holds_up(self, stamp_ns: int, arrival_s: float) -> bool:
        """Return whether a message with a stamp, ns of UTC, waited for this process until its arrival."""
        return stamp_ns < self.end_ns and self.begin_s < arrival_s <= self.end_s + _BACKLOG_S

    @property
    def text(self) -> str:
        """Figures and remedy, for the operator."""
        return (
            f"this process stood still for {self.length_s:.1f} s, so that frames waited for it: neither the "
            "sensor's clock nor its link; do not stop it or suspend its machine, and end other work if the "
            "machine is busy"
        )


def _boot_s() -> float:
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class StandWatch(Ticking):
    """Looks for times in which this process did not run; a context, in which a thread looks.

    Args:
        clock_s: clock that goes on while the machine sleeps, s.
        monotonic_s: clock by which messages arrive, s.
        utc_ns: clock of the stamps, ns of UTC.
    """

    def __init__(
        self,
        clock_s: Callable[[], float] = _boot_s,
        monotonic_s: Callable[[], float] = time.monotonic,
        utc_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._clock_s, self._monotonic_s, self._utc_ns = clock_s, monotonic_s, utc_ns
        self._last_s, self._last_monotonic_s = clock_s(), monotonic_s()
        self._newest: Stand | None = None
        self._lock = Lock()
        super().__init__(_TICK_S, self.look, "standing")

    def look(self) -> Stand | None:
        """Return the newest time in which this process stood still; None if it never did."""
        with self._lock:
            now_s, monotonic_s = self._clock_s(), self._monotonic_s()
            if now_s - self._last_s >= STANDS_S:
                length_s = now_s - self._last_s
                self._newest = Stand(self._last_monotonic_s, monotonic_s, self._utc_ns(), length_s)
            self._last_s, self._last_monotonic_s = now_s, monotonic_s
            return self._newest
