"""Drivers of sensors: a driver connects, yields frames and closes; the host does everything else."""

from rpod_driver.errors import DriverError
from rpod_driver.host import main, run
from rpod_driver.ports import CameraDriver, Driver, LidarDriver, Synchronised

__all__ = ["CameraDriver", "Driver", "DriverError", "LidarDriver", "Synchronised", "main", "run"]
