"""Waits until the log has what a service has published, before that service is stopped.

What a receiver has missed it gets from the cache of the publisher, which ends with the publisher. A logger
that stood still meanwhile could not ask for it any more.
"""

import logging
import time
from collections.abc import Callable

from rpod_runtime import Node, QueryFailedError
from rpod_runtime.awake import AwakeClock
from rpod_schemas.control import StatusReply
from rpod_schemas.types import PUBLISHED

log = logging.getLogger(__name__)

_ANSWER_S = 2.0
_PATIENCE_S = 20.0
"""Longest time until the logger answers."""
_PROGRESS_S = 2.0
"""Longest time in which nothing of what is missing arrives: it does not come any more. Publishers tell their
last numbers each 0.2 s."""
_POLL_S = 0.05


def await_logged(node: Node, service: str, logger: str, *, check: Callable[[], None]) -> bool:
    """Wait until the logger has received all that a service has published by now; return whether it has.

    ``check`` is called in each turn, and may raise if a service has died. A topic that the logger does not
    record is left out. The messages of several publishers of one topic are counted together.
    """
    published = {
        name.removeprefix(PUBLISHED): count
        for name, count in _counters(node, service).items()
        if name.startswith(PUBLISHED)
    }
    clock, least, since_s = AwakeClock(2.0 * _ANSWER_S), float("inf"), 0.0
    while published:
        check()
        heard = _counters(node, logger)
        missing = _missing(published, heard)
        now_s = clock.now_s()
        if heard and not missing:
            break
        if sum(missing.values()) < least:
            least, since_s = sum(missing.values()), now_s
        if now_s > _PATIENCE_S or (heard and now_s - since_s > _PROGRESS_S):
            log.warning("of %s the logger has not received: %s", service, missing or "it does not answer")
            return False
        time.sleep(_POLL_S)
    return True


def _missing(published: dict[str, int], heard: dict[str, int]) -> dict[str, int]:
    """Return the number of messages that the logger has neither received nor given up, by topic."""
    settled = {
        topic: heard.get(f"received/{topic}", 0) + heard.get(f"missed/{topic}", 0) for topic in published
    }
    return {topic: count - settled[topic] for topic, count in published.items() if 0 < settled[topic] < count}


def _counters(node: Node, service: str) -> dict[str, int]:
    try:
        return node.ask(service, "status", StatusReply, timeout_s=_ANSWER_S).counters
    except QueryFailedError:
        return {}
