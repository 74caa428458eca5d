"""Patience is counted in the time in which a process runs."""

import subprocess
import sys

from rpod_runtime.process.awake import AwakeClock
from rpod_runtime.process.processes import await_end, end_process


def test_time_in_which_the_process_stood_still_counts_as_one_turn():
    times_s = iter([10.0, 10.5, 11.0, 500.0, 500.5, 499.0])
    clock = AwakeClock(1.0, now_s=lambda: next(times_s))
    assert [clock.now_s() for _ in range(5)] == [0.5, 1.0, 2.0, 2.5, 2.5]


def test_a_process_that_ends_is_waited_for_and_one_that_does_not_is_told():
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        assert await_end(process, 0.01) is None
        process.kill()
        assert await_end(process, 60.0) == -9


def test_a_process_that_does_not_end_when_asked_is_killed():
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        assert end_process(process, 0.01, ask=lambda: None) == (-9, True)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        assert end_process(process, 60.0) == (-15, False)
