"""Judges results in a thread of its own, so that the next frame does not wait for it (decision 177).

The integrity of a result follows from this result, from the results before it and from nothing else, and no
estimate depends on it. So it is the same, bit for bit, whenever it is computed, as long as the order is kept.
"""

import sys
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self

MOST_WAITING = 1
"""Largest number of results that are not judged yet while the next frame is processed: the integrity is at
most one result behind the estimate."""
_SWITCH_S = 2e-4
"""Time for which a thread keeps the interpreter's lock while another one waits for it, s; Python's own is
5 ms. The main loop gives the lock away in each kernel, and a judgement, mostly Python code, takes it. With
5 ms the main loop waited 23 ms for it in each image of ``envisat-capture``, with this time 5 to 8 ms."""


class Judging:
    """Runs judgements in their order, in a thread or at once.

    Args:
        at_once: whether to run each in the caller's thread. Lockstep needs this, since it waits for each
            status. So do predictions by the chaser's readings, since these may arrive during a judgement.
    """

    def __init__(self, *, at_once: bool) -> None:
        self._waiting: deque[Future[None]] = deque()
        self._pool = None if at_once else ThreadPoolExecutor(1, thread_name_prefix="judging")
        self._usual_s = sys.getswitchinterval()

    def add(self, judge: Callable[[], None]) -> None:
        """Run a judgement after those before it; wait while too many of them are not done.

        An exception of a judgement is raised here, or in ``check``.
        """
        if self._pool is None:
            judge()
            return
        self._await(MOST_WAITING - 1)
        self._waiting.append(self._pool.submit(judge))

    def check(self) -> None:
        """Raise the exception of a judgement that has failed."""
        while self._waiting and self._waiting[0].done():
            self._waiting.popleft().result()

    def _await(self, number: int) -> None:
        """Wait until at most this number of judgements is not done."""
        self.check()
        while len(self._waiting) > number:
            self._waiting.popleft().result()

    def __enter__(self) -> Self:
        if self._pool is not None:
            sys.setswitchinterval(_SWITCH_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is None:
            return
        self._pool.shutdown()
        sys.setswitchinterval(self._usual_s)
        if error is None:
            self._await(0)
