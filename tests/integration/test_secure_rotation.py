"""Certificates are replaced, and the router is restarted, while messages flow; sockets that say nothing."""

import socket
from contextlib import ExitStack, suppress
from datetime import timedelta
from itertools import pairwise
from pathlib import Path
from threading import Event, Thread
from time import monotonic

import pytest
from live_bus import TIMEOUT_S
from live_bus import router as plain_router
from secure_bus import SecureBus

from rpod_runtime import Inbox
from rpod_runtime.bus.session import open_client
from rpod_runtime.errors import RefusedByRouterError
from rpod_schemas.config.service import BusConfig
from rpod_schemas.topics import TRUTH

PERIOD_S = 0.004
"""Time between two messages of truth (ICD)."""


class Stream:
    """Messages of truth from motion to the logger, as fast as in a run, and when each arrived."""

    def __init__(self, bus: SecureBus, stack: ExitStack) -> None:
        motion = stack.enter_context(bus.node("motion"))
        logger = stack.enter_context(bus.node("logger"))
        self.inbox = Inbox(1 << 20)
        logger.subscribe(TRUTH, self.inbox.put, recover=True, history=True)
        self.publisher = motion.publisher(TRUTH)
        self._stop = Event()
        self._thread = Thread(target=self._publish)
        self.arrivals_s: dict[int, float] = {}

    def _publish(self) -> None:
        while not self._stop.wait(PERIOD_S):
            self.publisher.put(b"\0\1\0\0truth")

    def __enter__(self) -> "Stream":
        self._thread.start()
        deadline_s = monotonic() + TIMEOUT_S
        while not self.arrivals_s and monotonic() < deadline_s:
            self.take_for(0.3)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def take_for(self, duration_s: float) -> None:
        """Take what arrives."""
        until_s = monotonic() + duration_s
        while (left_s := until_s - monotonic()) > 0:
            for received in self.inbox.wait(left_s):
                self.arrivals_s.setdefault(received.attachment.sequence, monotonic())

    def take_until_quiet(self) -> None:
        """Take what arrives until nothing comes of a hundred more messages."""
        deadline_s, arrived, published = monotonic() + TIMEOUT_S, -1, 0
        while monotonic() < deadline_s:
            self.take_for(0.1)
            if len(self.arrivals_s) != arrived:
                arrived, published = len(self.arrivals_s), self.publisher.published
            elif self.publisher.published > published + 100:
                return

    def finish(self) -> tuple[int, float]:
        """Return the number of messages that never came, and the longest time without any, s."""
        self._stop.set()
        self._thread.join()
        deadline_s = monotonic() + TIMEOUT_S
        while len(self.arrivals_s) < self.publisher.published and monotonic() < deadline_s:
            self.take_for(0.1)
        times = sorted(self.arrivals_s.values())
        gap_s = max(after - before for before, after in pairwise(times))
        return self.publisher.published - len(self.arrivals_s), gap_s


@pytest.fixture
def bus(tmp_path: Path) -> SecureBus:
    return SecureBus(tmp_path)


def short_lived(bus: SecureBus, stack: ExitStack) -> tuple[Stream, float]:
    """Return a stream whose certificate ends soon, and when it ends, by the monotonic clock.

    On a loaded machine the certificate may end before the stream is there; then it gets a longer one.
    """
    for validity_s in (3, 10, 30):
        bus.authority.renew("motion", validity=timedelta(seconds=validity_s))
        end_s = monotonic() + validity_s
        with ExitStack() as tried, suppress(RefusedByRouterError):
            stream = tried.enter_context(Stream(bus, tried))
            if monotonic() < end_s - 1.0:
                stack.push(tried.pop_all())
                return stream, end_s
    raise AssertionError("the machine stands still")


def test_a_certificate_that_was_replaced_before_its_end_costs_no_message(bus: SecureBus, record_property):
    with ExitStack() as stack:
        stack.enter_context(bus.open_router())
        stream, end_s = short_lived(bus, stack)
        bus.authority.renew("motion")
        stream.take_for(end_s - monotonic() + 0.3)
        missed, gap_s = stream.finish()
    record_property("measured", f"gap {gap_s * 1e3:.0f} ms, {missed} of {len(stream.arrivals_s)} missed")
    assert missed == 0


def test_a_certificate_that_ends_takes_the_client_off_the_bus(bus: SecureBus):
    with ExitStack() as stack:
        stack.enter_context(bus.open_router())
        stream, end_s = short_lived(bus, stack)
        stream.take_for(end_s - monotonic() + 0.2)
        stream.take_until_quiet()
        assert 0 < len(stream.arrivals_s) < stream.publisher.published - 100


def test_a_restart_of_the_router_costs_no_message_and_gives_new_rules(bus: SecureBus, record_property):
    with ExitStack() as stack:
        router = bus.open_router()
        stream = stack.enter_context(Stream(bus, stack))
        bus.authority.renew("router")
        bus.authority.revoke("view")
        bus.write_rules()
        router.close()
        stack.enter_context(bus.open_router())
        stream.take_for(1.5)
        missed, gap_s = stream.finish()
    record_property("measured", f"gap {gap_s * 1e3:.0f} ms, {missed} of {len(stream.arrivals_s)} missed")
    assert missed == 0


# --- connections that say nothing ---


def connections(endpoint: str, count: int, stack: ExitStack, first: bytes) -> None:
    host, _, port = endpoint.split("/")[1].partition(":")
    for _ in range(count):
        link = stack.enter_context(socket.create_connection((host, int(port)), timeout=5.0))
        if first:
            link.send(first)


@pytest.mark.parametrize("first", [b"", b"\x40\x00\x01\x02"], ids=["idle", "half a message"])
def test_a_thousand_silent_connections_keep_no_client_of_a_plain_bus_out(first: bytes, record_property):
    with plain_router() as endpoint, ExitStack() as stack:
        connections(endpoint, 1000, stack, first)
        begin_s = monotonic()
        open_client(BusConfig(connect=endpoint, connect_timeout_s=TIMEOUT_S)).close()
        record_property("measured", f"a client was in after {monotonic() - begin_s:.1f} s")


@pytest.mark.parametrize("first", [b"", b"\x16\x03\x01\x02\x00\x01"], ids=["idle", "half a handshake"])
def test_clients_that_are_in_stay_while_others_never_finish_their_handshake(
    bus: SecureBus, first: bytes, record_property
):
    """Zenoh waits 0.1 s after each failed handshake: newcomers wait, who is in does not notice."""
    with ExitStack() as stack:
        stack.enter_context(bus.open_router())
        stream = stack.enter_context(Stream(bus, stack))
        connections(bus.endpoint, 30, stack, first)
        stream.take_for(0.5)
        begin_s = monotonic()
        open_client(bus.bus("view", connect_timeout_s=TIMEOUT_S)).close()
        took_s = monotonic() - begin_s
        missed, gap_s = stream.finish()
    record_property("measured", f"a client was in after {took_s:.1f} s, gap {gap_s * 1e3:.0f} ms")
    assert missed == 0
