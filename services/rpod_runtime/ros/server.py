"""Answers ROS 2 service calls in rmw_zenoh's form.

Source: rmw_zenoh's ``rmw_service_data.cpp`` and ``rmw_client_data.cpp``. A client sends a query with CDR as
payload and an attachment with its sequence number and gid. It finds the call that a reply belongs to by these
two alone, and takes no notice of an error reply: without a normal reply it waits.
"""

import logging
import time
from collections.abc import Callable
from typing import Any

import zenoh

from rpod_runtime.requests.identity import check_size
from rpod_runtime.requests.replies import error_reply
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.rmw.cdr import decode, encode
from rpod_schemas.rmw.wire import Attachment, unpack_attachment
from rpod_schemas.topics import Namespace, Service

log = logging.getLogger(__name__)

Answer = Callable[[Any], Any]
"""Turns the message of a request into that of its response; any exception becomes a refusal."""
Refuse = Callable[[str], Any]
"""Returns the message of a response that gives a reason."""


class ServiceServer:
    """Answers the calls of one service; it runs in the threads of the bus."""

    def __init__(
        self, session: zenoh.Session, keys: Namespace, service: Service, *, answer: Answer, refuse: Refuse
    ) -> None:
        self._service, self._answer, self._refuse = service, answer, refuse
        self._key = keys.key(service)
        # Clients ask queryables that are complete, and a Humble client has no hash in its key.
        self._queryable = session.declare_queryable(keys.selector(service), self._take, complete=True)

    def close(self) -> None:
        """Take the service off the bus."""
        self._queryable.undeclare()  # type: ignore[no-untyped-call]

    def _take(self, query: zenoh.Query) -> None:
        with query:
            try:
                called = unpack_attachment(query.attachment.to_bytes() if query.attachment else None)
            except MessageRejectedError as error:  # without it no reply can be matched to its call
                log.warning("refused a call of %s: %s", self._service.name, error)
                query.reply_err(f"{self._service.name}: {error}")
                return
            payload = encode(self._response(query.payload.to_bytes() if query.payload else b""))
            key = str(query.key_expr)
            attachment = Attachment(called.sequence, time.time_ns(), called.gid)
            query.reply(self._key if "*" in key else key, bytes(payload), attachment=attachment.pack())

    def _response(self, payload: bytes) -> Any:
        try:
            check_size(len(payload))
            return self._answer(decode(payload, f"{self._service.type}_Request"))
        except Exception as error:  # noqa: BLE001 - the caller gets any error as a reply
            told = error_reply(error)
            return self._refuse(f"{told.error}: {told.message}")
