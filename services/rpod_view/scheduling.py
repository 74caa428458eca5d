"""Lowers the view's scheduling priority: the facility's own processes run first."""

import os
from contextlib import suppress
from pathlib import Path

_NICENESS = 10
_AUTOGROUP = Path("/proc/self/autogroup")


def lower_priority() -> None:
    """Lower this process's priority for good, and on Linux its session's if it is alone in it.

    Where sessions are scheduled as groups (sched(7), autogroup) niceness counts within a session only.
    """
    os.nice(_NICENESS)
    if os.getsid(0) == os.getpid():
        with suppress(OSError):
            _AUTOGROUP.write_text(str(_NICENESS), "ascii")
