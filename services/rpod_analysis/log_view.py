"""A log through the live view: the same drawing, as fast as it goes."""

from collections import Counter
from collections.abc import Callable
from contextlib import suppress

from rpod_analysis.log import Log
from rpod_analysis.replay.frames import as_received
from rpod_schemas.cdr import NANOSECONDS
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.topics import TF, TRUTH, Topic
from rpod_view.scene import SENSOR_TOPICS, pose_topics
from rpod_view.view import View


def show_log(
    log: Log,
    view: View,
    *,
    prefix: str,
    rate_hz: float,
    start_ns: int | None = None,
    end_ns: int | None = None,
    drawn: Callable[[], bool] = lambda: True,
) -> Counter[str]:
    """Draw a log, in the order of arrival, at so many moments in each second of it.

    Args:
        log: an open log.
        view: where it is drawn.
        prefix: first part of the topics of the estimates.
        rate_hz: moments at which the newest is drawn, in the time of the log.
        start_ns: arrival of the first message.
        end_ns: all messages arrived before this.
        drawn: called after each moment, waits until the viewer has it; false ends the drawing.

    Returns:
        Messages that could not be used, by topic.

    Raises:
        AnalysisError: the log cannot be read there.
    """
    refused: Counter[str] = Counter()
    period_ns = round(NANOSECONDS / rate_hz)
    next_ns: int | None = None

    def draw() -> bool:
        with suppress(MessageRejectedError):
            view.draw()
        return drawn()

    for logged in log.messages(*_topics(log, prefix), start_ns=start_ns, end_ns=end_ns):
        next_ns = logged.log_ns + period_ns if next_ns is None else next_ns
        if logged.log_ns >= next_ns:
            next_ns += period_ns * (1 + (logged.log_ns - next_ns) // period_ns)
            if not draw():
                return refused
        try:
            view.take(as_received(logged))
        except MessageRejectedError:
            refused[logged.topic] += 1
    draw()
    return refused


def _topics(log: Log, prefix: str) -> list[str]:
    """Return the topics of a log that are drawn; the truth's own where it is there, else its transforms."""
    truth = TRUTH if TRUTH.name in log.topics else TF
    wanted = (truth, *pose_topics(prefix), *SENSOR_TOPICS)
    return [
        name
        for name, info in log.topics.items()
        if any(topic.covers(Topic(name, info.type)) for topic in wanted)
    ]
