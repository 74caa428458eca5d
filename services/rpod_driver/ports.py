"""The ports of drivers. Emulator, recording and real device are equal behind them."""

from collections.abc import Iterator
from typing import Any, Protocol, runtime_checkable

from rpod_schemas.types import LidarInfo, LidarScan, PmdFrame, PmdInfo, SensorFrame, SensorSync


class Driver(Protocol):
    """A sensor of any kind; it returns values of the kind's types."""

    def connect(self) -> Any:
        """Open the device; return its info, or None if that is unknown.

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


class CameraDriver(Driver, Protocol):
    """A PMD camera."""

    def connect(self) -> PmdInfo | None:
        """See ``Driver.connect``."""
        ...

    def frames(self) -> Iterator[PmdFrame | None]:
        """See ``Driver.frames``."""
        ...


class LidarDriver(Driver, Protocol):
    """A LIDAR, whose scans are stamped with their middle."""

    def connect(self) -> LidarInfo | None:
        """See ``Driver.connect``."""
        ...

    def frames(self) -> Iterator[LidarScan | None]:
        """See ``Driver.frames``."""
        ...
