"""Evidence in a sensor's own frames that the target's model, its size or a part of the data is wrong.

A method that supports it adds a ``Misfit``, poses for other sizes (``OtherSize``) and a ``PartSolution`` to a
registration (``rpod_pose.ports``). The sums of the misfits over a minute test whether the target's model and
the pose are right. The log odds of the other sizes test the size. The position by a part of the data is a
solution like those without one sensor: the protection level includes it, and a test compares it with the
estimate.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import exp, hypot, inf, isfinite, pi, sqrt
from types import MappingProxyType
from typing import NamedTuple, TypeVar

import numpy as np

from rpod_pose.navigation.filter import POSE, POSITION, FilterState
from rpod_pose.navigation.integrity.levels import Solution
from rpod_pose.navigation.integrity.residuals import Statistic
from rpod_pose.ports import Registration
from rpod_pose.pose_evidence import Misfit, OtherSize, PartSolution
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import rotation_matrix

WRONG_MODEL = "; the target's model or the pose is wrong: check the target, and its tolerance_m"
OTHER_SIZE = "; check the size of the target's model, and its scale_tolerance"
WRONG_SIZE = (
    "; size of the target, focal length or calibration is wrong: check scale_tolerance and calibration"
)

SPREAD = 0.03
"""Largest error of a wrong part of the data, over the range. Hand: models of satellites are right within 1 to
3 % of their size (as ``slack_share`` of the scan's model)."""

UNLIKELY = 0.02
"""Least probability of another size that counts in the levels, over the risk. Numerics: two smaller ones add
less than a twentieth."""
UNRESOLVED = 2.0 / 3.0
"""Largest deviation of a size that the frames cannot exclude, over that of the tested other size. A
likelihood prefers the nearer of two sizes, apart from a shift that right models show too. Hand: the shift was
measured as 0.4 to 0.8 % of the size (mock-up, ENVISAT), where the other size is 3 % off."""
_NOTHING = 1e-9
"""Share of an error that counts as none. Numerics: nothing is divided by zero."""
MOST_LOG_ODDS = 50.0
"""Largest log odds in an exponential; larger ones are clipped. Numerics: the result stays finite."""


class PartHypothesis(NamedTuple):
    """The hypothesis that a part of the data is right, and that all data together are wrong."""

    solution: Solution
    agreeing: Solution
    """The solution as it would be if it agreed with the estimate."""


@dataclass(frozen=True, eq=False)
class FrameEvidence:
    """Misfits, other sizes and part solutions of the accepted frames of the last minute, by sensor."""

    misfits: Mapping[str, tuple[tuple[int, Misfit], ...]] = field(default_factory=dict)
    """Stamps, ns, and misfits of the frames."""
    sizes: Mapping[str, tuple[tuple[int, tuple[OtherSize, ...]], ...]] = field(default_factory=dict)
    """Stamps, ns, of the frames, and their poses for other sizes of the target."""
    parts: Mapping[str, tuple[int, PartSolution]] = field(default_factory=dict)
    """Stamp, ns, and part solution of the newest frame that has one."""
    followed: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    """Stamp, ns, of the newest frame, and the share of an error of its ranges that its pose has."""

    def ranges_followed(
        self, estimate: FilterState, without: Mapping[str, FilterState], place_m: FloatArray
    ) -> float:
        """Return the share of an error of the ranges that an estimate has.

        Of several sensors, each counts by its weight along the line of sight: the part by which the variance
        without it is larger. What the weights leave open counts as the sensor with the largest share.

        Args:
            estimate: the estimate.
            without: the estimates without one of several sensors, at the same stamp, by that sensor's name.
            place_m: position of the target relative to the sensor, chaser axes, shape (3,).
        """
        most = max((share for _, share in self.followed.values()), default=1.0)
        own_m2 = _along(estimate, place_m)
        weights = {name: max(1.0 - own_m2 / _along(other, place_m), 0.0) for name, other in without.items()}
        known = {name: weight for name, weight in weights.items() if name in self.followed}
        total = max(sum(known.values()), 1.0)
        return sum(
            (weight / total * self.followed[name][1] for name, weight in known.items()),
            (1.0 - sum(known.values()) / total) * most,
        )

    def after(
        self, sensor: str, stamp_ns: int, found: Registration | None, memory_s: float
    ) -> "FrameEvidence":
        """Return the evidence with an accepted frame, and without frames older than ``memory_s``.

        An error of the model lasts, so that all frames of this time are tested together.
        """
        oldest_ns = stamp_ns - round(memory_s * 1e9)
        misfits, sizes = _since(self.misfits, oldest_ns), _since(self.sizes, oldest_ns)
        parts = {name: part for name, part in self.parts.items() if part[0] >= oldest_ns}
        if found is not None and found.misfit is not None:
            misfits[sensor] = (*misfits.get(sensor, ()), (stamp_ns, found.misfit))
        if found is not None and (other_sizes := found.other_sizes()):
            sizes[sensor] = (*sizes.get(sensor, ()), (stamp_ns, other_sizes))
        if found is not None and found.by_part is not None:
            parts[sensor] = (stamp_ns, found.by_part)
        followed = {name: each for name, each in self.followed.items() if each[0] >= oldest_ns}
        followed[sensor] = (stamp_ns, share_followed(found))
        return FrameEvidence(misfits, sizes, parts, followed)

    def newest_sizes(self, sensor: str) -> tuple[OtherSize, ...]:
        """Return the poses for other sizes of the newest frame of a sensor that has some."""
        return self.sizes[sensor][-1][1] if sensor in self.sizes else ()

    def tests(self, range_m: float, range_share: float, correlated_s: float = 0.0) -> list[Statistic]:
        """Return the tests of all sensors.

        If the model is right, a likelihood ratio reaches r with at most the probability 1 / r (J. Ville,
        1939). So 2 log r has at most the tail of chi-squared with two degrees of freedom.

        Args:
            range_m: distance of the target.
            range_share: standard deviation of a slow drift of the ranges, over the range.
            correlated_s: time within which the log odds of two frames count as one.
        """
        tests = []
        for name, frames in self.sizes.items():
            for size, log_odds in _log_odds(frames, correlated_s):
                if not size.tests:
                    continue
                text = f"{name}: {_of_size(1.0 + size.share)} explains the frames better"
                tests.append(Statistic(text, 2.0 * max(log_odds, 0.0), 2, OTHER_SIZE))
        for name, misfits in self.misfits.items():
            value = sum(misfit.value for _, misfit in misfits)
            variance = sum(misfit.variance for _, misfit in misfits)
            squared = max(value, 0.0) ** 2 / variance if variance > 0.0 else 0.0
            text = f"{name}: residuals of neighbours are correlated"
            tests.append(Statistic(text, squared, 1, WRONG_MODEL))
        for name, (_, part) in self.parts.items():
            variance = part.apart_m**2 + (part.follows * range_share * range_m) ** 2
            length_m = float(np.linalg.norm(part.offset_m))
            text = f"{name}: position {1e3 * length_m:.0f} mm from that by {part.name}"
            tests.append(Statistic(text, length_m**2 / variance, 1, WRONG_SIZE))
        return tests

    def solutions(
        self, estimate: FilterState, place_m: FloatArray, share: float, range_share: float
    ) -> list[PartHypothesis]:
        """Return the solutions by parts of the data, along the line of sight to the target.

        A right part and a right estimate are off by their own errors only. A wrong one is off by any length
        up to ``SPREAD`` times the range. If they agree, a wrong one is improbable by Bayes's rule, because
        they would agree only by chance; the further apart they are, the more probable it is. The part's
        error along the line of sight is its own, not the estimate's.

        Args:
            estimate: the estimate.
            place_m: position of the target relative to the sensor, chaser axes, shape (3,).
            share: prior probability that a part is wrong.
            range_share: standard deviation of a slow drift of the ranges, over the range.
        """
        range_m = max(float(np.linalg.norm(place_m)), 1e-6)
        drift_m = range_share * range_m
        along = place_m / range_m
        across = np.eye(6)
        across[POSITION, POSITION] -= np.outer(along, along)
        found = []
        for name, (_, part) in self.parts.items():
            length_m = float(np.linalg.norm(part.offset_m))
            sigma_m = hypot(part.apart_m, part.follows * drift_m)
            spread_m = max(part.follows, _NOTHING) * SPREAD * range_m
            by_chance = min(sqrt(0.5 * pi) * sigma_m / spread_m, 1.0)
            likelihood = exp(min(0.5 * (length_m / sigma_m) ** 2, MOST_LOG_ODDS))
            covariance: FloatArray = across @ estimate.covariance[POSE, POSE] @ across
            own_m2 = part.sigma_m**2 + drift_m**2
            covariance[POSITION, POSITION] += own_m2 * np.outer(along, along) if isfinite(own_m2) else inf
            agreeing = Solution(f"{name}: {part.name}", np.zeros(6), covariance, share * by_chance)
            separation = np.concatenate([length_m * along, np.zeros(3)])
            probability = min(share * by_chance * likelihood, 1.0)
            solution = replace(agreeing, separation=separation, probability=probability)
            found.append(PartHypothesis(solution, agreeing))
        return found

    def size_solutions(
        self,
        estimate: FilterState,
        risk: float,
        share: float,
        correlated_s: float,
        shifts: Mapping[float, FloatArray] = MappingProxyType({}),
    ) -> tuple[list[Solution], list[Solution]]:
        """Return the solutions for the tested other sizes of the target, and those for sizes between.

        By Bayes's rule, the probability of another size is its prior times the odds of the frames. A size
        that the frames have excluded is left out. A size near the model's own keeps the prior at least, since
        no frame excludes it. One between the two is at most as probable as the near one, since a likelihood
        falls from its maximum on; without a near one it keeps the prior.
        The separation is the shift of the estimate, where a filter tells it (``sizes``), else that of the
        newest frame: an error of the model lasts as long as a view does.

        Args:
            estimate: the estimate.
            risk: risk of the levels.
            share: prior probability that the size is wrong, larger or smaller.
            correlated_s: time within which two frames count as one.
            shifts: shifts of the estimate, chaser axes, by the enlargement, shape (6,) each.
        """
        turn = np.kron(np.eye(2), rotation_matrix(estimate.T_chaser_target))
        covariance = estimate.covariance[POSE, POSE]
        others, between = [], []
        for name, frames in self.sizes.items():
            sizes = _log_odds(frames, correlated_s)
            near = {size.share > 0.0: log_odds for size, log_odds in sizes if not size.tests}
            for size, log_odds in sizes:
                step = shifts[size.share] if size.share in shifts else turn @ size.step
                probability = min(0.5 * share * exp(min(log_odds, MOST_LOG_ODDS)), 1.0)
                text = f"{name}: {_of_size(1.0 + size.share)}"
                if probability > (UNLIKELY * risk if size.tests else 0.5 * share):
                    others.append(Solution(text, step, covariance, probability))
                if not size.tests:
                    between.append(Solution(text, step, covariance, 0.5 * share))
                    continue
                probability = 0.5 * share * exp(min(near.get(size.share > 0.0, 0.0), 0.0))
                text = f"{name}: {_of_size(1.0 + UNRESOLVED * size.share)}"
                if probability > UNLIKELY * risk:
                    between.append(Solution(text, UNRESOLVED * step, covariance, probability))
        return others, between


def _along(state: FilterState, place_m: FloatArray) -> float:
    """Return the variance of a state's position along a line of sight, times that line's squared length."""
    return float(place_m @ state.covariance[POSITION, POSITION] @ place_m)


def share_followed(found: Registration | None) -> float:
    """Return the share of an error of the ranges that a registered pose has."""
    return 1.0 if found is None or found.by_part is None else 1.0 - found.by_part.follows


def _of_size(factor: float) -> str:
    return f"a target of {factor:.0%} of the model's size"


_Entry = TypeVar("_Entry")


def _since(
    entries: Mapping[str, tuple[tuple[int, _Entry], ...]], oldest_ns: int
) -> dict[str, tuple[tuple[int, _Entry], ...]]:
    """Return the entries from a stamp on, without sensors that have none."""
    kept = {name: tuple(each for each in mine if each[0] >= oldest_ns) for name, mine in entries.items()}
    return {name: mine for name, mine in kept.items() if mine}


def _log_odds(
    frames: Sequence[tuple[int, tuple[OtherSize, ...]]], correlated_s: float
) -> list[tuple[OtherSize, float]]:
    """Return each size with the step of the newest frame, and its log odds by all frames.

    Frames within ``correlated_s`` count as one, since their errors are alike: n frames over m such times
    count m / n each.
    """
    span_s = (frames[-1][0] - frames[0][0]) * 1e-9
    weight = min(1.0, (1.0 + (span_s / correlated_s if correlated_s else inf)) / len(frames))
    logs = defaultdict[float, list[float]](list)
    for _, sizes in frames:
        for each in sizes:
            logs[each.share].append(each.log_odds)
    return [(size, min(weight * sum(logs[size.share]), size.most_log_odds)) for size in frames[-1][1]]
