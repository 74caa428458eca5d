"""Thrust of the chaser along its trajectory, and the commands that lead to it by imperfect thrusters."""

from math import sqrt

import numpy as np

from rpod_motion.motion import Motion
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import CommandErrorConfig
from rpod_schemas.messages import write_command
from rpod_schemas.topics import CHASER
from rpod_schemas.types import Command

_STREAM = 0x636D64
"""Number that separates this noise from other noise of the same seed: "cmd" in ASCII."""
_DIFFERENCE_S = 0.02
"""Step of the difference that gives the acceleration."""
_LEAST_M_S2 = 1e-9
"""Accelerations below it are errors of rounding in the difference: such a chaser flies freely."""


def specific_force_m_s2(motion: Motion, centre_m: FloatArray, time_s: float) -> FloatArray:
    """Return the specific force of the chaser at a time from the epoch, chaser axes, shape (3,).

    Where the trajectory has an orbit, the chaser flies freely and the force is 0. Without an orbit there is
    no gravity: the acceleration of the target's centre of mass, as seen from the chaser, is caused by the
    chaser's thrust and has the opposite direction.

    Args:
        motion: the motion.
        centre_m: centre of mass of the target, target axes, shape (3,).
        time_s: time from the epoch.
    """
    state = motion.state(time_s)
    if state.R_orbit_chaser is not None:
        return np.zeros(3)
    before, here, after = (
        _centre_E_m(motion, centre_m, time_s + step_s) for step_s in (-_DIFFERENCE_S, 0.0, _DIFFERENCE_S)
    )
    force = -state.R_epoch_chaser.T @ ((before - 2.0 * here + after) / _DIFFERENCE_S**2)
    return force if np.linalg.norm(force) > _LEAST_M_S2 else np.zeros(3)


def _centre_E_m(motion: Motion, centre_m: FloatArray, time_s: float) -> FloatArray:  # noqa: N802 - epoch axes
    """Return the target's centre of mass from the chaser's origin, epoch axes, shape (3,)."""
    state = motion.state(time_s)
    found: FloatArray = state.R_epoch_chaser @ state.T_chaser_target.apply(centre_m)
    return found


class Thrusters:
    """Commands whose execution, with errors, is the thrust of a motion.

    The executed acceleration is the command plus s |command| (g e + r x e), where e is its direction and s
    the configured standard deviation; g and r are drawn once (C. R. Gates, A Simplified Model of Midcourse
    Maneuver Execution Errors, JPL TR 32-504, 1963). It begins after the delay, and noise is added.

    Args:
        config: errors of the thrusters.
        motion: the motion.
        centre_of_mass_m: centre of mass of the target, target axes, shape (3,).
        seed: seed of the errors.
    """

    def __init__(
        self, config: CommandErrorConfig, motion: Motion, *, centre_of_mass_m: FloatArray, seed: int
    ) -> None:
        self._config, self._motion, self._centre_m = config, motion, centre_of_mass_m
        self._seed, self.rate_hz = seed, config.rate_hz
        self.errors: FloatArray = np.random.default_rng((seed, _STREAM)).standard_normal(4)
        """Errors (g, r) of size and direction, in standard deviations, shape (4,)."""
        gain, (x, y, z) = self.errors[0], self.errors[1:]
        turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        self._of_executed = np.linalg.inv(np.eye(3) + config.sigma * (gain * np.eye(3) + turn))

    def command(self, stamp_ns: int, time_s: float) -> Command:
        """Return the command of a time from the epoch, under its stamp; its noise is keyed by both.

        It holds for a period, so that the middle of this period, after the delay, counts.
        """
        config, period_s = self._config, 1.0 / self.rate_hz
        middle_s = time_s + config.delay_s + 0.5 * period_s
        executed = specific_force_m_s2(self._motion, self._centre_m, middle_s)
        if not executed.any():
            return Command(stamp_ns=stamp_ns, frame_id=CHASER, acceleration_m_s2=np.zeros(3))
        number = round(time_s * self.rate_hz)
        noise = np.random.default_rng((self._seed, _STREAM, number + 1_000_000)).standard_normal(3)
        executed = executed + config.noise_m_s_sqrt_s * sqrt(self.rate_hz) * noise
        commanded = self._of_executed @ executed
        return Command(
            stamp_ns=stamp_ns,
            frame_id=CHASER,
            acceleration_m_s2=commanded,
            variance=float(config.sigma**2 * (commanded @ commanded)),
        )

    def message(self, stamp_ns: int, time_s: float) -> object:
        """Return the geometry_msgs/AccelWithCovarianceStamped of a command."""
        return write_command(self.command(stamp_ns, time_s))
