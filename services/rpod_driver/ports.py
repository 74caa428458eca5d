"""The ports: what a driver must offer. Emulator, recording and real device are equal behind them."""

from collections.abc import Iterator
from typing import Any, Protocol

from rpod_schemas.types import LidarInfo, LidarScan, PmdFrame, PmdInfo, SensorFrame


class Driver(Protocol):
    """A sensor of any kind; what it returns is of the kind's types."""

    def connect(self) -> Any:
        """Open the device; return what it says of itself, None where that is not known.

        Either succeeds or leaves nothing open. Whatever it raises is told, and it is called again later.
        """
        ...

    def frames(self) -> Iterator[SensorFrame | None]:
        """Yield frames as they come, and None at least once a second while there is none.

        Each carries the middle of its exposure, ns of UTC (a PTP clock's TAI is 37 s ahead). Ends where
        the source ends; whatever it raises leads to ``close`` and a new ``connect``.
        """
        ...

    def close(self) -> None:
        """Release the device. Called once after each ``connect`` that succeeded."""
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
    """A LIDAR; like a camera, with scans stamped with their middle."""

    def connect(self) -> LidarInfo | None:
        """See ``Driver.connect``."""
        ...

    def frames(self) -> Iterator[LidarScan | None]:
        """See ``Driver.frames``."""
        ...
