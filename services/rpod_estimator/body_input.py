"""Poses of known bodies as an input of the estimator, such as those of the links of the robot's arm."""

from rpod_estimator.stamped_input import StampedInput
from rpod_pose.surroundings.bodies import FrameTrack, KnownBodies
from rpod_runtime import Node, Received
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_odometry
from rpod_schemas.topics import BODY, CHASER
from rpod_schemas.types import Odometry


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
        "{topics}: no pose up to the frame: the body is not taken out of it, and may hide the target or "
        "be taken for it; check its publisher"
    )
    again = "the poses of all bodies are known again"

    def __init__(self, node: Node, config: EstimatorConfig, bodies: KnownBodies | None) -> None:
        tracks = bodies.tracks.items() if bodies else ()
        in_lockstep = config.time_source == "clock"
        super().__init__(node, {BODY.at(frame): track for frame, track in tracks}, in_lockstep=in_lockstep)

    def use(self, track: FrameTrack, received: Received) -> bool:
        """Use the pose of a body; return whether it is newer than all before."""
        reading = checked(read_odometry(received.decode()))
        return track.hear(reading.stamp_ns, reading.pose)

    def is_known(self, track: FrameTrack, stamp_ns: int) -> bool:
        """Return whether the pose of a body at a stamp is known."""
        return track.at(stamp_ns) is not None


def checked(reading: Odometry) -> Odometry:
    """Return a reading in ``chaser``; others raise ``MessageRejectedError``."""
    if reading.frame_id != CHASER:
        raise MessageRejectedError(
            Reason.MALFORMED, f"frame_id is {reading.frame_id!r}: publish the body's pose in {CHASER!r}"
        )
    return reading
