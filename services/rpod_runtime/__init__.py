"""Common base of all services: session, publishers, subscriptions, health, clock and life cycle.

Names are imported when they are first used. A router needs neither them nor the numerical libraries that they
import, and so restarts sooner.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rpod_runtime.clock import BusClock, Clock, WallClock
    from rpod_runtime.delivery.inbox import Inbox, Received
    from rpod_runtime.delivery.publisher import Publisher
    from rpod_runtime.errors import BusError, NoRouterError, QueryFailedError
    from rpod_runtime.node import Node

_MODULES = {
    "BusClock": "clock",
    "BusError": "errors",
    "Clock": "clock",
    "Inbox": "delivery.inbox",
    "NoRouterError": "errors",
    "Node": "node",
    "Publisher": "delivery.publisher",
    "QueryFailedError": "errors",
    "Received": "delivery.inbox",
    "WallClock": "clock",
}

__all__ = [
    "BusClock",
    "BusError",
    "Clock",
    "Inbox",
    "NoRouterError",
    "Node",
    "Publisher",
    "QueryFailedError",
    "Received",
    "WallClock",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
