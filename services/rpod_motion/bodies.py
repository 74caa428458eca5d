"""Poses of known bodies, such as the links of a robot's arm, published in place of the robot."""

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import RigidTransform

from rpod_runtime import Node
from rpod_schemas.config.motion import BodyMotionConfig
from rpod_schemas.messages import write_odometry
from rpod_schemas.topics import BODY, CHASER
from rpod_schemas.types import Odometry


class BodyPublishers:
    """Publishes ``bodies/<frame>/odometry``, each at its own rate; the twists are left at zero.

    Args:
        node: the service's node.
        bodies: the frames, by name.
        rate_hz: rate of the ticks.
    """

    def __init__(self, node: Node, bodies: Mapping[str, BodyMotionConfig], *, rate_hz: float) -> None:
        self._bodies = bodies
        self._publishers = {frame: node.publisher(BODY.at(frame)) for frame in bodies}
        self._every = {frame: max(1, round(rate_hz / body.rate_hz)) for frame, body in bodies.items()}

    def publish(self, tick: int, stamp_ns: int, T_chaser_target: RigidTransform) -> None:
        """Publish the poses that are due at a tick, of which the stamp and the target's pose are given."""
        for frame, body in self._bodies.items():
            if tick % self._every[frame] == 0:
                pose = announced(body, T_chaser_target)
                self._publishers[frame].publish(write_odometry(_message(frame, stamp_ns, pose)))

    def is_due(self, tick: int) -> bool:
        """Return whether a pose is due at a tick."""
        return any(tick % every == 0 for every in self._every.values())


def announced(body: BodyMotionConfig, T_chaser_target: RigidTransform) -> RigidTransform:
    """Return T_chaser_frame as it is published, with its error."""
    pose = body.pose * body.error
    return T_chaser_target * pose if body.fixed_to == "target" else pose


def _message(frame: str, stamp_ns: int, pose: RigidTransform) -> Odometry:
    return Odometry(
        stamp_ns=stamp_ns,
        frame_id=CHASER,
        child_frame_id=frame,
        pose=pose,
        linear_m_s=np.zeros(3),
        angular_rad_s=np.zeros(3),
    )
