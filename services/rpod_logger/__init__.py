"""The logger: writes all messages of the bus to MCAP files, with unchanged bytes."""

from rpod_logger.errors import LoggerError
from rpod_logger.recorder import Recorder
from rpod_logger.writer import LogFile, create_log

__all__ = ["LogFile", "LoggerError", "Recorder", "create_log"]
