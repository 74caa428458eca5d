"""Readings of the chaser's IMU in a log, as far as an estimator has come."""

from collections.abc import Iterator

from rpod_analysis.log import Log
from rpod_estimator.imu_input import checked
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_schemas.config.dynamics import DynamicsConfig
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
        self._readings = iter(()) if track is None else _readings(log, config)
        self._next = next(self._readings, None)

    def hear_up_to(self, stamp_ns: int) -> None:
        """Pass on the readings up to a stamp."""
        while self._track is not None and self._next is not None and self._next.stamp_ns <= stamp_ns:
            self._track.hear(self._next)
            self._next = next(self._readings, None)


def _readings(log: Log, config: DynamicsConfig) -> Iterator[ImuReading]:
    for logged in log.messages(IMU.name):
        try:
            yield checked(read_imu(logged.decode()), config)
        except MessageRejectedError:  # the live estimator did not use it either
            continue
