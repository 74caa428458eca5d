"""Station keeping on a safety ellipse about a target in orbit, in closed form.

The ellipse (``relative_orbit``) reads a cos(p) e1 + A sin(p) e2 with e1 = (-1, 0, 0), e2 = (0, 2a, b) / A and
A^2 = 4 a^2 + b^2 in the target's local frame: its semi-axes a and A are the least and the greatest range.
They are accurate to a millimetre: the neglected terms are of second order in range divided by orbit radius.
"""

from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Self

import numpy as np

from rpod_motion.trajectories.relative_orbit import MeanOrbit, RelativeOrbit, cross, mean_latitude_at_phase
from rpod_motion.trajectories.trajectory import TrajectoryState
from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class StationKeeping:
    """The chaser moves around the target's centre of mass, and its z axis points at it.

    The chaser's y axis (down) is as close as possible to the normal e1 x e2 of the ellipse, which is constant
    in the local frame and on the far side of the orbit's normal.
    """

    anchor_m: FloatArray
    """The target's centre of mass, target axes, shape (3,)."""
    orbit: RelativeOrbit
    down_L: FloatArray
    """Unit normal of the ellipse, the target's local axes, shape (3,)."""

    @classmethod
    def on_safety_ellipse(
        cls,
        anchor_m: FloatArray,
        *,
        least_range_m: float,
        greatest_range_m: float,
        phase_rad: float,
        semi_major_axis_m: float,
        inclination_rad: float,
    ) -> Self:
        """Return the station keeping about a target whose mean orbit is a circle.

        The phase at the epoch, p = u - 90 deg, determines the position of the target on its orbit at that
        time.
        """
        target = MeanOrbit(
            semi_major_axis_m=semi_major_axis_m,
            eccentricity=0.0,
            inclination_rad=inclination_rad,
            node_rad=0.0,
            perigee_rad=0.0,
            mean_anomaly_rad=mean_latitude_at_phase(phase_rad),
        )
        along = 2.0 * least_range_m / greatest_range_m
        across = sqrt(1.0 - along**2)
        orbit = RelativeOrbit.safety_ellipse(
            target, radial_m=least_range_m, cross_track_m=across * greatest_range_m
        )
        return cls(anchor_m, orbit, down_L=np.array([0.0, across, -along]))

    @cached_property
    def R_epoch_inertial(self) -> FloatArray:  # noqa: N802 - a rotation
        """Rotation from Earth-centred inertial axes to the epoch axes, shape (3, 3)."""
        separation_m, _, target = self.orbit.separation(0.0)
        return (target.R_inertial_local @ self._looking_at_target(separation_m)).T

    def state(self, time_s: float) -> TrajectoryState:
        """Return the state at a time from the epoch."""
        separation_m, rate_m_s, target = self.orbit.separation(time_s)
        range_m = sqrt(separation_m @ separation_m)
        R_local_chaser = self._looking_at_target(separation_m)
        across_m_s = rate_m_s @ R_local_chaser  # rate of the separation, so z rotates the opposite way
        down = self.down_L @ R_local_chaser
        pitch_rad_s = -across_m_s[0] / range_m
        turn = np.array([across_m_s[1] / range_m, pitch_rad_s, pitch_rad_s * down[2] / down[1]])
        return TrajectoryState(
            R_epoch_chaser=self.R_epoch_inertial @ target.R_inertial_local @ R_local_chaser,
            chaser_angular_rad_s=turn + target.local_rate_rad_s @ R_local_chaser,
            position_m=np.array([0.0, 0.0, range_m]),
            velocity_m_s=np.array([0.0, 0.0, -across_m_s[2]]),
            R_orbit_chaser=R_local_chaser,
        )

    def _looking_at_target(self, separation_m: FloatArray) -> FloatArray:
        """Return R_local_chaser: z towards the target, y as close as possible to the ellipse's normal."""
        z = -separation_m / sqrt(separation_m @ separation_m)
        y = self.down_L - (self.down_L @ z) * z
        y /= sqrt(y @ y)
        return np.stack([cross(y, z), y, z], axis=1)
