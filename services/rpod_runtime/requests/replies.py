"""Converts errors to replies of the control plane, and such replies back to text."""

import logging

from pydantic import ValidationError

from rpod_runtime.errors import RefusedError
from rpod_schemas.control import ErrorReply
from rpod_schemas.errors import SchemaError
from rpod_security.errors import SecurityError

log = logging.getLogger(__name__)


def error_reply(error: Exception) -> ErrorReply:
    """Return the reply that carries the class and the text of an error."""
    if isinstance(error, ValidationError):
        problem = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in problem["loc"]) or "request"
        return ErrorReply(error="BadRequest", message=f"{field}: {problem['msg']}")
    if not isinstance(error, SchemaError | RefusedError | SecurityError):
        log.error("a query failed with an unexpected error", exc_info=error)
    return ErrorReply(error=type(error).__name__, message=str(error))


def error_text(payload: bytes) -> str:
    """Return the text of an error reply."""
    try:
        reply = ErrorReply.model_validate_json(payload)
    except ValidationError:
        return payload.decode(errors="replace")
    return f"{reply.error}: {reply.message}"
