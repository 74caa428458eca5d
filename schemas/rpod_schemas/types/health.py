"""Health of services, and how sensors keep time."""

from collections.abc import Mapping
from enum import IntEnum
from typing import Annotated, Literal

from pydantic import Field

from rpod_schemas.bounds import Stamp, Text
from rpod_schemas.types.base import Model

SYNC = "sync/"
"""First part of the names of values in diagnostics that state how sensors keep time."""


class SensorSync(Model):
    """How a sensor keeps time, as its driver knows it; None for what is not known."""

    ptp: Literal["locked", "unlocked", "none"] | None = None
    """Whether the sensor's clock is locked to a PTP master."""
    ptp_offset_s: float | None = None
    """Offset from the PTP master, s."""
    trigger: Literal["hardware", "software", "none"] | None = None
    """Source of the trigger of each frame."""
    trigger_missed: Annotated[int, Field(ge=0)] | None = None
    """Number of triggers without a frame."""
    stamp_source: Literal["device", "mapped", "host"] | None = None
    """Clock that stamps the frames: the device's own, this clock mapped to the host's by the least delay, or
    the host's at the arrival of the frame."""

    def values(self, sensor: str) -> dict[str, str]:
        """Return what is known as values of diagnostics (ICD section 2)."""
        known = self.model_dump(exclude_none=True)
        return {f"{SYNC}{sensor}/{name}": f"{value}" for name, value in known.items()}

    @classmethod
    def read(cls, sensor: str, values: Mapping[str, str]) -> "SensorSync | None":
        """Return the synchronisation of a sensor that diagnostics state; None if they state none.

        Raises:
            pydantic.ValidationError: a value is not one of those of the ICD.
        """
        prefix = f"{SYNC}{sensor}/"
        stated = {name: value for key, value in values.items() if (name := key.removeprefix(prefix)) != key}
        return (
            cls.model_validate({name: stated[name] for name in cls.model_fields if name in stated})
            if stated
            else None
        )


class Health(IntEnum):
    """Level of a diagnostic (diagnostic_msgs/DiagnosticStatus)."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


PUBLISHED = "published/"
"""Beginning of the names of counters in a diagnostic: messages that the service published, by topic."""


CLOSING = "closing"
"""Name of the value that is ``true`` in the last diagnostic of a service: it publishes nothing after it."""


class Diagnostic(Model):
    """Health of one service; also its heartbeat."""

    stamp_ns: Stamp
    name: Text
    """Name of the service's instance."""
    level: Health
    message: Text
    values: dict[str, str]
