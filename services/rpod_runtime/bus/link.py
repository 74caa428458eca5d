"""Watches the link of a process to the router: when it was lost, and when it was regained.

Zenoh reconnects by itself without a message, so each process reports an outage: in a log line, and in its
diagnostics afterwards. A closed link (a router that was ended or killed) is noticed at once. A link that is
silent without being closed, as after a cable was pulled, is noticed after Zenoh's lease of 10 s.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from threading import Lock

import zenoh

from rpod_runtime.health import HealthBook

log = logging.getLogger(__name__)

MOST_OUTAGES = 1000
"""Largest number of outages that are remembered; beyond it, the earliest two become one."""


@dataclass(frozen=True)
class Outage:
    """A time without a link to the router."""

    begin_ns: int
    """First moment, ns of UTC."""
    end_ns: int | None = None
    """Last moment, ns of UTC; None while it lasts."""

    def __str__(self) -> str:
        begin = utc(self.begin_ns)
        if self.end_ns is None:
            return f"since {begin}"
        return f"{begin} to {utc(self.end_ns)} ({(self.end_ns - self.begin_ns) * 1e-9:.1f} s)"


def utc(stamp_ns: int) -> str:
    """Return a time as text: ISO 8601, UTC, milliseconds."""
    moment = datetime.fromtimestamp(stamp_ns // 1_000_000 / 1e3, UTC)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{moment.microsecond // 1000:03d}Z"


class Link:
    """Watches the link of a session. Zenoh calls it from a thread of its own."""

    def __init__(self, health: HealthBook, endpoint: str) -> None:
        self._health, self._endpoint = health, endpoint
        self._lock = Lock()
        self._routers: set[str] = set()
        self._outages: list[Outage] = []

    def watch(self, session: zenoh.Session) -> Callable[[], None]:
        """Watch an open session; returns the function that ends it."""
        listener = session.info.declare_transport_events_listener(self._take_event, history=True)
        return listener.undeclare

    @property
    def lost(self) -> bool:
        """Whether there is no link now."""
        with self._lock:
            return bool(self._outages) and self._outages[-1].end_ns is None

    def outages(self, since_ns: int = 0) -> tuple[Outage, ...]:
        """Return the outages that ended after a time, or last still, in their order."""
        with self._lock:
            return tuple(each for each in self._outages if each.end_ns is None or each.end_ns > since_ns)

    def _take_event(self, event: zenoh.TransportEvent) -> None:
        if event.transport.whatami != zenoh.WhatAmI.ROUTER:
            return
        self.note(str(event.transport.zid), opened=event.kind == zenoh.SampleKind.PUT, now_ns=time.time_ns())

    def note(self, router: str, *, opened: bool, now_ns: int) -> None:
        """Note that the link to a router, by its Zenoh identity, was opened or closed; ns of UTC."""
        with self._lock:
            had = bool(self._routers)
            if opened:
                self._routers.add(router)
            else:
                self._routers.discard(router)
            lost = had and not self._routers
            if lost:
                self._begin(now_ns)
            regained = self._end(now_ns) if opened else None
        if lost:
            log.error(
                "bus lost: the link to the router at %s is gone; is the router running?", self._endpoint
            )
            self._health.count("bus/lost")
            self._health.warn("bus/outage", str(Outage(now_ns)))
        if regained is not None:
            log.warning("bus regained: the link was lost %s", regained)
            self._health.warn("bus/outage", str(regained))

    def _begin(self, now_ns: int) -> None:
        if len(self._outages) >= MOST_OUTAGES:
            first = self._outages.pop(0)
            self._outages[0] = replace(self._outages[0], begin_ns=first.begin_ns)
        self._outages.append(Outage(now_ns))

    def _end(self, now_ns: int) -> Outage | None:
        """Return the outage that ends now, if one lasted."""
        if not self._outages or self._outages[-1].end_ns is not None:
            return None
        self._outages[-1] = replace(self._outages[-1], end_ns=now_ns)
        return self._outages[-1]
