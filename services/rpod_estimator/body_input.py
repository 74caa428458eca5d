"""Poses of known bodies as an input of the estimator, such as those of the links of the robot's arm."""

import logging
import time

from rpod_pose.surroundings.bodies import KnownBodies
from rpod_runtime import Inbox, Node, Received
from rpod_runtime.holders import Holders
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_odometry
from rpod_schemas.topics import BODY, CHASER
from rpod_schemas.types import Odometry

log = logging.getLogger(__name__)

_LATE_S = 0.02
"""Longest wait for readings up to a frame's stamp, by the wall clock: readings need a few milliseconds."""
_LOCKSTEP_S = 5.0
"""The same in lockstep, where readings are sent before the frame and a machine may be loaded."""
_WAITING = 8192


class BodyInput:
    """Receives ``bodies/<frame>/odometry``, and waits until a frame's stamp is covered.

    Args:
        node: the estimator's node.
        config: its configuration.
        bodies: where readings go; None if no body is known.
    """

    def __init__(self, node: Node, config: EstimatorConfig, bodies: KnownBodies | None) -> None:
        self._node, self._bodies = node, bodies
        in_lockstep = config.time_source == "clock"
        self._wait_s = _LOCKSTEP_S if in_lockstep else _LATE_S
        self._inbox, self._holders = Inbox(_WAITING), Holders()
        self._unknown: tuple[str, ...] = ()
        self._frames: dict[str, str] = {}
        for frame in () if bodies is None else bodies.tracks:
            topic = BODY.at(frame)
            self._frames[topic.name] = frame
            node.subscribe(topic, self._inbox.put, recover=in_lockstep)

    def hear_up_to(self, stamp_ns: int) -> None:
        """Take in what has arrived; wait a little for readings up to a frame's stamp.

        After a wait in vain no other frame waits, until readings are there again.
        """
        if self._bodies is None or not self._frames:
            return
        self._take(self._inbox.wait(0.0))
        ends_s = time.monotonic() + self._wait_s * (not self._unknown)
        tracks = self._bodies.tracks.values()
        while not all(track.covers(stamp_ns) for track in tracks) and (
            (left_s := ends_s - time.monotonic()) > 0.0
        ):
            self._take(self._inbox.wait(left_s))
        self._tell(self._bodies.unknown(stamp_ns))

    def _take(self, messages: list[Received]) -> None:
        assert self._bodies is not None  # noqa: S101 - guaranteed by the caller
        for received in messages:
            name = received.topic.name
            try:
                self._holders.check(name, received.peer, received.arrival_s)
                reading = checked(read_odometry(received.decode()))
                if not self._bodies.tracks[self._frames[name]].hear(reading.stamp_ns, reading.pose):
                    raise MessageRejectedError(Reason.DUPLICATE, "a reading that is not newer is there")
                self._holders.hold(name, received.peer, received.arrival_s)
            except MessageRejectedError as error:
                self._node.reject(name, error)
        self._node.health.put("overflowed/bodies", self._inbox.overflowed)

    def _tell(self, unknown: tuple[str, ...]) -> None:
        """Tell when the pose of a body begins to be missing, and when it is there again."""
        if unknown:
            self._node.health.count("bodies/unknown")
        if unknown == self._unknown:
            return
        self._unknown = unknown
        topics = ", ".join(BODY.at(frame).name for frame in unknown)
        text = (
            f"{topics}: no pose up to the frame: the body is not taken out of it, and may hide the target or "
            "be taken for it; check its publisher"
        )
        self._node.health.alarm("bodies", text if unknown else "")
        if unknown:
            log.warning("%s", text)
        else:
            log.info("the poses of all bodies are known again")


def checked(reading: Odometry) -> Odometry:
    """Return a reading in ``chaser``; others raise ``MessageRejectedError``."""
    if reading.frame_id != CHASER:
        raise MessageRejectedError(
            Reason.MALFORMED, f"frame_id is {reading.frame_id!r}: publish the body's pose in {CHASER!r}"
        )
    return reading
