"""Watching a sensor on the bus, or a driver in this process."""

import time
from threading import Event
from typing import Any

from rpod_driver.check.observations import Observations, Observer
from rpod_runtime import Inbox, Node, Received
from rpod_runtime.clock import WallClock
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.rmw.wire import Attachment
from rpod_schemas.topics import Topic

_POLL_S = 0.1


def watch(node: Node, observer: Observer, *, duration_s: float, stop: Event) -> Observations:
    """Return the observations of a sensor in a time. Messages that the bus loses are not asked for again."""
    inbox = Inbox(capacity=20_000)
    for topic in (*observer.latched, *observer.streams, *observer.others):
        node.subscribe(topic, inbox.put)
    tokens: list[tuple[str, str, str]] = []
    node.watch_publisher_qos(tokens.append)
    node.ready(f"watching {observer.seen.name} for {duration_s:g} s")
    end_s = time.monotonic() + duration_s
    while (left_s := end_s - time.monotonic()) > 0.0 and not stop.is_set():
        for received in inbox.wait(min(left_s, _POLL_S)):
            observer.take(received)
    observer.take_tokens(tuple(tokens))
    return observer.end(time.time_ns())


class StraightNode:
    """A node without a bus: what is published goes to an observer at once."""

    def __init__(self, observer: Observer) -> None:
        self.clock = WallClock()
        self._observer = observer

    def publisher(self, topic: Topic) -> "StraightPublisher":
        """Return a publisher of a topic."""
        return StraightPublisher(self._observer, topic)


class StraightPublisher:
    """A publisher without a bus."""

    def __init__(self, observer: Observer, topic: Topic) -> None:
        self._observer, self._topic, self._sequence = observer, topic, 0

    def publish(self, message: Any) -> None:
        """Hand a message to the observer, as if it had just arrived."""
        self._sequence += 1
        now_ns = time.time_ns()
        attachment = Attachment(self._sequence, now_ns, self._topic.name.encode()[-16:].rjust(16))
        payload = memoryview(bytes(encode(message)))
        self._observer.take_tokens([(self._topic.name, self._topic.offered.token(), "driver")])
        self._observer.take(Received(self._topic, "", payload, attachment, now_ns, session="driver"))
