"""Poses of known bodies as an input of the estimator, such as those of the links of the robot's arm."""

import logging

from rpod_estimator.inputs.stamped import StampedInput
from rpod_pose.surroundings.bodies import FrameTrack, KnownBodies
from rpod_pose.surroundings.body_check import BodyBook, BodyState
from rpod_runtime import Node, Received
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_odometry
from rpod_schemas.topics import BODY, CHASER
from rpod_schemas.types import Odometry

log = logging.getLogger(__name__)


class BodyInput(StampedInput[FrameTrack]):
    """Receives ``bodies/<frame>/odometry``, and waits until a frame's stamp is covered.

    Args:
        node: the estimator's node.
        config: its configuration.
        bodies: where readings go; None if no body is known.
    """

    name, lack = "bodies", "unknown"
    late_s = 0.02
    alarm = (
        "{topics}: no pose up to the frame's time: the body is not removed from the frame, and may hide the "
        "target or be taken for it; check its publisher"
    )
    again = "the poses of all bodies are known again"

    def __init__(self, node: Node, config: EstimatorConfig, bodies: KnownBodies | None) -> None:
        tracks = bodies.tracks.items() if bodies else ()
        topics = {BODY.at(frame): track for frame, track in tracks}
        super().__init__(node, topics, in_lockstep=config.in_lockstep)

    def use(self, track: FrameTrack, received: Received) -> bool:
        """Add the pose of a body and return True; return False if it is not newer than all before."""
        reading = checked(read_odometry(received.decode()))
        return track.take(reading.stamp_ns, reading.pose)

    def is_known(self, track: FrameTrack, stamp_ns: int) -> bool:
        """Return whether the pose of a body at a stamp is known."""
        return track.at(stamp_ns) is not None


class BodyReport:
    """Reports to the operator which known bodies the sensors do not see at their published places.

    Args:
        node: the estimator's node.
        bodies: the bodies; None if none is known.
    """

    def __init__(self, node: Node, bodies: KnownBodies | None) -> None:
        self._node, self._book = node, bodies.book if bodies else BodyBook()
        self._reported: dict[str, BodyState] = {}

    def update(self) -> None:
        """Write counters and texts into the diagnostics, and a line into the log when a state changes."""
        health = self._node.health
        for (body, sensor, state), frames in self._book.counts.items():
            health.put(f"bodies/{body}/{sensor}/{state}", frames)
        for body, sensor, state, text in self._book.states:
            name = f"body/{body}/{sensor}"
            health.alarm(name, text if state is BodyState.ELSEWHERE else "")
            health.set_text(name, text if state is BodyState.UNSEEN else "")
            if state is not self._reported.get(name, BodyState.IN_PLACE):
                level = logging.INFO if state is BodyState.IN_PLACE else logging.WARNING
                log.log(level, "%s", text or f"{sensor} sees the known body {body} in its place again")
            self._reported[name] = state


def checked(reading: Odometry) -> Odometry:
    """Return a reading unchanged if its frame is ``chaser``. Raises ``MessageRejectedError``."""
    if reading.frame_id != CHASER:
        raise MessageRejectedError(
            Reason.MALFORMED, f"frame_id is {reading.frame_id!r}: publish the body's pose in {CHASER!r}"
        )
    return reading
