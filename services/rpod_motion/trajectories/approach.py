"""The straight approach of the proximity laboratory: the chaser follows the target's origin."""

from dataclasses import dataclass, field

import numpy as np

from rpod_motion.trajectories.trajectory import TrajectoryState
from rpod_schemas.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Approach:
    """The target's origin moves on a line in the chaser's axes, which do not rotate in inertial space.

    The speed rises from zero during a share of the duration, is then constant, and falls to zero during the
    same share. The ramps are 3 w^2 - 2 w^3, so the acceleration is continuous. Before the epoch and after the
    end the target is at rest. Without ramps the velocity is constant, also before the epoch and after the
    end.
    """

    start_m: FloatArray
    """Position of the target's origin at the epoch, chaser axes, shape (3,)."""
    end_m: FloatArray
    """Position of the target's origin at the end, chaser axes, shape (3,)."""
    duration_s: float
    ramp_share: float
    """Share of the duration in which the speed rises, and in which it falls; 0 for none, 0.5 at most."""
    anchor_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Point of the target that follows the path, target axes, shape (3,): its origin."""

    def state(self, time_s: float) -> TrajectoryState:
        """Return the state at a time from the epoch."""
        way, way_rate = self._progress(time_s / self.duration_s)
        line_m = self.end_m - self.start_m
        return TrajectoryState(
            R_epoch_chaser=np.eye(3),
            chaser_angular_rad_s=np.zeros(3),
            position_m=self.start_m + way * line_m,
            velocity_m_s=way_rate / self.duration_s * line_m,
        )

    def _progress(self, share: float) -> tuple[float, float]:
        """Return the share of the way after a share of the duration, and its derivative."""
        if self.ramp_share == 0.0:
            return share, 1.0
        if share > 0.5:  # the end is the start in reverse
            way, rate = self._setting_out(1.0 - share)
            return 1.0 - way, rate
        return self._setting_out(share)

    def _setting_out(self, share: float) -> tuple[float, float]:
        ramp = self.ramp_share
        cruise = 1.0 / (1.0 - ramp)
        w = min(max(share / ramp, 0.0), 1.0)
        way = ramp * (w**3 - w**4 / 2.0) + max(share - ramp, 0.0)
        return cruise * way, cruise * (3.0 * w**2 - 2.0 * w**3)
