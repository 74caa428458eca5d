"""Station keeping on a safety ellipse, in closed form.

Source: W. H. Clohessy, R. S. Wiltshire, Terminal Guidance System for Satellite Rendezvous, J. Aerospace
Sci. 27 (1960) 653-658. In the local frame of the target's circular orbit (x outward along the radius,
y along the track, z along the orbit's normal), of mean motion n, their equations have the bounded solution

    x = -a cos(nt + p),   y = 2 a sin(nt + p),   z = b sin(nt + p),

an ellipse about the target. Radial and cross-track motion in quadrature keep it clear of the track, by a
or b at least, even where the position along the track is uncertain (the safety ellipse of D. E. Gaylor,
B. W. Barbee, Algorithms for Safe Spacecraft Proximity Operations, AAS 07-107).

With e1 = (-1, 0, 0), e2 = (0, 2a, b) / A and A^2 = 4 a^2 + b^2 it reads a cos(nt + p) e1 + A sin(nt + p) e2:
its semi-axes a and A are the least and the greatest range.
"""

from dataclasses import dataclass
from functools import cached_property
from math import atan2, cos, hypot, sin, sqrt

import numpy as np

from rpod_motion.trajectory import TrajectoryState
from rpod_schemas.arrays import FloatArray

EARTH_MU_M3_S2 = 3.986004418e14
"""Gravitational parameter of the Earth (IERS conventions 2010)."""


@dataclass(frozen=True, eq=False)
class StationKeeping:
    """The chaser on a safety ellipse about the target's centre of mass, its z axis pointing there.

    The chaser's y axis (down) is the normal e1 x e2 of the ellipse, constant in the local frame and on the
    far side of the orbit's normal; so it turns about its y axis alone, besides the turn of the local frame.
    """

    anchor_m: FloatArray
    """The target's centre of mass, target axes."""
    least_range_m: float
    greatest_range_m: float
    phase_rad: float
    semi_major_axis_m: float

    @cached_property
    def mean_motion_rad_s(self) -> float:
        """Rate of the orbit and of the local frame about the orbit's normal."""
        return sqrt(EARTH_MU_M3_S2 / self.semi_major_axis_m) / self.semi_major_axis_m

    @cached_property
    def R_epoch_local(self) -> FloatArray:  # noqa: N802 - a rotation
        """From the local frame as it is at the epoch to the epoch axes, shape (3, 3)."""
        psi = atan2(self.greatest_range_m * sin(self.phase_rad), self.least_range_m * cos(self.phase_rad))
        return (self._plane_axes @ _looking_inward(cos(psi), sin(psi))).T

    def state(self, time_s: float) -> TrajectoryState:
        """Return the state at a time from the epoch."""
        n, a, A = self.mean_motion_rad_s, self.least_range_m, self.greatest_range_m
        theta = n * time_s + self.phase_rad
        along_e1_m, along_e2_m = a * cos(theta), A * sin(theta)
        range_m = hypot(along_e1_m, along_e2_m)
        pointing_rate_rad_s = n * a * A / range_m**2
        range_rate_m_s = n * (A**2 - a**2) * sin(theta) * cos(theta) / range_m

        R_local_chaser = self._plane_axes @ _looking_inward(along_e1_m / range_m, along_e2_m / range_m)
        return TrajectoryState(
            R_epoch_chaser=self.R_epoch_local @ _about_normal(n * time_s) @ R_local_chaser,
            chaser_angular_rad_s=np.array([0.0, pointing_rate_rad_s, 0.0]) + n * R_local_chaser[2],
            position_m=np.array([0.0, 0.0, range_m]),
            velocity_m_s=np.array([0.0, 0.0, range_rate_m_s]),
        )

    @cached_property
    def _plane_axes(self) -> FloatArray:
        """R_local_plane: columns e1, e2, e1 x e2."""
        along = 2.0 * self.least_range_m / self.greatest_range_m
        across = sqrt(1.0 - along**2)
        return np.array([[-1.0, 0.0, 0.0], [0.0, along, across], [0.0, across, -along]])


def _looking_inward(cos_psi: float, sin_psi: float) -> FloatArray:
    """Return R_plane_chaser at the angle psi from e1 towards e2: z inward, y the plane's normal."""
    return np.array([[sin_psi, 0.0, -cos_psi], [-cos_psi, 0.0, -sin_psi], [0.0, 1.0, 0.0]])


def _about_normal(angle_rad: float) -> FloatArray:
    """Return the rotation from the local frame, turned by an angle about z, to where it was."""
    c, s = cos(angle_rad), sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
