"""Poses of known bodies in a log, passed on up to the time that an estimator has reached."""

from collections import Counter
from collections.abc import Iterator

from rpod_analysis.log import Log
from rpod_analysis.replay.holders import of_holders
from rpod_estimator.inputs.bodies import checked
from rpod_pose.surroundings.bodies import KnownBodies
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_odometry
from rpod_schemas.topics import BODY
from rpod_schemas.types import Odometry


class LoggedBodies:
    """Passes the poses of a log to the known bodies, in the order of arrival.

    Args:
        log: the log.
        bodies: where readings go; None if no body is known.
    """

    def __init__(self, log: Log, bodies: KnownBodies | None) -> None:
        self._bodies = bodies
        self.unused: Counter[str] = Counter()
        """Number of messages of publishers that did not hold their topic, by topic."""
        known = bodies is not None and bodies.tracks
        self._readings = _readings(log, bodies, self.unused) if bodies is not None and known else iter(())
        self._next = next(self._readings, None)

    def take_until(self, stamp_ns: int) -> None:
        """Pass on the readings up to a stamp."""
        while self._bodies is not None and self._next is not None and self._next[1].stamp_ns <= stamp_ns:
            frame, reading = self._next
            self._bodies.tracks[frame].take(reading.stamp_ns, reading.pose)
            self._next = next(self._readings, None)


def _readings(log: Log, bodies: KnownBodies, unused: Counter[str]) -> Iterator[tuple[str, Odometry]]:
    frames = {BODY.at(frame).name: frame for frame in bodies.tracks}
    for logged, hold in of_holders(log, *frames, unused=unused):
        try:
            reading = checked(read_odometry(logged.decode()))
        except MessageRejectedError:  # the live estimator did not use it either
            continue
        hold()
        yield frames[logged.topic], reading
