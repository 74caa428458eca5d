"""Commanded accelerations of the chaser, and a chaser whose motion they complete.

A command holds from its stamp until the next one, and at most ``VALID_S``. What thrusters execute differs:
in size and direction by errors that last and are proportional to the command (C. R. Gates, A Simplified Model
of Midcourse Maneuver Execution Errors, JPL TR 32-504, 1963), by noise, and by a delay. With the direction e
of a command and the standard deviation s of its execution, the executed acceleration is the command plus
s (g e + r x e). The four numbers (g, r) are states of the filter with a standard deviation of 1. A command of
zero is executed exactly. While no command holds, the acceleration is unknown.
"""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from math import ceil

import numpy as np

from rpod_pose.navigation.dynamics.chaser import Chaser, ChaserStep, pushed
from rpod_pose.navigation.filter.rotations import cross_matrix
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.dynamics import CommandTuning
from rpod_schemas.types import Command

ERRORS = 4
"""Number of states of the errors of thrust. Physics: one of its size and three of its direction."""
VALID_S = 1.0
"""Longest time for which a command holds, s. Physics: the ICD asks for a command each second, so that one
whose sender has stopped is not believed."""
_KEPT_S = 300.0
"""Time for which commands are kept. Numerics: memory; no track coasts for longer."""
_TURN_S = 0.1
"""Longest time for which one attitude of the chaser is used. Numerics: at 1 deg/s a thrust is 0.05 deg off,
a thirtieth of the error of its direction."""


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Parts of a step in each of which one command holds, one after the other."""

    begin_s: FloatArray
    """From the begin of the step, shape (N,)."""
    length_s: FloatArray
    """Shape (N,)."""
    commands: list[Command]


class CommandTrack:
    """Commands in the order of their stamps. A step uses no commands after its end."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._commands: list[Command] = []

    def covers(self, stamp_ns: int) -> bool:
        """Return whether all commands up to a stamp have arrived, if their period stays the same."""
        if len(self._stamps) < 2:
            return False
        return 2 * self._stamps[-1] - self._stamps[-2] > stamp_ns

    def is_known(self, stamp_ns: int) -> bool:
        """Return whether a command holds at a stamp."""
        place = bisect_right(self._stamps, stamp_ns)
        return place > 0 and stamp_ns < self._stamps[place - 1] + round(VALID_S * 1e9)

    def forget(self) -> None:
        """Forget all commands, for example after a clock was set back."""
        self._stamps.clear()
        self._commands.clear()

    def take(self, command: Command) -> bool:
        """Add a command and return True; if it is not newer than all before, ignore it and return False."""
        if self._stamps and command.stamp_ns <= self._stamps[-1]:
            return False
        self._stamps.append(command.stamp_ns)
        self._commands.append(command)
        if len(self._stamps) % 4096 == 0:
            old = bisect_left(self._stamps, command.stamp_ns - round(_KEPT_S * 1e9))
            del self._stamps[:old], self._commands[:old]
        return True

    def pieces(self, begin_ns: int, end_ns: int) -> _Pieces:
        """Return the parts of a step in which commands hold; there are none where none does."""
        first, last = max(bisect_right(self._stamps, begin_ns) - 1, 0), bisect_left(self._stamps, end_ns)
        begins, lengths, held = [], [], []
        for place in range(first, last):
            stamp_ns = self._stamps[place]
            after_ns = self._stamps[place + 1] if place + 1 < last else end_ns
            from_ns, to_ns = max(stamp_ns, begin_ns), min(after_ns, stamp_ns + round(VALID_S * 1e9), end_ns)
            if to_ns > from_ns:
                begins.append((from_ns - begin_ns) * 1e-9)
                lengths.append((to_ns - from_ns) * 1e-9)
                held.append(self._commands[place])
        return _Pieces(np.array(begins), np.array(lengths), held)

    def changes(self, begin_ns: int, end_ns: int) -> FloatArray:
        """Return ``ChaserStep.force_noise`` by a delay of 1 s of the changes in a step, its end included.

        A command that acts later changes the speed by its change times the delay: m2/s2, m2/s3 and m2/s4.
        """
        first, last = bisect_right(self._stamps, begin_ns), bisect_right(self._stamps, end_ns)
        found = np.zeros(3)
        for place in range(max(first, 1), last):
            one, other = self._commands[place - 1], self._commands[place]
            left_s = (end_ns - self._stamps[place]) * 1e-9
            square = ((other.acceleration_m_s2 - one.acceleration_m_s2) ** 2).sum()
            found += square * np.array([left_s**2, left_s, 1.0])
        return found


