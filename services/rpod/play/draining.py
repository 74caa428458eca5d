"""Waits until the log has what a service has published, before that service is stopped.

A receiver gets the messages that it missed from the publisher's cache, which ends with the publisher. A
logger that stood still until then could not get them any more.
"""

import logging
import time
from collections.abc import Callable

from rpod_runtime import Node, QueryFailedError
from rpod_runtime.process.awake import AwakeClock
from rpod_schemas.control import StatusReply
from rpod_schemas.types import PUBLISHED

log = logging.getLogger(__name__)

_ANSWER_S = 2.0
"""Longest wait for one answer, s."""
_PATIENCE_S = 20.0
"""Longest time until all is received, s."""
_PROGRESS_S = 2.0
"""Time after which missing messages are given up if none of them arrives, s. Publishers tell their last
numbers each 0.2 s."""
_POLL_S = 0.05


def await_logged(node: Node, service: str, logger: str, *, check: Callable[[], None]) -> bool:
    """Wait until the logger has received all that a service has published by now; return whether it has.

    A topic that the logger does not record is left out. The messages of several publishers of one topic are
    counted together.

    Args:
        node: the node that asks.
        service: name of the service.
        logger: name of the logger.
        check: called in each turn; it may raise if a service has died.
    """
    published = _published(_counters(node, service))
    if not published:
        log.warning(
            "%s does not say what it has published; it is stopped without waiting for the log", service
        )
        return False
    clock, least, progress_s = AwakeClock(2.0 * _ANSWER_S), float("inf"), 0.0
    while True:
        check()
        received = _counters(node, logger)
        missing = _missing(published, received)
        if received and not missing:
            return True
        now_s = clock.now_s()
        if not received:
            progress_s = now_s  # it did not answer in time
        elif sum(missing.values()) < least:
            least, progress_s = sum(missing.values()), now_s
        if now_s > _PATIENCE_S or (received and now_s - progress_s > _PROGRESS_S):
            what = _listed(missing) if received else "an unknown number of messages, as it does not answer"
            log.warning("%s is stopped, but the logger lacks %s; the log will say so", service, what)
            return False
        time.sleep(_POLL_S)


def _published(counters: dict[str, int]) -> dict[str, int]:
    """Return the number of published messages by topic; empty for a service that did not answer."""
    return {
        name.removeprefix(PUBLISHED): count for name, count in counters.items() if name.startswith(PUBLISHED)
    }


def _missing(published: dict[str, int], received: dict[str, int]) -> dict[str, int]:
    """Return the number of messages that the logger has neither received nor given up, by topic."""
    settled = {
        topic: received.get(f"received/{topic}", 0) + received.get(f"missed/{topic}", 0)
        for topic in published
    }
    return {topic: count - settled[topic] for topic, count in published.items() if 0 < settled[topic] < count}


def _listed(missing: dict[str, int]) -> str:
    return ", ".join(f"{count} of {topic}" for topic, count in sorted(missing.items()))


def _counters(node: Node, service: str) -> dict[str, int]:
    """Return the counters of a service; empty if it does not answer."""
    try:
        return node.ask(service, "status", StatusReply, timeout_s=_ANSWER_S).counters
    except QueryFailedError:
        return {}
