"""Drivers of sensors: a driver connects, yields frames and closes; the host does everything else."""

from rpod_driver.errors import DriverError, StoppedError
from rpod_driver.host import main, run
from rpod_driver.ports import (
    Adjustable,
    CameraDriver,
    Counted,
    Driver,
    Drops,
    LidarDriver,
    Paced,
    Stoppable,
    Synchronised,
    Triggered,
)

__all__ = [
    "Adjustable",
    "CameraDriver",
    "Counted",
    "Driver",
    "DriverError",
    "Drops",
    "LidarDriver",
    "Paced",
    "Stoppable",
    "StoppedError",
    "Synchronised",
    "Triggered",
    "main",
    "run",
]
