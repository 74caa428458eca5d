"""What a sensor's frames tell of errors inside them: residuals of the model, and parts of the data.

A method that can tell gives each registration a ``Misfit`` and a ``PartSolution`` (``rpod_pose.ports``). The
sums of the misfits over a minute test whether the target's model and the pose are right. The position by a
part of the data is a solution as those without a sensor are: the level contains it, and a test compares it
with the estimate.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import exp, hypot

import numpy as np

from rpod_pose.navigation.filter import POSE, POSITION, FilterState
from rpod_pose.navigation.integrity.levels import Solution
from rpod_pose.navigation.integrity.residuals import Statistic
from rpod_pose.ports import Misfit, PartSolution, Registration

WRONG_MODEL = "; the target's model or the pose is wrong: check the target, and its tolerance_m"
WRONG_SIZE = (
    "; size of the target, focal length or calibration is wrong: check scale_tolerance and calibration"
)

SPREAD = 0.03
"""Length over the range by which a wrong part is off: models of satellites are right within 1 to 3 % of their
size (as ``slack_share`` of the scan's model)."""


@dataclass(frozen=True, eq=False)
class Inside:
    """What was told by the frames of the last minute, by the sensor's name."""

    misfits: Mapping[str, tuple[tuple[int, Misfit], ...]] = field(default_factory=dict)
    """Stamps and misfits of the frames."""
    parts: Mapping[str, tuple[int, PartSolution]] = field(default_factory=dict)
    """Stamp and solution by a part of the newest frame that has one."""

    def after(self, sensor: str, stamp_ns: int, found: Registration | None, memory_s: float) -> "Inside":
        """Return this with a frame whose pose was accepted, and without those that are older than a memory.

        An error of the model lasts, so that frames of a minute count together.
        """
        oldest_ns = stamp_ns - round(memory_s * 1e9)
        misfits = {
            name: tuple(each for each in told if each[0] >= oldest_ns) for name, told in self.misfits.items()
        }
        parts = {name: part for name, part in self.parts.items() if part[0] >= oldest_ns}
        if found is not None and found.misfit is not None:
            misfits[sensor] = (*misfits.get(sensor, ()), (stamp_ns, found.misfit))
        if found is not None and found.by_part is not None:
            parts[sensor] = (stamp_ns, found.by_part)
        return Inside({name: told for name, told in misfits.items() if told}, parts)

    def tests(self, range_m: float, range_share: float) -> list[Statistic]:
        """Return the tests of all sensors.

        Args:
            range_m: distance of the target.
            range_share: standard deviation of a slow drift of the ranges, over the range.
        """
        tests = []
        for name, told in self.misfits.items():
            value = sum(misfit.value for _, misfit in told)
            variance = sum(misfit.variance for _, misfit in told)
            size = max(value, 0.0) ** 2 / variance if variance > 0.0 else 0.0
            tests.append(Statistic(f"{name}: residuals of neighbours are alike", size, 1, WRONG_MODEL))
        for name, (_, part) in self.parts.items():
            variance = part.sigma_m**2 + (range_share * range_m) ** 2
            length_m = float(np.linalg.norm(part.offset_m))
            text = f"{name}: position {1e3 * length_m:.0f} mm off that by {part.name}"
            tests.append(Statistic(text, length_m**2 / variance, 1, WRONG_SIZE))
        return tests

    def solutions(self, estimate: FilterState, share: float, range_share: float) -> list[Solution]:
        """Return the solutions by parts of the data, along the line of sight to the target.

        A part that is wrong, of which ``share`` is the prior probability, is off by any length up to
        ``SPREAD`` of the range; a right one by its own error. Where both agree, a wrong part is improbable by
        Bayes's rule, as it would agree by chance.
        """
        place_m = estimate.T_chaser_target.translation
        range_m = max(float(np.linalg.norm(place_m)), 1e-6)
        along = place_m / range_m
        solutions = []
        for name, (_, part) in self.parts.items():
            length_m = float(np.linalg.norm(part.offset_m))
            sigma_m = hypot(part.sigma_m, range_share * range_m)
            odds = sigma_m / max(SPREAD * range_m, sigma_m) * exp(min(0.5 * (length_m / sigma_m) ** 2, 50.0))
            covariance = estimate.covariance[POSE, POSE].copy()
            covariance[POSITION, POSITION] += part.sigma_m**2 * np.outer(along, along)
            separation = np.concatenate([length_m * along, np.zeros(3)])
            text = f"{name}: {part.name}"
            solutions.append(Solution(text, separation, covariance, min(share * odds, 1.0)))
        return solutions
