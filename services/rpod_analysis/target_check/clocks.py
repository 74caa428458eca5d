"""Clocks that stop while kernels are compiled, so that a method's time does not contain the compilation."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from numba.core import event


class Moment(NamedTuple):
    """Readings of the clocks."""

    processor_s: float
    """Processor time of this process without compilation, s."""
    wall_s: float
    """Time since some moment, without compilation, s."""


class Clocks(event.Listener):
    """Clocks that stop from the start to the end of each compilation."""

    def __init__(self) -> None:
        self._depth = 0
        self._begun = self._stood = Moment(0.0, 0.0)

    def now(self) -> Moment:
        """Return the present readings; not to be asked while something is compiled."""
        return Moment(time.process_time() - self._stood.processor_s, time.perf_counter() - self._stood.wall_s)

    def on_start(self, event: object) -> None:  # noqa: ARG002 - the name is numba's
        """Stop the clocks; a compilation within another one changes nothing."""
        if not self._depth:
            self._begun = self.now()
        self._depth += 1

    def on_end(self, event: object) -> None:  # noqa: ARG002 - the name is numba's
        """Let the clocks go on."""
        self._depth -= 1
        if not self._depth:
            ended = self.now()
            self._stood = Moment(
                *(
                    stood + end - begin
                    for stood, end, begin in zip(self._stood, ended, self._begun, strict=True)
                )
            )


@contextmanager
def clocks() -> Iterator[Clocks]:
    """Give clocks, which notice compilations until the context ends."""
    made = Clocks()
    with event.install_listener("numba:compile", made):
        yield made
