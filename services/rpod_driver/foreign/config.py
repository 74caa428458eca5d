"""Configuration of a driver that runs in an environment of its own."""

from pathlib import Path

from rpod_driver.stamps import StampConfig
from rpod_schemas.config.base import Config, Positive


class ForeignEnvironment(Config):
    """The environment and the time-outs of a driver process."""

    python: Path
    """Interpreter of the environment in which the device's library is installed, as
    ``/opt/ouster/bin/python``. It needs NumPy, and nothing of the project."""
    start_s: Positive = 30.0
    """Longest time from the start of the process until its device is open, s."""
    stamps: StampConfig = StampConfig()
    """Conversion of the device's stamps to UTC."""


class ProcessDevice(ForeignEnvironment):
    """A driver process of one's own."""

    script: Path
    """Python file that sends frames by ``frame_pipe``."""
    arguments: tuple[str, ...] = ()
    """Arguments of the script."""
