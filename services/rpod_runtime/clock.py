"""Time sources: this machine's clock, or the topic ``clock`` (ICD section 1)."""

import time
from threading import Condition
from typing import Protocol

from rpod_schemas.messages import read_stamp


class Clock(Protocol):
    """Where now comes from."""

    def now_ns(self) -> int:
        """Return nanoseconds of UTC since the Unix epoch."""
        ...

    def settled_ns(self) -> int:
        """Return the newest time up to which everything that was handed out has come."""
        ...


class WallClock:
    """This machine's clock."""

    def now_ns(self) -> int:
        """Return nanoseconds of UTC since the Unix epoch."""
        return time.time_ns()

    def settled_ns(self) -> int:
        """Return now: what has not come by now is late."""
        return time.time_ns()


class BusClock:
    """The last message of ``clock``; 0 until there was one. Never runs backwards."""

    def __init__(self) -> None:
        self._now_ns = self._before_ns = 0
        self._moved = Condition()

    def set(self, message: object) -> None:
        """Take a rosgraph_msgs/Clock."""
        stamp_ns = read_stamp(message)
        with self._moved:
            if stamp_ns > self._now_ns:
                self._before_ns, self._now_ns = self._now_ns, stamp_ns
            self._moved.notify_all()

    def await_ns(self, stamp_ns: int, timeout_s: float) -> None:
        """Wait for a time: what was published after a clock message may be handed over before it."""
        with self._moved:
            self._moved.wait_for(lambda: self._now_ns >= stamp_ns, timeout_s)

    def now_ns(self) -> int:
        """Return the time of the last clock message."""
        return self._now_ns

    def settled_ns(self) -> int:
        """Return the time of the last clock message but one: what the last one hands out is on its way."""
        return self._before_ns
