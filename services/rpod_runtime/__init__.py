"""Common base of all services: session, publishers, subscriptions, health, clock and life cycle."""

from rpod_runtime.clock import BusClock, Clock, WallClock
from rpod_runtime.errors import BusError, NoRouterError, QueryFailedError
from rpod_runtime.inbox import Inbox, Received
from rpod_runtime.node import Node
from rpod_runtime.publisher import Publisher

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
