"""Waits for the end of processes, and ends those that do not end by themselves."""

import subprocess
from collections.abc import Callable
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
