"""Trajectories on which the chaser turns: with the target as it flies around it, or to and fro."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import cos, pi, sin

import numpy as np

from rpod_motion.attitude import TargetAttitude, rotation_about
from rpod_motion.trajectories.relative_orbit import cross
from rpod_motion.trajectories.trajectory import Trajectory, TrajectoryState
from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Synchronised:
    """A path in the chaser's axes, which keep the attitude to the target that they have at the epoch.

    With R_CT the attitude at the epoch, R_EC(t) = R_ET(t) R_CT^T, and the chaser's rate is the target's:
    omega_C = R_CT omega_T.
    """

    path: Trajectory
    attitude: TargetAttitude
    """Attitude of the target; one that turns relative to inertial space."""
    anchor_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Point of the target that follows the path, target axes, shape (3,): its origin."""

    def state(self, time_s: float) -> TrajectoryState:
        """Return the state at a time from the epoch."""
        state, R_chaser_target = self.path.state(time_s), self._attitude_kept
        R_epoch_target, rate_rad_s = self.attitude.relative(time_s, _at_rest(state))
        return replace(
            state,
            R_epoch_chaser=R_epoch_target @ R_chaser_target.T,
            chaser_angular_rad_s=R_chaser_target @ rate_rad_s,
        )

    @cached_property
    def _attitude_kept(self) -> FloatArray:
        """The attitude to the target at the epoch, which the chaser keeps, shape (3, 3)."""
        return self.attitude.relative(0.0, _at_rest(self.path.state(0.0)))[0]


def _at_rest(state: TrajectoryState) -> TrajectoryState:
    """Return the state of a chaser in the epoch axes."""
    return replace(state, R_epoch_chaser=np.eye(3), chaser_angular_rad_s=np.zeros(3))


@dataclass(frozen=True, eq=False)
class Slewing:
    """A trajectory whose chaser turns to and fro beside it, by S(t) about an axis.

    R_EC S is its attitude, S^T p the anchor's position.
    """

    path: Trajectory
    axis: FloatArray
    """Unit vector, chaser axes, shape (3,)."""
    amplitude_rad: float
    period_s: float

    @property
    def anchor_m(self) -> FloatArray:
        """Point of the target that follows the path, target axes, shape (3,)."""
        return self.path.anchor_m

    def state(self, time_s: float) -> TrajectoryState:
        """Return the state at a time from the epoch."""
        state = self.path.state(time_s)
        frequency = 2.0 * pi / self.period_s
        S = rotation_about(self.axis, self.amplitude_rad * sin(frequency * time_s))
        own_rad_s = self.amplitude_rad * frequency * cos(frequency * time_s) * self.axis
        position_m = S.T @ state.position_m
        attitude = state.R_orbit_chaser
        return TrajectoryState(
            R_epoch_chaser=state.R_epoch_chaser @ S,
            chaser_angular_rad_s=S.T @ state.chaser_angular_rad_s + own_rad_s,
            position_m=position_m,
            velocity_m_s=S.T @ state.velocity_m_s - cross(own_rad_s, position_m),
            R_orbit_chaser=None if attitude is None else attitude @ S,
        )
