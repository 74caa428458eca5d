"""The ports of drivers. Emulator, recording and real device are equal behind them."""

from collections.abc import Iterator, Mapping
from threading import Event
from typing import Any, NamedTuple, Protocol, runtime_checkable

from rpod_schemas.config.driver import Setting
from rpod_schemas.types import SensorFrame, SensorSync


class Driver(Protocol):
    """A sensor of any kind; it returns values of the kind's types."""

    def connect(self) -> Any:
        """Open the device; return its info, such as ``PmdInfo`` or ``LidarInfo``, or None if that is unknown.

        It either succeeds or leaves nothing open. The host reports an error and repeats the call later.
        """
        ...

    def frames(self) -> Iterator[SensorFrame | None]:
        """Yield frames as they come, and None at least once a second while no frame comes.

        The stamp of a frame is the middle of its exposure, ns of UTC (a PTP clock's TAI is 37 s ahead). The
        iterator ends with the source; an error leads to ``close`` and a new ``connect``.
        """
        ...

    def close(self) -> None:
        """Release the device; it is called once after each ``connect`` that succeeded."""
        ...


@runtime_checkable
class Synchronised(Protocol):
    """A driver that knows how its sensor keeps time; a driver need not be one."""

    def sync(self) -> SensorSync:
        """Return how the sensor keeps time now; called each second, it must return at once."""
        ...


@runtime_checkable
class Adjustable(Protocol):
    """A driver with settings; a driver need not be one.

    The host applies the configured settings after each ``connect``, before the first frame, and then those
    that an operator changed since, in the order of their last changes. So a device that forgets them with its
    power gets them back.
    """

    def settings(self) -> Mapping[str, Setting]:
        """Return all settings with their values in the device now."""
        ...

    def apply(self, settings: Mapping[str, Setting]) -> None:
        """Write settings to the device.

        The host calls it in the thread that iterates over ``frames``, between two items. Raise an error that
        names setting, value and limit if the device cannot take one; then none of them may have changed.
        """
        ...


@runtime_checkable
class Triggered(Protocol):
    """A driver whose sensor takes a frame on request; a driver need not be one."""

    def trigger(self) -> None:
        """Ask for one frame, which ``frames`` yields; called like ``Adjustable.apply``."""
        ...


class Drops(NamedTuple):
    """Number of frames that were lost before the host got them, since the start of the driver."""

    device: int = 0
    """Lost in the device or on its link: gaps of its frame counter."""
    queue: int = 0
    """Lost in the queue of the device's library, or of the driver, because the host was too slow."""


@runtime_checkable
class Counted(Protocol):
    """A driver that knows where frames were lost; a driver need not be one.

    What the bus loses after the host is counted by each receiver, as ``missed/<topic>``.
    """

    def drops(self) -> Drops:
        """Return the counts now; called each second, it must return at once."""
        ...


@runtime_checkable
class Stoppable(Protocol):
    """A driver that waits for long in ``connect``; a driver need not be one."""

    def take_stop(self, stop: Event) -> None:
        """Take the event that is set when the driver has to end; called once, before the first ``connect``.

        ``connect`` looks at it at least once a second while it waits, calls ``manager.alive()`` of
        ``rpod_runtime.process.notify`` as often, and raises ``StoppedError`` when the event is set.
        """
        ...


@runtime_checkable
class Paced(Protocol):
    """A driver that knows when its next frame is due, as a player or one that triggers; a driver need not be.

    A pause that it announces is no silence: the host counts from the time at which the frame was due.
    """

    def due_s(self) -> float:
        """Return when the next frame is due, s of the monotonic clock; called often, it must return at once.

        Return only what is certain, and a time that has passed if the next frame is not known to be later: a
        frame that does not come after this time is a fault.
        """
        ...
