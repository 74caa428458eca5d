"""The serving side of the control plane: JSON queries, answered by a model or by an error (ICD section 4)."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, TypeVar

import zenoh
from pydantic import BaseModel

from rpod_runtime.health import HealthBook
from rpod_runtime.requests.identity import Identity, check_size
from rpod_runtime.requests.replies import error_reply
from rpod_schemas.topics import Namespace
from rpod_security.errors import AuditError

RequestT = TypeVar("RequestT", bound=BaseModel)
_STATUS = "status"
"""The verb that is asked often and changes nothing; no record is kept of it."""


@dataclass(frozen=True)
class Served(Generic[RequestT]):
    """A verb that a service answers. An exception of the handler becomes an error reply."""

    keys: Namespace
    instance: str
    verb: str
    request: type[RequestT]
    handler: Callable[[RequestT], BaseModel]
    identity: Identity
    health: HealthBook

    @property
    def key(self) -> str:
        """Key expression of the queryable."""
        return self.keys.control(self.instance, self.verb, self.identity.served)

    def answer(self, query: zenoh.Query) -> None:
        """Answer a query, in the bus's thread."""
        with query:
            asker = ""
            try:
                payload = query.payload
                asker = self.identity.asker(str(query.key_expr), self.verb)
                check_size(len(payload) if payload else 0)
                asked = self.request.model_validate_json(payload.to_bytes() if payload else b"{}")
                request = asked.model_dump_json()
                self._keep(asker, request, "asked")  # what cannot be recorded is not done
                reply = self.handler(asked).model_dump_json()
                self._keep(asker, request, "accepted")
            except Exception as error:  # noqa: BLE001 - the client gets any error as a reply
                self._refuse(query, asker, error)
            else:
                query.reply(self.keys.control(self.instance, self.verb, asker), reply)
                if self.verb != _STATUS:
                    self.health.note_command(self.verb, request, asker)

    def _refuse(self, query: zenoh.Query, asker: str, error: Exception) -> None:
        answer = error_reply(error)
        query.reply_err(answer.model_dump_json())
        with suppress(AuditError):  # nothing was done; the next command is refused with this error
            if asker and not isinstance(error, AuditError):
                self._keep(asker, "", f"{answer.error}: {answer.message}")
                return
        self.health.count(f"refused/{self.verb}")

    def _keep(self, asker: str, request: str, outcome: str) -> None:
        if asker and self.verb != _STATUS:
            self.identity.record(asker=asker, verb=self.verb, request=request, outcome=outcome)
