"""A sender with a router, and a receiver: the two sides of a link that is not perfect (``lossy_link``)."""

import time
from contextlib import ExitStack
from itertools import pairwise
from threading import Event
from typing import Any, Self

from rpod_runtime import Inbox, Node
from rpod_runtime.bus.session import open_router
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig
from rpod_schemas.topics import DEPTH, TRUTH

TRUTH_HZ = 250.0
FRAME_BYTES = 76_032
"""A depth image of 176 x 108 pixels."""
_FRAMES = DEPTH.of("pmd")
_PATIENCE_S = 60.0


class _Side:
    def __init__(self) -> None:
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _node(self, instance: str, endpoint: str) -> Node:
        bus = BusConfig(connect=endpoint, connect_timeout_s=_PATIENCE_S)
        return self._stack.enter_context(Node(ServiceConfig(instance=instance, bus=bus), version="test"))


class Sender(_Side):
    """A router, the truth and a camera."""

    def __init__(self, endpoint: str) -> None:
        super().__init__()
        self._stack.enter_context(open_router(RouterConfig(listen=endpoint, estimators=())))
        self._here = self._node("sender", endpoint)
        self._truth, self._frames = self._here.publisher(TRUTH), self._here.publisher(_FRAMES)

    def await_receiver(self) -> None:
        """Wait until the router knows that somebody receives the truth: its token follows its subscription.

        Who joins while a publisher publishes may miss the messages before (a race in Zenoh's subscriber).
        """
        deadline_s, pause = time.monotonic() + _PATIENCE_S, Event()
        while time.monotonic() < deadline_s:
            replies = self._here._session.liveliness().get("@ros2_lv/**", timeout=_PATIENCE_S)
            keys = [str(reply.ok.key_expr) for reply in replies if reply.ok]
            if any("/MS/" in key and "/receiver/" in key and "depth" in key for key in keys):
                return
            pause.wait(0.05)

    def send(self, *, truth: int, frame_hz: float) -> dict[str, int]:
        """Send so many messages of truth at their rate, and frames beside them; return the numbers."""
        begin_s, pause, frames = time.monotonic(), Event(), 0
        for number in range(truth):
            pause.wait(max(0.0, begin_s + number / TRUTH_HZ - time.monotonic()))
            self._truth.put(b"\0\1\0\0" + bytes(700))
            if number / TRUTH_HZ >= frames / frame_hz:
                frames += 1
                self._frames.put(b"\0\1\0\0" + bytes(FRAME_BYTES))
        return {"truth": truth, "frames": frames}


class Receiver(_Side):
    """Receives truth and frames, and asks again for what it missed."""

    def __init__(self, endpoint: str) -> None:
        super().__init__()
        self._node_here = self._node("receiver", endpoint)
        self._truth, self._frames = Inbox(1 << 20), Inbox(1 << 20)
        self._node_here.subscribe(TRUTH, self._truth.put, recover=True, history=True)
        self._node_here.subscribe(_FRAMES, self._frames.put, recover=True, history=True)

    def receive(self, sent: dict[str, int]) -> dict[str, Any]:
        """Wait for what was sent, and return what arrived."""
        deadline_s, truth = time.monotonic() + _PATIENCE_S, []
        while time.monotonic() < deadline_s:
            truth += self._truth.wait(0.2)
            if len(truth) + self._count("missed") >= sent["truth"]:
                break
        numbers = [received.attachment.sequence for received in truth]
        times_s = [received.arrival_s for received in truth]
        return {
            "truth": len(set(numbers)),
            "missed": sent["truth"] - len(set(numbers)),
            "in_order": numbers == sorted(numbers),
            "recovered": self._count("recovered"),
            "frames": len(self._frames.wait(2.0)),
            "gap_s": max(after - before for before, after in pairwise(times_s)),
        }

    def _count(self, kind: str) -> int:
        return self._node_here.status().counters.get(f"{kind}/{TRUTH.name}", 0)
