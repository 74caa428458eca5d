"""Watching a sensor on the bus, or a driver in this process."""

import time
from threading import Event

from rpod_driver.check.observations import Observations, Observer
from rpod_runtime import Inbox, Node, Received
from rpod_runtime.local_node import local_node

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


def observed_node(observer: Observer) -> Node:
    """Return a node without a bus: the observer gets what is published at once, as if it had arrived."""

    def take(received: Received) -> None:
        observer.take_tokens([(received.topic.name, received.topic.offered.token(), received.session)])
        observer.take(received)

    return local_node(take)
