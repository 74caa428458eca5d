"""The errors of this package; each names what is wrong, where, and why."""

from enum import StrEnum
from pathlib import Path
from typing import Any

from rpod_schemas.texts import shown


class RpodError(Exception):
    """Root of all errors of the project.

    It can be pickled with its text and its fields. By default, unpickling calls the class with ``args``,
    which hold the text, but these classes take facts and compose the text from them. Without this method, the
    error of a worker could not be read by the process that waits for it.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), self.args, self.__dict__)


def _restored(kind: type[RpodError], args: tuple[Any, ...], fields: dict[str, Any]) -> RpodError:
    error = kind.__new__(kind, *args)  # sets ``args``; the text is composed already
    error.__dict__.update(fields)
    return error


class SchemaError(RpodError):
    """Root of the errors that this package raises."""


class ConfigurationError(SchemaError):
    """Raised for a configuration that cannot be used; names source, field and reason in one line."""

    def __init__(self, source: Path | str, field: str, reason: str) -> None:
        self.source, self.field, self.reason = str(source), field, reason
        where = f"{source}: {field}" if field else str(source)
        super().__init__(f"{where}: {reason}")


class Reason(StrEnum):
    """Reason for which a message was rejected, as counted in ``diagnostics``."""

    MALFORMED = "malformed"
    WRONG_TYPE = "wrong_type"
    WRONG_SIZE = "wrong_size"
    NOT_FINITE = "not_finite"
    EMPTY = "empty"
    DUPLICATE = "duplicate"
    JUMP = "sequence_jump"
    LATE = "late"
    FUTURE = "future"
    CLOCK_STEP = "clock_step"
    UNKNOWN_FRAME = "unknown_frame"
    OTHER_CAMERA = "other_camera"
    OTHER_SETUP = "other_setup"
    SECOND_PUBLISHER = "second_publisher"
    SECOND_SOURCE = "second_source"
    FROZEN = "frozen"
    TOO_MANY = "too_many"
    TOO_LONG = "too_long"
    OLD_ATTACHMENT = "old_attachment"


class MessageRejectedError(SchemaError):
    """Raised for a message that cannot be used, with the reason under which it is counted.

    The text may quote a name of the message, and stands in log lines and in each diagnostics message.
    """

    def __init__(self, reason: Reason, text: str) -> None:
        text = shown(text)
        self.reason, self.text = reason, text
        super().__init__(f"{reason}: {text}")
