"""A trajectory in target axes: the chaser turns with the target and flies around it."""

from dataclasses import dataclass, field, replace

import numpy as np

from rpod_motion.attitude import TargetAttitude
from rpod_motion.trajectory import Trajectory, TrajectoryState
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

    def state(self, time_s: float) -> TrajectoryState:
        """Return the state at a time from the epoch."""
        state = self.path.state(time_s)
        at_rest = replace(state, R_epoch_chaser=np.eye(3), chaser_angular_rad_s=np.zeros(3))
        R_chaser_target, _ = self.attitude.relative(0.0, at_rest)
        R_epoch_target, rate_rad_s = self.attitude.relative(time_s, at_rest)
        return replace(
            state,
            R_epoch_chaser=R_epoch_target @ R_chaser_target.T,
            chaser_angular_rad_s=R_chaser_target @ rate_rad_s,
        )
