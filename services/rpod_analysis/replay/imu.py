"""Readings of the chaser's IMU in a log, passed on up to the time that an estimator has reached."""

from collections import Counter
from collections.abc import Iterator

from rpod_analysis.log import Log
from rpod_analysis.replay.holders import of_holders
from rpod_estimator.inputs.imu import checked
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_schemas.config.estimator.dynamics import DynamicsConfig
from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages import read_imu
from rpod_schemas.topics import IMU
from rpod_schemas.types import ImuReading


class LoggedImu:
    """Passes the readings of a log to a track, in the order of arrival.

    Args:
        log: the log.
        config: what the estimator needs of a reading.
        track: where readings go; None if the IMU is not used.
    """

    def __init__(self, log: Log, config: DynamicsConfig, track: ImuTrack | None) -> None:
        self._track = track
        self.unused: Counter[str] = Counter()
        """Number of messages of publishers that did not hold the topic, by topic."""
        self._readings = iter(()) if track is None else _readings(log, config, self.unused)
        self._next = next(self._readings, None)

    def take_until(self, stamp_ns: int) -> None:
        """Pass on the readings up to a stamp."""
        while self._track is not None and self._next is not None and self._next.stamp_ns <= stamp_ns:
            self._track.take(self._next)
            self._next = next(self._readings, None)


def _readings(log: Log, config: DynamicsConfig, unused: Counter[str]) -> Iterator[ImuReading]:
    for logged, hold in of_holders(log, IMU.name, unused=unused):
        try:
            reading = checked(read_imu(logged.decode()), config)
        except MessageRejectedError:  # the live estimator did not use it either
            continue
        hold()
        yield reading
