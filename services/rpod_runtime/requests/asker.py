"""Asks other services by queries of the control plane (ICD section 4)."""

import time
from contextlib import suppress
from threading import Event
from typing import TypeVar

import zenoh
from pydantic import BaseModel, ValidationError

from rpod_runtime.errors import QueryFailedError
from rpod_runtime.process.awake import AwakeClock
from rpod_runtime.requests.identity import Identity
from rpod_runtime.requests.replies import error_text
from rpod_schemas.control import Empty
from rpod_schemas.topics import Namespace

ReplyT = TypeVar("ReplyT", bound=BaseModel)

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

    def ask_all(self, verb: str, reply: type[ReplyT], *, timeout_s: float = 1.0) -> list[ReplyT]:
        """Query every service that answers a verb; invalid and missing answers are left out."""
        answers = self._session.get(
            self._keys.control("*", verb, self._identity.name),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=Empty().model_dump_json(),
            timeout=timeout_s,
        )
        replies = []
        for answer in answers:
            with suppress(ValidationError):
                if answer.ok:
                    replies.append(reply.model_validate_json(answer.ok.payload.to_bytes()))
        return replies
