"""Lowers the view's scheduling priority: the facility's own processes run first."""

import os
from contextlib import suppress
from pathlib import Path

_NICENESS = 10
_AUTOGROUP = Path("/proc/self/autogroup")


def lower_priority() -> None:
    """Lower this process's priority; on Linux also that of its session if no other process is in it.

    If sessions are scheduled as groups (sched(7), autogroup), niceness has an effect within a session only.
    """
    os.nice(_NICENESS)
    if os.getsid(0) == os.getpid():
        with suppress(OSError):
            _AUTOGROUP.write_text(str(_NICENESS), "ascii")
