"""What a subscription hands over: the bytes, the attachment, the time of arrival.

Callbacks of the bus only enqueue. An ``Inbox`` is the bounded queue between them and a service's
main loop; what does not fit is counted, never waited for.
"""

import queue
import time
from dataclasses import dataclass, field
from typing import Any

from rpod_schemas.cdr import decode
from rpod_schemas.topics import Topic
from rpod_schemas.wire import Attachment


@dataclass(frozen=True, slots=True)
class Received:
    """One message as it came off the wire."""

    topic: Topic
    key: str
    payload: memoryview
    attachment: Attachment
    arrival_ns: int
    """This machine's wall clock."""
    arrival_s: float = field(default_factory=time.monotonic)
    """Monotonic clock, for processing times."""

    def decode(self) -> Any:
        """Return the ROS message; raises ``MessageRejectedError``."""
        return decode(self.payload, self.topic.type)


class Inbox:
    """A bounded queue of received messages with a count of those that did not fit."""

    def __init__(self, capacity: int = 4096) -> None:
        self._queue: queue.Queue[Received] = queue.Queue(capacity)
        self.overflowed = 0

    def put(self, received: Received) -> None:
        """Enqueue; count where there is no room."""
        try:
            self._queue.put_nowait(received)
        except queue.Full:
            self.overflowed += 1

    def wait(self, timeout_s: float) -> list[Received]:
        """Return all that is there, in order of arrival; wait for the first up to the timeout."""
        try:
            items = [self._queue.get(timeout=timeout_s)]
        except queue.Empty:
            return []
        while True:
            try:
                items.append(self._queue.get_nowait())
            except queue.Empty:
                return items
