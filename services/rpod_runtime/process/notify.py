"""Tells a service manager (systemd with ``Type=notify``, or ``rpod up``) how the process does.

The protocol is sd_notify(3): datagrams of ``NAME=value`` lines to the socket that ``$NOTIFY_SOCKET`` names.
``READY=1`` is sent once the service is warm and at work. ``WATCHDOG=1`` is sent by the main loop itself,
never by another thread, so that it stops when the main loop hangs. Without a manager nothing is sent.
"""

import os
import socket
import time
from contextlib import suppress
from math import inf
from threading import Event

from rpod_runtime.process.collector import process_has_started

_BEATS = 4
"""Number of watchdog messages in the manager's time limit; sd_watchdog_enabled(3) recommends at least two."""

_TURN_S = 0.25

IN_RESERVE = "X_RPOD_RESERVE"
"""Name of the line by which a process in reserve says that it is warm."""
AT_WORK = "X_RPOD_AT_WORK"
"""Name of the line by which a service that was ready says whether it can do its work: 0 or 1."""


class ServiceManager:
    """The process that started this one, if it asked for notifications. Safe to use from several threads."""

    def __init__(self) -> None:
        self._address = ""
        self._period_s = 0.0
        self._next_s = 0.0
        self.read_environment()

    def read_environment(self) -> None:
        """Take socket and time limit from the environment, as they are now."""
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        limit_us, process = os.environ.get("WATCHDOG_USEC", ""), os.environ.get("WATCHDOG_PID", "")
        ours = not process or process == str(os.getpid())
        self._period_s = int(limit_us) / 1e6 / _BEATS if ours and limit_us.isdecimal() else 0.0
        self._next_s = 0.0

    def ready(self, message: str) -> None:
        """Tell that the service is at work, and at what; its start is over."""
        process_has_started()
        self._send(f"READY=1\nSTATUS={_line(message)}")

    def works(self, message: str, *, at_work: bool) -> None:
        """Tell what a service does, and whether it can do its work; systemd shows the message."""
        self._send(f"STATUS={_line(message)}\n{AT_WORK}={int(at_work)}")

    def in_reserve(self) -> None:
        """Tell that the process is warm and waits for its turn; systemd ignores such names (sd_notify(3))."""
        self._send(f"{IN_RESERVE}=1")

    def stopping(self) -> None:
        """Tell that the service has been asked to stop."""
        self._send("STOPPING=1")

    def alive(self) -> None:
        """Tell that the main loop runs; to be called in each of its turns, and only by it."""
        now_s = time.monotonic()
        if self._period_s and now_s >= self._next_s:
            self._next_s = now_s + self._period_s
            self._send("WATCHDOG=1")

    def attend(self, stop: Event, most_s: float = inf) -> None:
        """Wait, in place of a main loop, until a service is stopped or a time is over; report as alive."""
        end_s = time.monotonic() + most_s
        while (left_s := end_s - time.monotonic()) > 0.0 and not stop.wait(min(left_s, _TURN_S)):
            self.alive()

    def _send(self, text: str) -> None:
        if not self._address:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            link.setblocking(False)  # a manager that does not read must not stop the service
            link.sendto(text.encode(), address)


def _line(text: str) -> str:
    return " ".join(text.split())


manager = ServiceManager()
"""The manager of this process."""
