"""Stamps and headers, and how a refused field becomes a rejected message."""

from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from rpod_schemas.cdr import NANOSECONDS, checked_stamp, message_class
from rpod_schemas.errors import MessageRejectedError, Reason

ModelT = TypeVar("ModelT", bound=BaseModel)


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
    """Build a domain type; what it refuses is a rejected message."""
    try:
        return model(**fields)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in problem["loc"])
        reason = Reason.NOT_FINITE if "not finite" in problem["msg"] else Reason.MALFORMED
        raise MessageRejectedError(
            reason, f"{field} {problem['msg'].removeprefix('Value error, ')}"
        ) from error
