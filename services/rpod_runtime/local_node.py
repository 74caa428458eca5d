"""A node without a bus: its publishers hand each message to a function of this process.

Everything that only publishes works with it: publishers of sensors, emulated sensors, faults.
"""

from collections.abc import Callable
from itertools import count
from typing import Any, cast

from rpod_runtime.clock import Clock, WallClock
from rpod_runtime.delivery.inbox import Received
from rpod_runtime.health import HealthBook
from rpod_runtime.node import Node
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import GID_BYTES, Attachment
from rpod_schemas.topics import Namespace, Topic

SESSION = "local"
"""Session that its messages name."""


def local_node(take: Callable[[Received], object], clock: Clock | None = None) -> Node:
    """Return a node for publishers, without a bus.

    Args:
        take: gets each message as a receiver on the bus would, in the thread that publishes it.
        clock: time of publication and arrival; by default this machine's clock.
    """
    return cast(Node, _LocalNode(take, clock or WallClock()))


class _LocalNode:
    def __init__(self, take: Callable[[Received], object], clock: Clock) -> None:
        self.clock, self.health = clock, HealthBook(SESSION)
        self._take, self._numbers = take, count(1)

    def publisher(self, topic: Topic) -> "_LocalPublisher":
        return _LocalPublisher(topic, self._take, self.clock, next(self._numbers).to_bytes(GID_BYTES, "big"))

    def reject(self, topic: str, error: MessageRejectedError) -> None:
        self.health.reject(topic, error)


class _LocalPublisher:
    """Publisher of a local node; what it offers is described in ``Publisher``."""

    def __init__(self, topic: Topic, take: Callable[[Received], object], clock: Clock, gid: bytes) -> None:
        self.topic, self.published = topic, 0
        self._take, self._clock, self._gid = take, clock, gid

    def publish(self, message: Any, *, since_ns: int | None = None) -> None:
        self.put(encode(message), since_ns=since_ns)

    def put(self, payload: bytes | bytearray, *, since_ns: int | None = None) -> None:
        self.published += 1
        now_ns = self._clock.now_ns()
        attachment = Attachment(self.published, since_ns or now_ns, self._gid)
        key, content = Namespace().key(self.topic), memoryview(bytes(payload))
        self._take(Received(self.topic, key, content, attachment, now_ns, session=SESSION))

    def lose(self) -> None:
        self.published += 1
