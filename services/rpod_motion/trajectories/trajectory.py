"""The protocol of a trajectory: the chaser's attitude, and the path of the target's *anchor* in chaser axes.

The anchor is the point of the target that the trajectory moves; the other points follow from the attitude.
Inertial space is represented by the *epoch axes*: the chaser's axes at the epoch, kept fixed in inertial
space.
"""

from dataclasses import dataclass
from typing import Protocol

from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class TrajectoryState:
    """Attitude of the chaser and position of the anchor at one time."""

    R_epoch_chaser: FloatArray
    """Attitude of the chaser, shape (3, 3)."""
    chaser_angular_rad_s: FloatArray
    """Rate of the chaser relative to inertial space, chaser axes, shape (3,)."""
    position_m: FloatArray
    """Position of the anchor, chaser axes, shape (3,)."""
    velocity_m_s: FloatArray
    """Time derivative of ``position_m``, shape (3,)."""
    R_orbit_chaser: FloatArray | None = None
    """Attitude of the chaser in the orbital frame, shape (3, 3), in free flight about the Earth; None for a
    trajectory without an orbit."""


class Trajectory(Protocol):
    """A path through time, defined also shortly before the epoch and after the end."""

    @property
    def anchor_m(self) -> FloatArray:
        """Point of the target that follows this path, origin or centre of mass; target axes, shape (3,)."""
        ...

    def state(self, time_s: float) -> TrajectoryState:
        """Return the state at a time from the epoch."""
        ...
