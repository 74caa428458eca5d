"""Waits of drivers between two frames, no longer than their port allows without an item."""

import time
from collections.abc import Iterator
from math import inf

_TURN_S = 0.5
"""Longest sleep. The port asks for an item at least once a second, so that the host can stop a driver."""


class Pauses:
    """The announced pauses of a player between two frames."""

    def __init__(self) -> None:
        self.due_s = -inf
        """When the next frame is due, s of the monotonic clock; it has passed while none is awaited."""

    def until(self, due_s: float) -> Iterator[None]:
        """Announce when the next frame is due, and pause until then, as ``paused_until`` does."""
        self.due_s = due_s
        yield from paused_until(due_s)


def paused_until(due_s: float) -> Iterator[None]:
    """Sleep until a time of the monotonic clock, s; yield None twice a second meanwhile."""
    while (left_s := due_s - time.monotonic()) > 0.0:
        time.sleep(min(left_s, _TURN_S))
        if left_s > _TURN_S:
            yield None
