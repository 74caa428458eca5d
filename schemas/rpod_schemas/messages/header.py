"""Stamps and headers, and the rejection of messages with an invalid field."""

from collections.abc import Callable
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from rpod_schemas.bounds import TEXT, Bound
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.rmw.cdr import NANOSECONDS, checked_stamp, message_class

ModelT = TypeVar("ModelT", bound=BaseModel)
CheckedT = TypeVar("CheckedT")


def read_stamp(header: Any) -> int:
    """Return the stamp of a header or Clock, ns."""
    time = header.stamp if hasattr(header, "stamp") else header.clock
    return checked_stamp(time.sec, time.nanosec)


def write_stamp(stamp_ns: int) -> Any:
    """Return a builtin_interfaces/Time."""
    seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS)
    return message_class("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds)


def write_header(stamp_ns: int, frame_id: str) -> Any:
    """Return a std_msgs/Header."""
    return message_class("std_msgs/msg/Header")(stamp=write_stamp(stamp_ns), frame_id=frame_id)


def build(model: type[ModelT], **fields: Any) -> ModelT:
    """Return a domain type, or reject the message if the type does not accept a value."""
    try:
        return model(**fields)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in problem["loc"])
        reason = Reason.NOT_FINITE if "not finite" in problem["msg"] else Reason.MALFORMED
        text = f"{field} {problem['msg'].removeprefix('Value error, ')}"
        raise MessageRejectedError(reason, text.strip()) from error


def within(bound: Bound, field: str, value: CheckedT) -> CheckedT:
    """Return a field's number or array, or reject the message if a value is beyond the limits."""
    return accepted(bound.check, field, value)


def accepted(check: Callable[[CheckedT], CheckedT], field: str, value: CheckedT) -> CheckedT:
    """Return the checked value of a field, or reject the message if it is invalid."""
    try:
        return check(value)
    except ValueError as error:
        reason = Reason.NOT_FINITE if "not finite" in str(error) else Reason.MALFORMED
        raise MessageRejectedError(reason, f"{field} {error}") from error


def read_text(field: str, text: str) -> str:
    """Return a text of a message, or reject the message if the text is too long."""
    within(TEXT, f"length of {field}", len(text))
    return text
