"""A process in reserve: warm, but not on the bus until the process that it replaces has ended.

``rpod up`` starts it like the service, with ``$RPOD_RESERVE`` set. It reads its configuration, imports, warms
up, and waits before it opens its node. Its turn has come when the service manager writes to its standard
input.
"""

import logging
import os
from threading import Event

from rpod_runtime.errors import NotNeededError
from rpod_runtime.process.notify import manager

log = logging.getLogger(__name__)

RESERVE = "RPOD_RESERVE"
"""Environment variable that the service manager sets for a process in reserve."""
_POLL_S = 0.25
"""Longest time until a process in reserve notices that it is to stop."""

called = Event()
"""Whether the turn of this process has come; set by the thread that reads standard input."""


def await_turn(stop: Event) -> None:
    """Wait until the turn of this process has come; return at once if it is not in reserve.

    Raises:
        NotNeededError: it was stopped before.
    """
    if not os.environ.pop(RESERVE, ""):  # once a process, and not in its children
        return
    log.info("ready to take over, in reserve")
    manager.in_reserve()
    while not called.wait(_POLL_S):
        if stop.is_set():
            raise NotNeededError
    log.info("takes over")
