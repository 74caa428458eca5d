"""Faults by name, and faults that are planned for a time."""

from difflib import get_close_matches
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from rpod_schemas.config.base import Config, Name, NonNegative, Positive
from rpod_schemas.errors import SchemaError
from rpod_schemas.faults.facility import FACILITY_FAULTS
from rpod_schemas.faults.fault import Fault
from rpod_schemas.faults.sensor import FAULTS

ALL_FAULTS = FAULTS + FACILITY_FAULTS
"""All kinds of faults."""
BY_NAME = {fault.name: fault for fault in ALL_FAULTS}


def known_fault(name: str) -> Fault:
    """Return a fault by its name.

    Raises:
        SchemaError: there is none of this name.
    """
    if name not in BY_NAME:
        meant = get_close_matches(name.lower(), BY_NAME, n=1)
        guess = f"; did you mean {meant[0]}?" if meant else ""
        raise SchemaError(f"no fault {name!r}{guess}; known are {', '.join(BY_NAME)}")
    return BY_NAME[name]


def _known_name(name: str) -> str:
    try:
        return known_fault(name).name
    except SchemaError as error:
        raise ValueError(str(error)) from error


FaultName = Annotated[str, AfterValidator(_known_name)]
"""Name of a fault of the catalogue."""


class AskedFault(Config):
    """A fault that is asked for: what, where, how large."""

    fault: FaultName
    """Name of a fault of the catalogue, as dropout, blackout, silence, kill, link_delay."""
    sensor: Name | None = None
    """Name of the sensor; all that can have the fault if left out."""
    service: Name | None = None
    """Service whose link or process has the fault, for ``link_...``, ``kill``, ``stop`` and ``slow``."""
    size: float | None = Field(default=None, allow_inf_nan=False)
    """Size of the fault in the catalogue's unit; the catalogue's own size if left out."""

    @property
    def kind(self) -> Fault:
        """Entry of the catalogue."""
        return known_fault(self.fault)

    @property
    def amount(self) -> float | None:
        """Size of the fault; None if it has none, or if it is drawn."""
        return self.kind.amount(self.size)

    @property
    def where(self) -> str:
        """Name of the sensor or service; empty for all."""
        return self.sensor or self.service or ""

    @model_validator(mode="after")
    def _fits_the_kind(self) -> Self:
        kind, size = self.kind, self.kind.size
        has_service = kind.subject in ("link", "process")
        if has_service != (self.service is not None):
            raise ValueError(
                f"{self.fault} needs service, the one that has it"
                if has_service
                else f"service: {self.fault} is not a fault of a service; leave service out"
            )
        if self.sensor is not None and not kind.of_sensor:
            raise ValueError(f"sensor: {self.fault} is not a fault of a sensor; leave sensor out")
        if self.size is not None and size is None:
            raise ValueError(f"size: {self.fault} has only one size; leave it out")
        if self.size is not None and size is not None and not size.low <= self.size <= size.high:
            raise ValueError(
                f"size is {self.size:g}, {self.fault} takes {size.low:g} to {size.high:g} {size.unit}"
            )
        return self


class PlannedFault(AskedFault):
    """A fault at a time of the scenario."""

    start_s: NonNegative = 0.0
    """Start, s from the epoch. At 0 a sensor has the fault before its first frame."""
    duration_s: Positive | None = Field(default=None)
    """Duration, s; until the end if left out."""

    @model_validator(mode="after")
    def _ends(self) -> Self:
        if self.fault == "kill" and self.duration_s is None:
            raise ValueError("duration_s: kill needs it, the time until the service is started again")
        return self
