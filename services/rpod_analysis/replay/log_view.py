"""Draws a log with the live view's code, as fast as possible."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, islice

from rpod_analysis.log import Log, Logged
from rpod_analysis.log.sensors import as_received
from rpod_analysis.log.stamp_check import StampCheck
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.rmw.cdr import NANOSECONDS, peek_stamp
from rpod_schemas.topics import TF, TF_STATIC, TRUTH, Topic
from rpod_view.scene import pose_topics, sensor_topics
from rpod_view.view import View

_MOST_MOMENTS = 1200
"""Largest number of drawings of a log, so that a long log does not fill the viewer's memory."""
_AGAIN_NS = NANOSECONDS
"""Time by which a stamp must be before the last one to show that the clock started again."""


@dataclass(frozen=True)
class Part:
    """Part of a log to show, by time of arrival, ns; the end is excluded."""

    start_ns: int | None = None
    end_ns: int | None = None


class _Pace:
    """Times of drawing, evenly spaced in the time of the stamps, which may differ from the arrivals'."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._next_ns: int | None = None

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether a time of drawing is before this stamp."""
        if self._next_ns is None or self._next_ns - stamp_ns > self._period_ns + _AGAIN_NS:
            self._next_ns = stamp_ns + self._period_ns
        if stamp_ns < self._next_ns:
            return False
        self._next_ns += self._period_ns * (1 + (stamp_ns - self._next_ns) // self._period_ns)
        return True


def show_log(
    log: Log,
    view: View,
    *,
    prefix: str,
    rate_hz: float,
    part: Part = Part(),
    drawn: Callable[[], bool] = lambda: True,
) -> None:
    """Draw a log in the order of arrival.

    Args:
        log: an open log.
        view: the view that draws it.
        prefix: first part of the topics of the estimates.
        rate_hz: number of drawings per second of the stamps, fewer for a long log.
        part: part of the log to draw.
        drawn: function that is called after each drawing and waits until the viewer has received it; False
            ends the drawing.

    Raises:
        AnalysisError: this part of the log cannot be read.
    """
    topics = _topics(log, prefix)
    pace = _Pace(round(max(NANOSECONDS / rate_hz, _span_ns(log, topics, part) / _MOST_MOMENTS)))

    mounts = log.messages(TF_STATIC, end_ns=part.start_ns) if part.start_ns else ()
    stamps = StampCheck(log)
    for logged in chain(mounts, log.messages(*topics, start_ns=part.start_ns, end_ns=part.end_ns)):
        if not _of_this_log(log, stamps, logged):
            continue
        if _is_due(pace, logged):
            view.draw()
            if not drawn():
                return
        view.take(as_received(logged))
    view.draw()
    drawn()


def _of_this_log(log: Log, stamps: StampCheck, logged: Logged) -> bool:
    """Return whether a message's stamp can belong to the log; if not, count it as unreadable."""
    with log.unreadable.left_out(logged):
        stamps.peek(logged)
        return True
    return False


def _is_due(pace: _Pace, logged: Logged) -> bool:
    """Return whether a time of drawing is before a message; transforms have their stamps inside."""
    if logged.type == TF.type:
        return False
    with suppress(MessageRejectedError):
        return pace.is_due(peek_stamp(logged.payload))
    return False


def _span_ns(log: Log, topics: list[str], part: Part) -> int:
    """Return the time span of the stamps in a part, to a second of its arrivals."""
    stamped = [name for name in topics if log.topics[name].type != TF.type]
    end_ns = log.end_ns + 1 if part.end_ns is None else part.end_ns
    stamps_ns: list[int] = []
    for start_ns, most in ((part.start_ns, 1), (end_ns - NANOSECONDS, None)):
        for logged in islice(log.messages(*stamped, start_ns=start_ns, end_ns=part.end_ns), most):
            with suppress(MessageRejectedError):
                stamps_ns.append(peek_stamp(logged.payload))
    return max(stamps_ns, default=0) - min(stamps_ns, default=0)


def _topics(log: Log, prefix: str) -> list[str]:
    """Return the topics of a log that are drawn; the truth comes from its own topic, else from transforms."""
    truth = TRUTH if TRUTH.name in log.topics else TF
    wanted = (truth, *pose_topics(prefix), *sensor_topics())
    return [
        name
        for name, info in log.topics.items()
        if any(topic.covers(Topic(name, info.type)) for topic in wanted)
    ]
