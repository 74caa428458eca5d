"""A service that must be the only one of its name, and of its topics, on a bus.

Two services of one name both answer each query and obey each command. From two publishers of one estimate a
controller receives both in turn. So the second service does not start. If two run nevertheless, for example
after a link was down, both report it. A second logger does no harm beside the first one, so it may start.
"""

import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from threading import Lock

import zenoh

from rpod_runtime.errors import AlreadyRunningError, QueryFailedError
from rpod_runtime.health import HealthBook
from rpod_runtime.requests.asker import Asker
from rpod_schemas.config.service import ServiceConfig
from rpod_schemas.control import StatusReply
from rpod_schemas.rmw.wire import publisher_tokens, session_of_token, token_pattern
from rpod_schemas.texts import shown
from rpod_schemas.topics import Topic

log = logging.getLogger(__name__)

_ENDING_S = 10.0
"""Longest time to wait for a service of the name that is ending, as one that is being restarted."""
_ANSWER_S = 1.0
_RETRY_S = 0.1
_TOKENS_S = 2.0
_MOST = 20
"""Largest number of others that are told."""
_LONGEST_ID = 32
"""Number of digits of a Zenoh identity; in a token anybody may write any text."""
_REMEDY = "stop one of them, or give one another instance and prefix"
ALARM = "second_service"
"""Name of the value in the diagnostics that tells of another service."""


@dataclass(frozen=True)
class Sole:
    """Name and topics that a service wants for itself alone."""

    topics: tuple[Topic, ...] = ()
    """Topics that nobody else may publish."""
    starts_beside: bool = False
    """Whether it starts although another service of its name is at work, and both say so."""


def be_sole(
    asker: Asker, session: zenoh.Session, config: ServiceConfig, sole: Sole, health: HealthBook
) -> Callable[[], None]:
    """Let a service be the only one of its name, and the only publisher of topics.

    Returns:
        Function that ends the watch for others that come.

    Raises:
        AlreadyRunningError: a service of the name is at work.
    """
    keys, instance = config.bus.keys, config.instance
    named = token_pattern(keys, "NN", instance)
    if not sole.starts_beside:
        _refuse_second(asker, session, named, instance)
    watched = {named: f"has the name {instance!r}"}
    watched |= {publisher_tokens(keys, topic): f"publishes {topic.name}" for topic in sole.topics}
    return _Watch(session, watched, health).end


def _refuse_second(asker: Asker, session: zenoh.Session, pattern: str, instance: str) -> None:
    """Return if no other service of the name answers on the bus.

    A service that is gone may leave its liveliness token until the router notices, but it does not answer. If
    one is ending, this waits for its end.

    Raises:
        AlreadyRunningError: a service of the name is at work.
    """
    deadline_s = time.monotonic() + _ENDING_S
    while list(_tokens(session, pattern)):
        try:
            status = asker.ask(instance, "status", StatusReply, timeout_s=_ANSWER_S)
        except QueryFailedError:
            return
        is_over = time.monotonic() > deadline_s or asker.stop.is_set()
        if status.state not in ("stopping", "failed") or is_over:
            raise AlreadyRunningError(instance, status.uptime_s)
        asker.stop.wait(_RETRY_S)


def _tokens(session: zenoh.Session, pattern: str) -> Iterator[str]:
    with suppress(zenoh.ZError):
        for reply in session.liveliness().get(pattern, timeout=_TOKENS_S):
            if reply.ok is not None:
                yield str(reply.ok.key_expr)


class _Watch:
    """Tells of other services by their liveliness tokens, in log and diagnostics.

    Args:
        session: session of the service.
        watched: what another service does, by the key expression of the tokens that show it.
        health: book of the service.
    """

    def __init__(self, session: zenoh.Session, watched: Mapping[str, str], health: HealthBook) -> None:
        self._own, self._health = str(session.zid()), health
        self._others: dict[str, str] = {}
        self._lock = Lock()
        self._declared = [
            session.liveliness().declare_subscriber(pattern, partial(self._take, what), history=True)
            for pattern, what in watched.items()
        ]

    def end(self) -> None:
        """End the watch."""
        for each in self._declared:
            each.undeclare()  # type: ignore[no-untyped-call]

    def _take(self, what: str, token: zenoh.Sample) -> None:
        key = str(token.key_expr)
        other = shown(session_of_token(key), _LONGEST_ID)
        if other == self._own:
            return
        with self._lock:
            if token.kind == zenoh.SampleKind.DELETE:
                self._others.pop(key, None)
            elif key not in self._others and len(self._others) < _MOST:
                self._others[key] = f"another service {what} (session {other}, this one is {self._own})"
                log.warning("%s; %s", self._others[key], _REMEDY)
            told = "; ".join(sorted(set(self._others.values())))
            self._health.alarm(ALARM, f"{told}; {_REMEDY}" if told else "")
