"""Cancellation of a search whose result nobody waits for any more.

A search may take many seconds, in steps of some milliseconds. Methods call ``stop_if_cancelled`` between the
steps, so that the process that searches is soon free. Outside ``cancelled_if`` this call does nothing.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from rpod_pose.errors import PoseError

_is_cancelled: ContextVar[Callable[[], bool] | None] = ContextVar("is_cancelled", default=None)


class CancelledError(PoseError):
    """The search was cancelled, because nobody waits for its result any more."""


@contextmanager
def cancelled_if(is_cancelled: Callable[[], bool]) -> Iterator[None]:
    """Make searches in this context end at their next step once a function returns true.

    Args:
        is_cancelled: returns whether the search is cancelled; it is called at each step.

    Raises:
        CancelledError: a search in the context was cancelled.
    """
    token = _is_cancelled.set(is_cancelled)
    try:
        yield
    finally:
        _is_cancelled.reset(token)


def stop_if_cancelled() -> None:
    """End the search here if it was cancelled.

    Raises:
        CancelledError: the search was cancelled.
    """
    is_cancelled = _is_cancelled.get()
    if is_cancelled is not None and is_cancelled():
        raise CancelledError("the search was cancelled")
