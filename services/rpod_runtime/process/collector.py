"""The garbage collector of a process that starts: it does not examine what is imported again and again.

Imports and warm-up make hundreds of thousands of objects that live as long as the process. By default the
collector examines them several times while they are made, and all of them again at each full collection
later, in the middle of the work of a service.
"""

import gc

_AT_START = (20_000, 20, 100)
"""Thresholds of the three generations while a process starts."""
_usual: list[tuple[int, int, int]] = []
"""Thresholds that the process had before its start; empty while no process starts."""


def process_starts() -> None:
    """Collect seldom from now on."""
    if not _usual:
        _usual.append(gc.get_threshold())
        gc.set_threshold(*_AT_START)


def process_has_started() -> None:
    """Collect as before, without what has been made until now; do nothing if no process starts."""
    if _usual:
        gc.freeze()
        gc.set_threshold(*_usual.pop())
