"""The link between sensor and estimator with a fault, in the time of a sequence.

It has the conditions of the shipped proxy, without a bus. A link that was dead or cut is there again at the
end of the fault: the time in which services connect again is not modelled.
"""

from collections import deque
from random import Random
from typing import NamedTuple

from rpod_campaign.faults.cell import FaultCell
from rpod_proxy.condition import CHUNK_BYTES, GOOD, Condition, condition_of
from rpod_runtime import Received
from rpod_schemas.messages import NANOSECONDS

QUEUE_BYTES = 1 << 20
"""Size of the sender's queue; a message that finds no room is dropped (decision 46)."""


class Arrival(NamedTuple):
    """Messages that arrive at a time."""

    time_ns: int
    messages: list[Received]


class Link:
    """Messages on their way, in the order in which they were sent."""

    def __init__(self, cell: FaultCell, *, begin_ns: int, end_ns: int, seed: int) -> None:
        self._condition = condition_of([(cell.fault, cell.size)])
        self._begin_ns, self._end_ns = begin_ns, end_ns
        self._random = Random(seed)
        self._queue: deque[tuple[int, int]] = deque()
        """Time at which each message has left the sender, and its size."""
        self._arriving: deque[tuple[int, Received]] = deque()

    def send(self, messages: list[Received], now_ns: int) -> None:
        """Send the messages of a frame."""
        condition = self._condition if self._begin_ns <= now_ns < self._end_ns else GOOD
        while self._queue and self._queue[0][0] <= now_ns:
            self._queue.popleft()
        for message in messages:
            size, waiting = len(message.payload), sum(size for _, size in self._queue)
            if condition.dead or condition.cut or (waiting and waiting + size > QUEUE_BYTES):
                continue
            left_ns = self._left_ns(condition, size, now_ns, more=message is not messages[-1])
            self._queue.append((left_ns, size))
            arrival_ns = left_ns + round(condition.delay_s * NANOSECONDS)
            before_ns = self._arriving[-1][0] if self._arriving else 0
            self._arriving.append((max(arrival_ns, before_ns), message))

    def _left_ns(self, condition: Condition, size: int, now_ns: int, *, more: bool) -> int:
        """Return when a message has left the sender."""
        free_ns = max(now_ns, self._queue[-1][0] if self._queue else 0)
        if condition.stalled:
            free_ns = max(free_ns, self._end_ns)
        chunks = [CHUNK_BYTES] * (size // CHUNK_BYTES) + [size % CHUNK_BYTES]
        lasts_s = sum(
            condition.lost_s(chunk, more=more or number + 1 < len(chunks), random=self._random)
            for number, chunk in enumerate(chunks)
        )
        if condition.rate_B_s:
            lasts_s += size / condition.rate_B_s
        return free_ns + round(lasts_s * NANOSECONDS)

    def arrived(self, until_ns: int) -> list[Arrival]:
        """Return what has arrived up to a time and was not returned before, in its order."""
        found: list[Arrival] = []
        while self._arriving and self._arriving[0][0] <= until_ns:
            time_ns, message = self._arriving.popleft()
            if not found or found[-1].time_ns != time_ns:
                found.append(Arrival(time_ns, []))
            found[-1].messages.append(message)
        return found
