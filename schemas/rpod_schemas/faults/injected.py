"""Faults that were injected, as the topic ``faults`` reports them (ICD section 2)."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.faults.planned import BY_NAME
from rpod_schemas.messages import read_diagnostics, write_diagnostics
from rpod_schemas.types import Diagnostic, Health

_LAST_NS = 2**62
_MOST_CHARACTERS = 19


@dataclass(frozen=True)
class InjectedFault:
    """A fault with its times."""

    fault: str
    """Name in the catalogue."""
    where: str
    """Name of the sensor or service; empty for all sensors, or for the disk."""
    begin_ns: int
    """First moment, ns of UTC."""
    end_ns: int | None = None
    """End, ns of UTC; None if it lasts until it is ended, or until the end of the run."""
    size: float | None = None
    """Size in the catalogue's unit; None if it has none, or if it was drawn."""

    @property
    def identity(self) -> tuple[str, str, int]:
        """Identity of the fault, which stays the same when its end becomes known."""
        return self.fault, self.where, self.begin_ns


def write_faults(stamp_ns: int, faults: Iterable[InjectedFault]) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray of at least one fault."""
    return write_diagnostics([_diagnostic_of(stamp_ns, fault) for fault in faults])


def _diagnostic_of(stamp_ns: int, fault: InjectedFault) -> Diagnostic:
    values = {"where": fault.where, "begin_ns": str(fault.begin_ns)}
    if fault.end_ns is not None:
        values["end_ns"] = str(fault.end_ns)
    if fault.size is not None:
        values["size"] = f"{fault.size:.9g}"
    cause = BY_NAME[fault.fault].cause if fault.fault in BY_NAME else ""
    return Diagnostic(stamp_ns=stamp_ns, name=fault.fault, level=Health.WARN, message=cause, values=values)


def read_faults(message: Any) -> list[InjectedFault]:
    """Return the faults of a message. Raises ``MessageRejectedError``."""
    return [_read(each) for each in read_diagnostics(message)]


def _read(diagnostic: Diagnostic) -> InjectedFault:
    values = diagnostic.values
    end = values.get("end_ns")
    try:
        size = float(values["size"]) if "size" in values else None
    except ValueError as error:
        text = f"size of a fault is {values['size'][:40]!r}, needs a number"
        raise MessageRejectedError(Reason.MALFORMED, text) from error
    return InjectedFault(
        fault=diagnostic.name,
        where=values.get("where", ""),
        begin_ns=_time_ns("begin_ns", values.get("begin_ns", "")),
        end_ns=None if end is None else _time_ns("end_ns", end),
        size=size,
    )


def _time_ns(name: str, text: str) -> int:
    """Return a time, ns of UTC; anybody may write any text."""
    if not (text.isascii() and text.isdecimal()) or len(text) > _MOST_CHARACTERS or int(text) > _LAST_NS:
        raise MessageRejectedError(Reason.MALFORMED, f"{name} of a fault is {text[:40]!r}, needs ns of UTC")
    return int(text)
