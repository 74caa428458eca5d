"""Ends a search at its next step when nobody waits for its result any more.

A search may take many seconds, in steps of some milliseconds. Methods call ``step`` between them, so that the
process that searches is free soon. If a search cannot be cancelled, ``step`` does nothing.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from rpod_pose.errors import PoseError

_unwanted: ContextVar[Callable[[], bool] | None] = ContextVar("unwanted", default=None)


class UnwantedError(PoseError):
    """Nobody waits for the search any more."""


@contextmanager
def unless(unwanted: Callable[[], bool]) -> Iterator[None]:
    """Let searches in this context end at the first step at which they are unwanted.

    Raises:
        UnwantedError: a search has ended so.
    """
    token = _unwanted.set(unwanted)
    try:
        yield
    finally:
        _unwanted.reset(token)


def step() -> None:
    """Begin the next step of a search.

    Raises:
        UnwantedError: nobody waits for the search any more.
    """
    unwanted = _unwanted.get()
    if unwanted is not None and unwanted():
        raise UnwantedError("the search was cancelled")
