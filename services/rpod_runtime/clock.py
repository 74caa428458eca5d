"""Time sources: this machine's clock, or the topic ``clock`` (ICD section 1)."""

import time
from threading import Condition
from typing import Protocol

from rpod_schemas.messages import read_stamp


class Clock(Protocol):
    """A source of the current time."""

    def now_ns(self) -> int:
        """Return nanoseconds of UTC since the Unix epoch."""
        ...

    def settled_ns(self) -> int:
        """Return the newest time up to which no frame is still on its way."""
        ...


class WallClock:
    """This machine's clock."""

    def now_ns(self) -> int:
        """Return nanoseconds of UTC since the Unix epoch."""
        return time.time_ns()

    def settled_ns(self) -> int:
        """Return the current time: frames that have not arrived by now are late."""
        return time.time_ns()


class BusClock:
    """Clock with the newest time received on ``clock``, 0 before the first message. It never goes back."""

    def __init__(self) -> None:
        self._now_ns = self._before_ns = 0
        self._stood_ns = -1
        self._moved = Condition()

    def set(self, message: object) -> None:
        """Set the time from a rosgraph_msgs/Clock; an earlier one is ignored."""
        stamp_ns = read_stamp(message)
        with self._moved:
            if stamp_ns > self._now_ns:
                self._before_ns, self._now_ns = self._now_ns, stamp_ns
            self._moved.notify_all()

    def await_ns(self, stamp_ns: int, timeout_s: float, *, standing_s: float) -> None:
        """Wait until the clock reaches a time.

        A message that was published after a clock message may be delivered before it, or the clock message
        may have been lost and is recovered. In lockstep no other one comes meanwhile.

        Args:
            stamp_ns: the time.
            timeout_s: longest wait for a clock that moves.
            standing_s: longest wait for a clock that stands still; once in vain at each of its times.
        """
        with self._moved:
            since_ns = self._now_ns
            if self._moved.wait_for(lambda: self._now_ns >= stamp_ns, timeout_s):
                return
            if self._now_ns == since_ns != self._stood_ns:
                moved = self._moved.wait_for(lambda: self._now_ns > since_ns, standing_s - timeout_s)
                self._stood_ns = self._stood_ns if moved else since_ns

    def now_ns(self) -> int:
        """Return the time of the last clock message."""
        return self._now_ns

    def settled_ns(self) -> int:
        """Return the time of the second newest clock message: the newest one's frame may be on its way."""
        return self._before_ns
