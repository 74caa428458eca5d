"""Waits for the end of processes, ends those that do not end by themselves, and reads what they have used."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from rpod_runtime.process.awake import AwakeClock

_TURN_S = 0.25


class Ending(NamedTuple):
    """How a process has ended."""

    code: int
    """Its exit code; the negative number of a signal that has ended it."""
    forced: bool
    """Whether it had to be killed, because it did not end in time."""


def await_end(process: subprocess.Popen[bytes], limit_s: float) -> int | None:
    """Wait for the end of a process; return its exit code.

    None is returned after ``limit_s``, s, in which this process was awake.
    """
    clock = AwakeClock(2.0 * _TURN_S)
    while (left_s := limit_s - clock.now_s()) > 0.0:
        try:
            return process.wait(min(left_s, _TURN_S))
        except subprocess.TimeoutExpired:
            continue  # the loop checks whether there is time left
    return None


def end_process(
    process: subprocess.Popen[bytes], limit_s: float, *, ask: Callable[[], object] | None = None
) -> Ending:
    """Ask a process to end, wait, and kill it if it does not; return how it has ended.

    Args:
        process: the process.
        limit_s: longest time until it ends by itself, in which this process was awake, s.
        ask: asks it to end; by default SIGTERM.
    """
    (ask or process.terminate)()
    code = await_end(process, limit_s)
    if code is not None:
        return Ending(code, forced=False)
    process.kill()
    return Ending(process.wait(), forced=True)


def processor_s(pid: int) -> float:
    """Return the processor time of a process so far, s, from proc(5); 0 where that cannot be read."""
    try:
        user, system = (
            Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[11:13]
        )
    except (OSError, ValueError):
        return 0.0
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
