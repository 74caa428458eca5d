"""The cores of this machine, and whether it has more work than them."""

import os


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def busy_machine() -> str:
    """Return how busy this machine is, if more processes want to run than it has cores; else an empty string.

    The load is the mean of the last minute, of all processes.
    """
    load = os.getloadavg()[0]
    return f"this machine is busy: load {load:.1f} on {cores()} cores" if load > cores() else ""