@dataclass(frozen=True, eq=False)
class Commanded:
    """A chaser (``Chaser``) that turns as another one, and is accelerated as it is commanded."""

    turning: Chaser
    """Its rotation: of a held attitude, or measured."""
    commands: CommandTrack
    tuning: CommandTuning

    def step(self, begin_ns: int, end_ns: int) -> ChaserStep:
        """Return the motion between two stamps, ns."""
        step, pieces = self.turning.step(begin_ns, end_ns), self.commands.pieces(begin_ns, end_ns)
        step_s = (end_ns - begin_ns) * 1e-9
        speed, way = np.zeros((3, 1 + ERRORS)), np.zeros((3, 1 + ERRORS))
        thrusts = [each for each in range(len(pieces.commands)) if self._is_thrust(pieces.commands[each])]
        turns = self._turns(begin_ns, end_ns) if thrusts else []
        for each in thrusts:
            length_s = pieces.length_s[each]
            middle_s = pieces.begin_s[each] + 0.5 * length_s
            place = min(int(middle_s / step_s * len(turns)), len(turns) - 1)
            added = turns[place].T @ self._columns(pieces.commands[each])
            speed += length_s * added
            way += length_s * (step_s - middle_s) * added
        tuning, held = self.tuning, pushed(pieces.begin_s, pieces.begin_s + pieces.length_s, step_s)
        noise = tuning.noise_m_s_sqrt_s**2 * held[:, thrusts].sum(axis=1)
        noise += tuning.delay_sigma_s**2 * self.commands.changes(begin_ns, end_ns)
        return step._replace(
            speed_m_s=speed[:, 0],
            way_m=way[:, 0],
            speed_by_bias=speed[:, 1:],
            way_by_bias=way[:, 1:],
            force_noise=noise,
            unforced=np.maximum(pushed(0.0, step_s, step_s) - held.sum(axis=1), 0.0),
        )

    def turn(self, begin_ns: int, end_ns: int) -> FloatArray:
        """Return the turn of a step alone, shape (3, 3)."""
        return self.turning.turn(begin_ns, end_ns)

    @staticmethod
    def _is_thrust(command: Command) -> bool:
        x, y, z = command.acceleration_m_s2.tolist()
        return bool(x * x + y * y + z * z > 0.0)  # 0 of one whose direction rounding leaves unknown, too

    def _turns(self, begin_ns: int, end_ns: int) -> list[FloatArray]:
        """Return the turns from the begin of a step to the middles of its equal parts, each (3, 3)."""
        parts = max(ceil((end_ns - begin_ns) * 1e-9 / _TURN_S), 1)
        length_ns = (end_ns - begin_ns) / parts
        stamps = (begin_ns + round((part + 0.5) * length_ns) for part in range(parts))
        return [self.turning.turn(begin_ns, stamp_ns) for stamp_ns in stamps]

    def _columns(self, command: Command) -> FloatArray:
        """Return an acceleration and its derivatives by the errors of thrust, chaser axes, shape (3, 5)."""
        size = float(np.linalg.norm(command.acceleration_m_s2))
        sigma = np.sqrt(command.variance) if command.variance else self.tuning.sigma * size
        along = command.acceleration_m_s2 / size
        return np.column_stack([command.acceleration_m_s2, sigma * along, -sigma * cross_matrix(along)])
