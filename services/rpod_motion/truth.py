"""Publishes the truth: odometry at every tick, the sun, transforms for viewers, and known bodies."""

from collections.abc import Mapping
from math import radians
from typing import NamedTuple

from rpod_motion.bodies import BodyPublishers
from rpod_motion.imu import Imu
from rpod_motion.motion import Motion
from rpod_motion.thrust import Thrusters
from rpod_motion.truth_error import TruthError
from rpod_runtime import Node
from rpod_schemas.config.motion import BodyMotionConfig
from rpod_schemas.messages import (
    NANOSECONDS,
    write_joints,
    write_odometry,
    write_transforms,
    write_vector_stamped,
)
from rpod_schemas.rmw.cdr import encode
from rpod_schemas.topics import CHASER, COMMAND, IMU, REFERENCE, SUN, TARGET, TF, TRUTH, TRUTH_JOINTS
from rpod_schemas.types import Joints, Odometry

_TF_HZ = 25.0
_SUN_HZ = 1.0
_AHEAD_S = 0.032
"""Time span for which truth is computed in one go.

A tick that is computed alone, after the processor has done other work, takes three times as long.
"""


class _Made(NamedTuple):
    """Messages of one tick."""

    truth: bytearray
    """The motion as it is known, with its error."""
    reference: bytearray
    """The motion as it is; the same message where the truth has no error."""
    transform: bytearray | None
    """Transform for viewers, if one is due."""


class TruthPublisher:
    """Publishes the state of a motion, tick by tick; tick 0 is the epoch."""

    def __init__(
        self,
        node: Node,
        motion: Motion,
        *,
        epoch_ns: int,
        rate_hz: float,
        error: TruthError | None = None,
        imu: Imu | None = None,
        thrusters: Thrusters | None = None,
        bodies: Mapping[str, BodyMotionConfig] | None = None,
    ) -> None:
        self._motion, self._error = motion, error
        self._epoch_ns, self._rate_hz = epoch_ns, rate_hz
        self._tf_every = max(1, round(rate_hz / _TF_HZ))
        self._sun_every = max(1, round(rate_hz / _SUN_HZ))
        self._ahead = int(_AHEAD_S * rate_hz)
        self._truth, self._reference = node.publisher(TRUTH), node.publisher(REFERENCE)
        self._joints = node.publisher(TRUTH_JOINTS) if motion.joints else None
        self._of_chaser = [
            (node.publisher(topic), source, max(1, round(rate_hz / source.rate_hz)))
            for topic, source in ((IMU, imu), (COMMAND, thrusters))
            if source is not None
        ]
        self._bodies = BodyPublishers(node, bodies or {}, rate_hz=rate_hz)
        self._tf, self._sun = node.publisher(TF), node.publisher(SUN)
        self._made: dict[int, _Made] = {}

    def tick(self, time_s: float) -> int:
        """Return the last tick at or before a time from the epoch."""
        return int(time_s * self._rate_hz // 1)

    def stamp_ns(self, tick: int) -> int:
        """Return a tick's stamp."""
        return self._epoch_ns + round(tick * NANOSECONDS / self._rate_hz)

    def publish(self, tick: int) -> None:
        """Publish the truth of a tick, and the motion without its error as the reference."""
        if tick % self._sun_every == 0 or not self._sun.published:  # the latched sun precedes all truth
            sun = self._motion.sun_W_m2(tick / self._rate_hz)
            self._sun.publish(write_vector_stamped(self.stamp_ns(tick), CHASER, sun))
        made = self._made.pop(tick) if tick in self._made else self._make(tick)
        self._truth.put(made.truth)
        self._reference.put(made.reference)
        if made.transform:
            self._tf.put(made.transform)
            self._publish_joints(tick)
        for publisher, source, every in self._of_chaser:
            if tick % every == 0:
                publisher.publish(source.message(self.stamp_ns(tick), tick / self._rate_hz))
        if self._bodies.is_due(tick):
            state = self._motion.state(tick / self._rate_hz)
            self._bodies.publish(tick, self.stamp_ns(tick), state.T_chaser_target)
        if not self._made:
            self._made = {later: self._make(later) for later in range(tick + 1, tick + 1 + self._ahead)}

    def _publish_joints(self, tick: int) -> None:
        if self._joints is not None:
            time_s, joints = tick / self._rate_hz, self._motion.joints
            angles = {name: joint.angle_rad(time_s) for name, joint in joints.items()}
            rates = {name: radians(joint.rate_deg_s) for name, joint in joints.items()}
            there = Joints(stamp_ns=self.stamp_ns(tick), angle_rad=angles, rate_rad_s=rates)
            self._joints.publish(write_joints(there))

    def _make(self, tick: int) -> _Made:
        """Return the messages of a tick; the ticks' errors follow each other."""
        stamp_ns = self.stamp_ns(tick)
        state = self._motion.state(tick / self._rate_hz)
        exact = Odometry(
            stamp_ns=stamp_ns,
            frame_id=CHASER,
            child_frame_id=TARGET,
            pose=state.T_chaser_target,
            linear_m_s=state.linear_m_s,
            angular_rad_s=state.angular_rad_s,
        )
        known, reference = exact, encode(write_odometry(exact))
        if self._error is not None:
            pose = self._error.perturb(exact.pose)
            known = exact.model_copy(update={"pose": pose, "pose_covariance": self._error.covariance})
        transform = None
        if tick % self._tf_every == 0:
            transform = encode(write_transforms(stamp_ns, [(CHASER, TARGET, known.pose)]))
        return _Made(reference if known is exact else encode(write_odometry(known)), reference, transform)
