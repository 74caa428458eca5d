"""Asks other services by queries of the control plane (ICD section 4)."""

import time
from threading import Event
from typing import TypeVar

import zenoh
from pydantic import BaseModel, ValidationError

from rpod_runtime.errors import QueryFailedError
from rpod_runtime.process.awake import AwakeClock
from rpod_runtime.requests.identity import Identity
from rpod_runtime.requests.replies import error_text
from rpod_schemas.control import Empty, StatusReply
from rpod_schemas.topics import Namespace

ReplyT = TypeVar("ReplyT", bound=BaseModel)
MOST_SERVICES = 1000
"""Largest number of services whose answers to one question count."""
_STATUS = "status"
_LONGEST_STATUS = 8 << 20
"""Largest answer that is read, bytes; it has the counters and the configuration of a service."""

_DISCOVERY_S, _RETRY_S = 2.0, 0.05
"""Longest time until other sessions know what a service has just declared, and time between two tries."""


class Asker:
    """The part of a node that asks other services."""

    stop: Event
    _session: zenoh.Session
    _keys: Namespace
    _identity: Identity

    def ask(
        self,
        instance: str,
        verb: str,
        reply: type[ReplyT],
        request: BaseModel | None = None,
        *,
        timeout_s: float = 5.0,
    ) -> ReplyT:
        """Query another service's control plane.

        Raises:
            QueryFailedError: no answer in time, or an error reply.
        """
        key = self._keys.control(instance, verb, self._identity.name)
        answer = self._first_answer(key, (request or Empty()).model_dump_json(), timeout_s)
        if answer.ok is None:
            raise QueryFailedError(
                key, error_text(answer.err.payload.to_bytes()) if answer.err else "no answer"
            )
        try:
            return reply.model_validate_json(answer.ok.payload.to_bytes())
        except ValidationError as error:
            raise QueryFailedError(
                key, f"the answer is not a {reply.__name__}; does the service have the same version?"
            ) from error

    def _first_answer(self, key: str, payload: str, timeout_s: float) -> zenoh.Reply:
        """Return the first answer to a query; a service that has just started may not be known yet."""
        begin_s, clock = time.monotonic(), AwakeClock(5.0 * _RETRY_S)
        while True:
            asked_s = time.monotonic()
            for answer in self._session.get(key, payload=payload, timeout=timeout_s):
                return answer
            now_s = time.monotonic()  # a query that nobody serves ends at once, one without answer in time
            is_unanswered = now_s - asked_s > 0.9 * timeout_s
            if is_unanswered or clock.now_s() > min(_DISCOVERY_S, timeout_s) or self.stop.is_set():
                raise QueryFailedError(
                    key, f"no answer after {now_s - begin_s:.1f} s; is the service running?"
                )
            self.stop.wait(_RETRY_S)

    def ask_all(self, *, timeout_s: float = 1.0) -> list[StatusReply]:
        """Ask every service for its status; invalid and missing answers are left out.

        An answer counts only on the key of the service that it names: on a secure bus the router lets no
        service answer on the key of another one. Of each service one answer counts, of ``MOST_SERVICES`` at
        most.
        """
        answers = self._session.get(
            self._keys.control("*", _STATUS, self._identity.name),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=Empty().model_dump_json(),
            timeout=timeout_s,
        )
        found: dict[str, StatusReply] = {}
        for answer in answers:
            status = self._status_of(answer)
            if status is not None and len(found) < MOST_SERVICES:
                found.setdefault(status.name, status)
        return list(found.values())

    def _status_of(self, answer: zenoh.Reply) -> StatusReply | None:
        """Return the status of an answer; None if it is none, too long, or names another service."""
        if answer.ok is None or len(answer.ok.payload) > _LONGEST_STATUS:
            return None
        try:
            status = StatusReply.model_validate_json(answer.ok.payload.to_bytes())
        except ValidationError:
            return None
        own = self._keys.control(status.name, _STATUS, self._identity.name)
        return status if str(answer.ok.key_expr) == own else None
