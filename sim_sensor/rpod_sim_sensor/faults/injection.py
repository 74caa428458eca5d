"""The interface of an injection, and the look-up by the fault's name."""

import copy
import zlib
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from rpod_schemas.errors import SchemaError
from rpod_schemas.faults import known_fault
from rpod_schemas.messages import read_stamp, write_stamp
from rpod_schemas.registry import resolve
from rpod_schemas.sensors import sensor_kind
from rpod_schemas.topics import TF_STATIC, Topic

_MODULES = ("content", "stamps", "delivery", "setup")


@dataclass(frozen=True)
class Outgoing:
    """One message of a sensor on its way to the bus."""

    topic: Topic
    part: str
    """Name of the part in the sensor kind; ``info`` or ``tf_static`` for the latched messages."""
    message: Any
    """ROS message; an injection never changes it in place."""
    publisher: str = ""
    """Publisher: the sensor's own, or another one."""
    delay_s: float = 0.0
    """Time for which the message waits on the bus, s."""
    lost: bool = False
    """Whether the bus loses it: it takes a sequence number and never arrives."""

    @property
    def stamp_ns(self) -> int:
        """Stamp of the message, ns."""
        header = self.message.transforms[0].header if self.part == TF_STATIC.name else self.message.header
        return read_stamp(header)

    @property
    def latched(self) -> bool:
        """Whether the message describes the sensor and is no part of a frame."""
        return self.part in (TF_STATIC.name, "info")


class Injection:
    """One fault of one sensor; an instance sees all its messages, in order, while the fault lasts.

    Args:
        kind: kind of the sensor.
        seed: seed of all that is random.
    """

    fault: ClassVar[str]
    """Name in the catalogue."""

    def __init__(self, kind: str, seed: int) -> None:
        self.kind, self.seed = kind, seed
        self.leading = sensor_kind(kind).leading_part
        self.first_ns: int | None = None
        self.size: float | None = None
        """Size in the catalogue's unit; None if the fault has none, or if it is drawn."""

    def apply(self, outgoing: Outgoing) -> list[Outgoing]:
        """Return what is published in place of a message."""
        if outgoing.latched:
            return self.announcement(outgoing)
        if self.first_ns is None:
            self.first_ns = outgoing.stamp_ns
        return self.part(outgoing, (outgoing.stamp_ns - self.first_ns) * 1e-9)

    def part(self, outgoing: Outgoing, elapsed_s: float) -> list[Outgoing]:  # noqa: ARG002 - for subclasses
        """Return what is published in place of a part of a frame, ``elapsed_s`` after the fault began."""
        return [outgoing]

    def announcement(self, outgoing: Outgoing) -> list[Outgoing]:
        """Return what is published in place of a latched message."""
        return [outgoing]

    def random(self, outgoing: Outgoing) -> np.random.Generator:
        """Return a generator that is the same for all parts of a frame."""
        return np.random.default_rng([self.seed, outgoing.stamp_ns % 2**62, 0xFA17])


def injection(name: str, kind: str, seed: int, *, sensor: str = "", size: float | None = None) -> Injection:
    """Return the injection of a fault into a sensor, with its own random stream.

    Args:
        name: name of the fault.
        kind: kind of the sensor.
        seed: seed of all faults of all sensors.
        sensor: name of the sensor.
        size: size of the fault, in the catalogue's unit; the catalogue's own if None.

    Raises:
        SchemaError: there is no fault of this name, or the kind cannot have it.
    """
    fault = known_fault(name)
    if not fault.can_be_in(kind):
        raise SchemaError(f"a sensor of kind {kind!r} cannot have the fault {name!r}")
    for module in _MODULES:
        found: dict[str, type[Injection]] = resolve(f"rpod_sim_sensor.faults.{module}:INJECTIONS")
        if name in found:
            made = found[name](kind, zlib.crc32(f"{seed}/{sensor}/{name}".encode()))
            made.size = fault.amount(size)
            return made
    raise SchemaError(f"the fault {name!r} cannot be injected")


def parts_of(kind: str, sensor: str) -> dict[str, str]:
    """Return the part of each topic of a sensor, by the topic's name."""
    found = sensor_kind(kind)
    parts = {part.topic.of(sensor).name: name for name, part in found.parts.items()}
    if found.info is not None:
        parts[found.info.of(sensor).name] = "info"
    return {
        **parts,
        **{topic.of(sensor).name: "extra" for topic in found.extras},
        TF_STATIC.name: "tf_static",
    }


def stamped(outgoing: Outgoing, stamp_ns: int) -> Outgoing:
    """Return a part of a frame under another stamp."""
    message = copy.copy(outgoing.message)
    message.header = copy.copy(message.header)
    message.header.stamp = write_stamp(max(stamp_ns, 0))
    return replace(outgoing, message=message)
