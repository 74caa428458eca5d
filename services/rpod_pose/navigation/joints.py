"""Angles of the target's joints over time: a Kalman filter of angle and rate for each joint."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import sqrt
from typing import Self

import numpy as np

from rpod_pose.belief import Angle
from rpod_schemas.arrays import FloatArray
from rpod_schemas.messages import NANOSECONDS
from rpod_target import Joint

SETTLING_S = 100.0
"""Time over which a rate may change by the joint's greatest rate, one standard deviation. Hand: a drive that
holds its rate; a shorter time widens predictions."""
UNIFORM = sqrt(12.0)
"""Width of a uniform distribution over its standard deviation. Physics: sqrt(12)."""


@dataclass(frozen=True, eq=False)
class JointTrack:
    """Angle and rate of a joint at a time."""

    stamp_ns: int
    state: FloatArray
    """Angle, rad, and rate, rad/s, shape (2,)."""
    covariance: FloatArray
    """Covariance of both, shape (2, 2)."""
    joint: Joint

    @classmethod
    def begun(cls, joint: Joint, angle: Angle, stamp_ns: int) -> Self:
        """Return a track that begins at a first angle; its rate may be any that the joint can have."""
        rate_sigma_rad_s = 2.0 * joint.rate_rad_s / UNIFORM
        covariance = np.diag([angle.sigma_rad**2, rate_sigma_rad_s**2])
        return cls(stamp_ns, np.array([angle.angle_rad, 0.0]), covariance, joint)

    @property
    def angle(self) -> Angle:
        """Angle with its standard deviation, which is at most that of a uniform angle between the limits."""
        least, greatest = self.joint.limits_rad
        angle_rad = float(np.clip(self.state[0], least, greatest))
        return Angle(angle_rad, min(sqrt(self.covariance[0, 0]), (greatest - least) / UNIFORM))

    def at(self, stamp_ns: int) -> "JointTrack":
        """Return the prediction for a time; for a time before the track's own, the track as it is."""
        passed_s = max(stamp_ns - self.stamp_ns, 0) / NANOSECONDS
        F = np.array([[1.0, passed_s], [0.0, 1.0]])
        density = self.joint.rate_rad_s**2 / SETTLING_S
        noise = density * np.array([[passed_s**3 / 3.0, passed_s**2 / 2.0], [passed_s**2 / 2.0, passed_s]])
        covariance = F @ self.covariance @ F.T + noise
        return replace(
            self, stamp_ns=max(stamp_ns, self.stamp_ns), state=F @ self.state, covariance=covariance
        )

    def after(self, angle: Angle) -> "JointTrack":
        """Return the track after an angle that was estimated with this track's prediction as the prior.

        The information that the frame adds is that of the angle minus that of the prior.
        """
        before = float(self.covariance[0, 0])
        if not angle.sigma_rad**2 < before:
            return self
        gain = self.covariance[:, 0] / before
        state = self.state + gain * (angle.angle_rad - self.state[0])
        covariance = self.covariance - np.outer(gain, gain) * (before - angle.sigma_rad**2)
        return replace(self, state=state, covariance=covariance)


def tracked_joints(
    tracks: Mapping[str, JointTrack], joints: Mapping[str, Joint], angles: Mapping[str, Angle], stamp_ns: int
) -> dict[str, JointTrack]:
    """Return the tracks after an accepted frame with these angles; tracks that do not exist yet begin."""
    return {
        **tracks,
        **{
            name: tracks[name].at(stamp_ns).after(angle)
            if name in tracks
            else JointTrack.begun(joints[name], angle, stamp_ns)
            for name, angle in angles.items()
        },
    }
