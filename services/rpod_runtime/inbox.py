"""What a subscription hands over: the bytes, the attachment, the time of arrival.

Callbacks of the bus only enqueue. An ``Inbox`` is the bounded queue between them and a service's
main loop; what does not fit is counted, never waited for.
"""

import time
from collections import deque
from dataclasses import dataclass, field
from threading import Condition
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
    encoding: str = ""
    """As the publisher named it to the bus; only of what has no type that is known."""

    def decode(self) -> Any:
        """Return the ROS message; raises ``MessageRejectedError``."""
        return decode(self.payload, self.topic.type)


class Inbox:
    """A bounded queue of received messages; where it is full the oldest gives way, and is counted."""

    def __init__(self, capacity: int = 4096) -> None:
        self._messages: deque[Received] = deque(maxlen=capacity)
        self._arrival = Condition()
        self.overflowed = 0

    def put(self, received: Received) -> None:
        """Enqueue."""
        with self._arrival:
            self.overflowed += len(self._messages) == self._messages.maxlen
            self._messages.append(received)
            self._arrival.notify()

    def wait(self, timeout_s: float) -> list[Received]:
        """Return all that is there, in order of arrival; wait for the first up to the timeout."""
        with self._arrival:
            self._arrival.wait_for(lambda: self._messages, timeout_s)
            messages = list(self._messages)
            self._messages.clear()
        return messages
