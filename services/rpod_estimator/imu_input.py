"""The chaser's IMU as an input of the estimator: readings from the bus into the track of the dynamics."""

import logging
import time

from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_runtime import Inbox, Node, Received
from rpod_runtime.holders import Holders
from rpod_schemas.config.dynamics import DynamicsConfig
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_imu
from rpod_schemas.topics import IMU
from rpod_schemas.types import ImuReading

log = logging.getLogger(__name__)

_LATE_S = 0.05
"""Longest wait for readings up to a frame's stamp, by the wall clock: readings need a few milliseconds."""
_LOCKSTEP_S = 5.0
"""The same in lockstep, where readings are sent before the frame and a machine may be loaded."""
_WAITING = 8192


class ImuInput:
    """Receives ``chaser/imu``, and waits until a frame's stamp is covered.

    Args:
        node: the estimator's node.
        config: its configuration.
        track: where readings go; None if the IMU is not used.
    """

    def __init__(self, node: Node, config: EstimatorConfig, track: ImuTrack | None) -> None:
        self._node, self._config, self._track = node, config.dynamics, track
        self._wait_s = _LOCKSTEP_S if config.time_source == "clock" else _LATE_S
        self._inbox, self._holders = Inbox(_WAITING), Holders()
        self._is_behind = False
        if track is not None:
            node.subscribe(IMU, self._inbox.put, recover=config.time_source == "clock")

    def hear_up_to(self, stamp_ns: int) -> None:
        """Take in what has arrived; wait a little for readings up to a frame's stamp.

        After a wait in vain no other frame waits, until readings are there again.
        """
        if self._track is None:
            return
        self._take(self._inbox.wait(0.0))
        ends_s = time.monotonic() + self._wait_s * (not self._is_behind)
        while not self._track.covers(stamp_ns) and (left_s := ends_s - time.monotonic()) > 0.0:
            self._take(self._inbox.wait(left_s))
        self._tell(behind=not self._track.covers(stamp_ns))

    def _take(self, messages: list[Received]) -> None:
        assert self._track is not None  # noqa: S101 - guaranteed by the caller
        for received in messages:
            try:
                self._holders.check(IMU.name, received.peer, received.arrival_s)
                reading = checked(read_imu(received.decode()), self._config)
                if not self._track.hear(reading):
                    raise MessageRejectedError(Reason.DUPLICATE, "a reading that is not newer is there")
                self._holders.hold(IMU.name, received.peer, received.arrival_s)
            except MessageRejectedError as error:
                self._node.reject(IMU.name, error)
        self._node.health.put("overflowed/imu", self._inbox.overflowed)

    def _tell(self, *, behind: bool) -> None:
        """Tell when readings begin to be missing, and when they are there again."""
        if behind:
            self._node.health.count("imu/behind")
        if behind == self._is_behind:
            return
        self._is_behind = behind
        text = (
            f"{IMU.name} has no reading up to the frame: the chaser's rotation is unknown, and a track "
            "coasts less long; check its publisher"
        )
        self._node.health.alarm("imu", text if behind else "")
        log.log(
            logging.WARNING if behind else logging.INFO, text if behind else f"{IMU.name}: in order again"
        )


def checked(reading: ImuReading, config: DynamicsConfig) -> ImuReading:
    """Return a reading that has what the configuration needs; others raise ``MessageRejectedError``."""
    orbit = config.orbit
    if orbit is not None and orbit.R_orbit_chaser is None and reading.R_orbit_chaser is None:
        raise MessageRejectedError(
            Reason.MALFORMED,
            "orientation is absent, and dynamics.orbit needs the chaser's attitude in the orbital frame; set "
            "dynamics.orbit.R_orbit_chaser, or leave out dynamics.orbit",
        )
    used = config.imu is not None and config.imu.acceleration_bias_sigma_m_s2 is not None
    if used and reading.force_m_s2 is None:
        raise MessageRejectedError(
            Reason.MALFORMED,
            "linear acceleration is absent; leave out dynamics.imu.acceleration_bias_sigma_m_s2",
        )
    return reading
