"""Motion that is as lively as a filter's densities state.

A shipped scenario moves smoothly. The filter allows for more than that, so that the innovations are smaller
than their covariance. Whether this covariance is true shows only where the target moves as stated.
"""

from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Self

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from rpod_motion.motion import Motion, MotionState
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig

STEP_S = 0.005
"""Step within which an acceleration is constant, s: far below the time between two frames."""


@dataclass(frozen=True, eq=False)
class DrivenMotion:
    """A motion with white accelerations in addition."""

    motion: Motion
    centre_m: FloatArray
    """Centre of mass of the target, target axes, shape (3,)."""
    times_s: FloatArray
    """Instants of the grid, s, shape (K,)."""
    displacements_m: FloatArray
    """Additional displacement of the centre of mass, chaser axes, shape (K, 3)."""
    turns: Slerp
    """Additional turn, chaser axes."""

    @classmethod
    def drawn(
        cls,
        motion: Motion,
        config: FilterConfig,
        centre_m: FloatArray,
        generator: Generator,
        *,
        begin_s: float,
        seconds: float,
    ) -> Self:
        """Return a motion with accelerations of the filter's densities from an instant on.

        Args:
            motion: motion without them.
            config: the filter, which states the densities.
            centre_m: centre of mass of the target, target axes, shape (3,).
            generator: random numbers.
            begin_s: instant at which they begin, s.
            seconds: how long they last, s.
        """
        times_s = begin_s + STEP_S * np.arange(int(np.ceil(seconds / STEP_S)) + 2, dtype=np.float64)
        velocity_m_s, rate_rad_s = (
            np.sqrt(density * STEP_S) * generator.standard_normal((len(times_s), 3)).cumsum(axis=0)
            for density in (config.acceleration_density_m2_s3, config.angular_acceleration_density_rad2_s3)
        )
        steps = Rotation.from_rotvec(STEP_S * rate_rad_s[:-1])
        turns = list(accumulate(steps, lambda before, step: step * before, initial=Rotation.identity()))
        moved_m = STEP_S * np.vstack((np.zeros(3), velocity_m_s[:-1])).cumsum(axis=0)
        return cls(motion, centre_m, times_s, moved_m, Slerp(times_s, Rotation.concatenate(turns)))

    def state(self, time_s: float) -> MotionState:
        """Return the state with the driven pose; rates are those without the accelerations."""
        state = self.motion.state(time_s)
        inside_s = float(np.clip(time_s, self.times_s[0], self.times_s[-1]))
        turn = self.turns(inside_s)
        moved_m = np.array([np.interp(inside_s, self.times_s, axis_m) for axis_m in self.displacements_m.T])
        true = state.T_chaser_target
        turned = turn * true.rotation
        centre_m = true.translation + true.rotation.apply(self.centre_m) + moved_m
        pose = RigidTransform.from_components(centre_m - turned.apply(self.centre_m), turned)
        return replace(state, T_chaser_target=pose)

    def sun_W_m2(self, time_s: float) -> FloatArray:  # noqa: N802 - watt
        """Return the direction to the sun times its irradiance, chaser axes, shape (3,)."""
        return self.motion.sun_W_m2(time_s)
