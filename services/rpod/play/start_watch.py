"""Whether services that start still work, since a first start takes minutes and one that hangs never ends."""

from rpod_runtime.process.processes import processor_s

WORK_S = 1.0
"""Processor time that counts as work, s."""


class StartWatch:
    """Measures for how long services that start have used less than ``WORK_S`` of the processor."""

    def __init__(self) -> None:
        self._worked: dict[int, tuple[float, float]] = {}

    def idle_s(self, pid: int, now_s: float) -> float:
        """Return for how long a process has not worked, s; 0 at the first call.

        Args:
            pid: number of the process.
            now_s: the present reading of a clock, s.
        """
        used_s = processor_s(pid)
        before_s, at_s = self._worked.setdefault(pid, (used_s, now_s))
        if used_s - before_s < WORK_S:
            return now_s - at_s
        self._worked[pid] = (used_s, now_s)
        return 0.0
