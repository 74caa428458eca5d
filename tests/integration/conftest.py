from collections.abc import Iterator
from contextlib import ExitStack
from threading import Event

import pytest

from rpod_runtime import Inbox, Node
from rpod_runtime.session import free_endpoint, open_router
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig

TIMEOUT_S = 10.0


class Bus:
    """A router on an ephemeral port of loopback, and nodes on it."""

    def __init__(self, stack: ExitStack) -> None:
        self._stack = stack
        self.endpoint = free_endpoint()
        self.config = BusConfig(connect=self.endpoint)
        stack.enter_context(open_router(RouterConfig(listen=self.endpoint)))

    def node(self, instance: str, *, zenoh_id: str | None = None, **changes: object) -> Node:
        config = ServiceConfig(instance=instance, bus=self.config, zenoh_id=zenoh_id, **changes)
        return self._stack.enter_context(Node(config, version="test", stop=Event()))


@pytest.fixture
def bus() -> Iterator[Bus]:
    with ExitStack() as stack:
        yield Bus(stack)


def collect(inbox: Inbox, count: int, timeout_s: float = TIMEOUT_S) -> list:
    """Return the next messages, as many as asked for; fewer where they do not come in time."""
    from time import monotonic

    items: list = []
    deadline_s = monotonic() + timeout_s
    while len(items) < count and monotonic() < deadline_s:
        items += inbox.wait(0.1)
    return items
