"""A clock for patience: it counts the time in which this process ran, not the time that passed.

A process that stood still for seconds (on a loaded or suspended machine) has not yet handled the messages
that wait for it. By the monotonic clock it would conclude that the others had been silent, or too slow. By
this clock it gives them the rest of their time first.
"""

import time
from collections.abc import Callable
from threading import Event, Lock, Thread
from typing import Self


class AwakeTime:
    """Counts the seconds between readings of a clock; between two readings ``longest_s`` at most.

    Args:
        longest_s: longest time between two readings of a process that does not stand still, s.
    """

    def __init__(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self._last_s: float | None = None
        self._awake_s = 0.0

    def at(self, now_s: float) -> float:
        """Return the time since the first reading in which this process was awake, s.

        Args:
            now_s: the present reading of the clock, s.
        """
        passed_s = 0.0 if self._last_s is None else now_s - self._last_s
        self._awake_s += min(max(passed_s, 0.0), self._longest_s)
        self._last_s = now_s
        return self._awake_s


class AwakeClock:
    """Counts seconds; the time between two calls of ``now_s`` counts as ``longest_s`` at most.

    Args:
        longest_s: longest time between two calls of a process that does not stand still, s.
        now_s: the clock that does not stand still, s.
    """

    def __init__(self, longest_s: float = 1.0, *, now_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s, self._awake = now_s, AwakeTime(longest_s)
        self._awake.at(now_s())

    def now_s(self) -> float:
        """Return the time in which this process was awake since the clock was made, s."""
        return self._awake.at(self._clock_s())


class Ticking:
    """A context in which a thread makes a call again and again.

    Args:
        tick_s: time between two calls, s.
        call: what is called; it is safe to call it from any thread.
        name: name of the thread.
    """

    def __init__(self, tick_s: float, call: Callable[[], object], name: str) -> None:
        self._tick_s, self._call, self._over = tick_s, call, Event()
        self._thread = Thread(target=self._tick, name=name, daemon=True)

    def _tick(self) -> None:
        while not self._over.wait(self._tick_s):
            self._call()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()


class TickingClock(Ticking, AwakeClock):
    """An awake clock that a thread keeps going, for a process that waits in a call of others; a context."""

    def __init__(self, tick_s: float = 0.02) -> None:
        AwakeClock.__init__(self, 5.0 * tick_s)
        self._lock = Lock()
        Ticking.__init__(self, tick_s, self.now_s, "clock")

    def now_s(self) -> float:
        """Return the time in which this process was awake since the clock was made, s."""
        with self._lock:
            return super().now_s()
