"""Received messages, and the bounded queue between the bus and the main loop of a service.

Callbacks of the bus only enqueue. A message that does not fit displaces the oldest one and is counted;
the bus never waits.
"""

import time
from collections import deque
from dataclasses import dataclass, field
from threading import Condition
from typing import Any

from rpod_runtime.delivery.holders import Peer
from rpod_schemas.rmw.cdr import decode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import Topic


@dataclass(frozen=True, slots=True)
class Received:
    """One message as it was received: payload, attachment and time of arrival."""

    topic: Topic
    key: str
    payload: memoryview
    attachment: Attachment
    arrival_ns: int
    """Time of arrival, this machine's wall clock."""
    arrival_s: float = field(default_factory=time.monotonic)
    """Time of arrival, monotonic clock; for processing times."""
    encoding: str = ""
    """Encoding that the publisher declared; set only where the type is unknown."""
    session: str = ""
    """Zenoh identity of the publisher's session; empty if it is unknown."""

    @property
    def peer(self) -> Peer:
        """Publisher of the message."""
        return Peer(self.attachment.gid, self.session)

    def decode(self) -> Any:
        """Return the ROS message; raises ``MessageRejectedError``."""
        return decode(self.payload, self.topic.type)


class Inbox:
    """A bounded queue of received messages. When it is full, the oldest message is dropped and counted."""

    def __init__(self, capacity: int = 4096) -> None:
        self._messages: deque[Received] = deque(maxlen=capacity)
        self._arrival = Condition()
        self.overflowed = 0

    def put(self, received: Received) -> Received | None:
        """Enqueue a message; return the oldest one if it had to be dropped."""
        with self._arrival:
            is_full = len(self._messages) == self._messages.maxlen
            dropped = self._messages[0] if is_full else None
            self.overflowed += is_full
            self._messages.append(received)
            self._arrival.notify()
        return dropped

    def wait(self, timeout_s: float) -> list[Received]:
        """Return all queued messages in order of arrival; wait up to the timeout for the first one."""
        with self._arrival:
            self._arrival.wait_for(lambda: self._messages, timeout_s)
            messages = list(self._messages)
            self._messages.clear()
        return messages
