"""Readings and commands of the chaser in a log, passed on up to the time that an estimator has reached."""

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, Generic, Protocol, TypeVar

from rpod_analysis.log import Log
from rpod_analysis.replay.holders import of_holders
from rpod_estimator.inputs.imu import checked
from rpod_pose.navigation.dynamics.command_track import CommandTrack
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_schemas.config.estimator.dynamics import DynamicsConfig
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_command, read_imu
from rpod_schemas.topics import COMMAND, IMU, Topic
from rpod_schemas.types import Command, ImuReading, Stamped

ReadingT = TypeVar("ReadingT", bound=Stamped)
TakenT_contra = TypeVar("TakenT_contra", bound=Stamped, contravariant=True)


class Track(Protocol[TakenT_contra]):
    """Readings over time."""

    def take(self, reading: TakenT_contra, /) -> bool:
        """Add a reading and return whether it is used."""
        ...


class LoggedReadings(Generic[ReadingT]):
    """Passes the readings of a topic to a track, in the order of arrival.

    Args:
        log: the log.
        topic: the topic.
        track: where readings go; None if they are not used.
        read: reads a message, or raises ``MessageRejectedError``.
    """

    def __init__(
        self, log: Log, topic: Topic, track: Track[ReadingT] | None, read: Callable[[Any], ReadingT]
    ) -> None:
        self._track = track
        self.unused: Counter[str] = Counter()
        """Number of messages of publishers that did not hold the topic, by topic."""
        self._readings = iter(()) if track is None else _readings(log, topic, read, self.unused)
        self._next = next(self._readings, None)

    def take_until(self, stamp_ns: int) -> None:
        """Pass on the readings up to a stamp."""
        while self._track is not None and self._next is not None and self._next.stamp_ns <= stamp_ns:
            self._track.take(self._next)
            self._next = next(self._readings, None)


def logged_imu(log: Log, config: DynamicsConfig, track: ImuTrack | None) -> LoggedReadings[ImuReading]:
    """Return the readings of the chaser's IMU, with what the estimator needs of each."""
    return LoggedReadings(log, IMU, track, lambda message: checked(read_imu(message), config))


def logged_commands(log: Log, track: CommandTrack | None) -> LoggedReadings[Command]:
    """Return the commanded accelerations of the chaser."""
    return LoggedReadings(log, COMMAND, track, read_command)


def _readings(
    log: Log, topic: Topic, read: Callable[[Any], ReadingT], unused: Counter[str]
) -> Iterator[ReadingT]:
    for logged, hold in of_holders(log, topic.name, unused=unused):
        try:
            reading = read(logged.decode())
        except MessageRejectedError:  # the live estimator did not use it either
            continue
        hold()
        yield reading
