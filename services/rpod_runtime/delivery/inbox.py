"""Received messages, and the bounded queue between the bus and the main loop of a service.

Callbacks of the bus only enqueue. A message that does not fit displaces the oldest ones, which are counted;
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


MOST_BYTES = 512 << 20
"""Largest size of the messages in an inbox: three seconds of a camera of 640 x 480 pixels at 45 Hz. A message
may have 256 MiB."""


class Inbox:
    """A queue of received messages, bounded in number and bytes.

    Where a message does not fit, the oldest ones are dropped and counted.
    """

    def __init__(self, capacity: int = 4096, capacity_bytes: int = MOST_BYTES) -> None:
        self._capacity, self._capacity_bytes = capacity, capacity_bytes
        self._messages: deque[Received] = deque()
        self._bytes = 0
        self._arrival = Condition()
        self._is_woken = False
        self.overflowed = 0

    def put(self, received: Received) -> list[Received]:
        """Enqueue a message; return the oldest ones that had to be dropped, usually none."""
        dropped = []
        with self._arrival:
            self._messages.append(received)
            self._bytes += len(received.payload)
            while len(self._messages) > 1 and (
                len(self._messages) > self._capacity or self._bytes > self._capacity_bytes
            ):
                dropped.append(self._messages.popleft())
                self._bytes -= len(dropped[-1].payload)
            self.overflowed += len(dropped)
            self._arrival.notify()
        return dropped

    def wait(self, timeout_s: float) -> list[Received]:
        """Return all queued messages in order of arrival; wait up to the timeout for the first one."""
        with self._arrival:
            self._arrival.wait_for(lambda: self._messages or self._is_woken, timeout_s)
            messages = list(self._messages)
            self._messages.clear()
            self._bytes = 0
        return messages

    def wake(self) -> None:
        """End a wait, or the next one."""
        with self._arrival:
            self._is_woken = True
            self._arrival.notify()

    def take_wake(self) -> bool:
        """Return whether ``wake`` was called since the last call."""
        with self._arrival:
            woken, self._is_woken = self._is_woken, False
        return woken
