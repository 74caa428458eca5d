"""Refused messages that are no frames: infos, mounts, parts of frames, diagnostics of drivers.

A refused frame is counted in the book of its sensor. Without this module only the log would report the other
refused messages, while the sensor's frames are used with the earlier data.
"""

from typing import NamedTuple

from rpod_estimator.inputs.book import InputState
from rpod_runtime import Received
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.types import Health

STREAM_S = 5.0
"""Time for which a refused message of a stream is reported: a driver's diagnostics come once a second."""
_MOST = 100
"""Largest number of publishers whose refused messages are reported."""
_REPORTED_ELSEWHERE = frozenset({Reason.SECOND_PUBLISHER, Reason.DUPLICATE})
"""Reasons to refuse a message that do not show an error of it; a second publisher is reported elsewhere."""
_REMEDY = {
    True: "it is not used, the one before it still counts; correct its publisher",
    False: "it is not used; correct its publisher",
}
"""Consequence and remedy, for latched messages (True) and for those of a stream (False)."""


class _Refusal(NamedTuple):
    text: str
    until_s: float
    """End of the time for which it is reported, monotonic clock, s; infinite for a latched topic."""


class Refusals:
    """The last refusal of each publisher of a topic, until it sends a message that is accepted, or leaves."""

    def __init__(self) -> None:
        self._refusals: dict[tuple[str, str], _Refusal] = {}

    def refuse(self, received: Received, error: MessageRejectedError) -> None:
        """Note that a message was refused."""
        topic, place = received.topic, (received.topic.name, received.session)
        if error.reason in _REPORTED_ELSEWHERE or (
            place not in self._refusals and len(self._refusals) >= _MOST
        ):
            return
        until_s = float("inf") if topic.latched else received.arrival_s + STREAM_S
        text = f"{topic.name} is refused, {error}; {_REMEDY[topic.latched]}"
        self._refusals[place] = _Refusal(text, until_s)

    def accept(self, received: Received) -> None:
        """Note that a message was accepted."""
        self._refusals.pop((received.topic.name, received.session), None)

    def leave(self, topic: str, session: str) -> None:
        """Note that the publisher of a session is gone."""
        self._refusals.pop((topic, session), None)

    def forget(self) -> None:
        """Forget all. A publisher whose messages are still refused will be reported again."""
        self._refusals.clear()

    def states(self, now_s: float) -> list[InputState]:
        """Return the refusals to report, each as a warning."""
        self._refusals = {place: each for place, each in self._refusals.items() if now_s <= each.until_s}
        texts = dict.fromkeys(each.text for each in self._refusals.values())
        return [InputState(Health.WARN, text) for text in texts]
