"""Drivers of sensors: a driver connects, yields frames and closes; the host does everything else."""

from rpod_driver.errors import DriverError, StoppedError
from rpod_driver.host import main, run
from rpod_driver.ports import (
    Adjustable,
    Counted,
    Driver,
    Drops,
    Paced,
    Stoppable,
    Synchronised,
    Triggered,
)

__all__ = [
    "Adjustable",
    "Counted",
    "Driver",
    "DriverError",
    "Drops",
    "Paced",
    "Stoppable",
    "StoppedError",
    "Synchronised",
    "Triggered",
    "main",
    "run",
]
