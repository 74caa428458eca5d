"""A real bus for tests: a router on an ephemeral port of loopback, nodes on it, daemons in threads.

Nothing here sleeps: tests wait for messages, with a timeout.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from threading import Event, Thread
from time import monotonic
from typing import Any

from rpod_runtime import Inbox, Node, Received
from rpod_runtime.bus.session import free_endpoint, open_router
from rpod_schemas.config.service import BusConfig, RouterConfig, ServiceConfig

TIMEOUT_S = 60.0


@contextmanager
def router() -> Iterator[str]:
    """Run a router with the shipped rules; yields its endpoint."""
    endpoint = free_endpoint()
    with open_router(RouterConfig(listen=endpoint)):
        yield endpoint


class Bus:
    """Nodes on a router; they live as long as the test."""

    def __init__(self, endpoint: str, stack: ExitStack) -> None:
        self._stack = stack
        self.endpoint = endpoint
        self.config = BusConfig(connect=endpoint)

    def node(self, instance: str, *, zenoh_id: str = "", namespace: str = "", **changes: Any) -> Node:
        """Open a node; ``changes`` are fields of its configuration."""
        bus = self.config.model_copy(update={"namespace": namespace})
        config = ServiceConfig(instance=instance, bus=bus, zenoh_id=zenoh_id, **changes)
        return self._stack.enter_context(Node(config, version="test", stop=Event()))


def collect(inbox: Inbox, count: int, timeout_s: float = TIMEOUT_S) -> list[Received]:
    """Return the next messages, as many as asked for; fewer where they do not come in time."""
    items: list[Received] = []
    deadline_s = monotonic() + timeout_s
    while len(items) < count and monotonic() < deadline_s:
        items += inbox.wait(0.1)
    return items


def first(inbox: Inbox, fits: Callable[[Any], Any], timeout_s: float = TIMEOUT_S) -> Any:
    """Return what ``fits`` makes of the first message for which that is not false; None after the timeout."""
    deadline_s = monotonic() + timeout_s
    while monotonic() < deadline_s:
        for received in inbox.wait(0.1):
            found = fits(received)
            if found:
                return found
    return None


@contextmanager
def daemon(run: Callable[..., None], config: Any) -> Iterator[Event]:
    """Run a service in a thread; stop it at the end, and raise what it raised.

    Yields:
        An event that stops the service. It is set, too, when the service raises.
    """
    stop = Event()
    raised: list[Exception] = []

    def body() -> None:
        try:
            run(config, version="test", stop=stop)
        except Exception as error:  # noqa: BLE001 - raised again below
            raised.append(error)
            stop.set()

    thread = Thread(target=body, name=config.instance)
    thread.start()
    try:
        yield stop
    finally:
        stop.set()
        thread.join(TIMEOUT_S)
        if raised:
            raise raised[0]
    assert not thread.is_alive(), f"{config.instance} does not stop"
