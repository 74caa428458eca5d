"""Tells on the bus, and so to the log, which faults a service injects (topic ``faults``, ICD section 2)."""

import logging
from collections.abc import Iterable
from typing import Protocol

from rpod_runtime.delivery.publisher import Publisher
from rpod_schemas.faults.injected import InjectedFault, write_faults
from rpod_schemas.topics import FAULTS, Topic

log = logging.getLogger(__name__)

_MOST_FAULTS = 500
"""Largest number of faults in a message; the earliest are left out."""


class Publishes(Protocol):
    """Part of a node that the book needs."""

    def publisher(self, topic: Topic) -> Publisher:
        """Declare a publisher."""
        ...


class FaultBook:
    """The faults that a service has injected. The first one opens the publisher."""

    def __init__(self, node: Publishes) -> None:
        self._node = node
        self._publisher: Publisher | None = None
        self._faults: dict[tuple[str, str, int], InjectedFault] = {}

    def publish(self, faults: Iterable[InjectedFault]) -> None:
        """Publish faults that are new or whose end has changed, each in a message with all before it."""
        for fault in faults:
            if self._faults.get(fault.identity) == fault:
                continue
            self._faults[fault.identity] = fault
            while len(self._faults) > _MOST_FAULTS:
                del self._faults[next(iter(self._faults))]
            log.info("fault %s%s", fault.fault, f" of {fault.where}" if fault.where else "")
            self._publisher = self._publisher or self._node.publisher(FAULTS)
            self._publisher.publish(write_faults(fault.begin_ns, self._faults.values()))
