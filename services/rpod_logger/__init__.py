"""The logger: everything on the bus into MCAP files, as it came."""

from rpod_logger.errors import LoggerError
from rpod_logger.recorder import Recorder
from rpod_logger.writer import LogFile, create_log

__all__ = ["LogFile", "LoggerError", "Recorder", "create_log"]
