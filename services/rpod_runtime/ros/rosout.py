"""The log lines of a process as messages of ``/rosout``."""

import logging
import os
from collections.abc import Callable
from typing import Any

from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.messages.ros import write_log

_FATAL, _DEBUG = logging.CRITICAL, logging.DEBUG
_ROOM = 10
"""Distance of two levels, in Python as in ROS 2."""


class RosoutHandler(logging.Handler):
    """Publishes each log line of the process under a node's name, until it is closed."""

    def __init__(self, name: str, publish: Callable[[Any], None]) -> None:
        super().__init__()
        self._name, self._publish = name, publish
        self._publishing = False  # under the handler's lock, so that it is this thread's own
        logging.getLogger().addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a record, with the text of its exception.

        A line that is logged while a line is published would wait for its own publisher, so it is left out.
        """
        if self._publishing:
            return
        self._publishing = True
        try:
            self._publish(
                write_log(
                    int(record.created * NANOSECONDS),
                    level=min(max(record.levelno // _ROOM * _ROOM, _DEBUG), _FATAL),
                    name=self._name,
                    text=self.format(record).encode(errors="replace").decode(),
                    file=os.fsencode(record.pathname).decode(errors="replace"),
                    function=record.funcName or "",
                    line=record.lineno,
                )
            )
        except Exception:  # noqa: BLE001 - a log line must not end the service
            self.handleError(record)
        finally:
            self._publishing = False

    def close(self) -> None:
        """End the publication."""
        logging.getLogger().removeHandler(self)
        super().close()
