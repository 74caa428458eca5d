"""Methods for targets with joints: the methods for rigid targets, applied at estimated angles.

A first pose is searched with the target at some angles between the joints' limits. At each pose of the search
the angles are fitted (``angle_fit``), and then the pose with the target at these angles, until neither
changes. The result is the pose that explains the frame best. In tracking, the angles are expected near those
of the earlier frames. The model of the target is built again only when an angle has changed by
``RESOLUTION_RAD``.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import acos, ceil, degrees, log, radians, sqrt
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.belief import Angle, Belief, Rival
from rpod_pose.joints.angle_fit import SPREAD, Aligned, JointSolver, unknown
from rpod_pose.ports import Acquirer, Acquisition, Methods, Registration, Tracker
from rpod_pose.search.hypotheses import NEGLIGIBLE, with_one_noise
from rpod_pose.search.same_state import State, are_same
from rpod_pose.search.turns import Turns
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import rotation_matrix
from rpod_schemas.types import BeliefLevel
from rpod_target import Equivalence, Joint, Target, posed

STEP_RAD = radians(30.0)
"""Largest distance of the angles at which a first pose is searched. Hand: the fit of an angle converges from
half of it; the time of a search grows with the number of angles."""
RESOLUTION_RAD = radians(0.25)
"""Step to which angles are rounded before the model of the target is built. Numerics: an eighth of the aim of
2 deg."""
ROUNDS = 6
"""Largest number of alternate fits of angle and pose. Numerics: a budget; because of the extrapolation, few
suffice."""
REGISTERED = 8
"""Number of best poses, compared by their points alone, that are compared in the whole frame. Numerics: a
budget of registrations."""
COUNTER_TURNS_RAD = np.deg2rad([-12.0, -8.0, -4.0, 4.0, 8.0, 12.0])
"""Angles by which a joint is turned, and the rest of the target against it, to find a better fit. Hand: up to
nearly half of ``STEP_RAD``, which is the largest error of the first search."""
KEPT = 4
"""Number of trackers that are kept, each for its own angles. Numerics: memory; each has the models of a whole
target."""
SLOWEST = 0.8
"""Largest ratio of two successive steps from which further steps are extrapolated. Numerics: the sum of all
further steps is then at most four times the last one."""
POINTS = 2000
"""Largest number of a frame's points in the fit of an angle. Numerics: a budget of computation; their number
is well above the 400 that count as independent."""
CHANCE = 2.0
"""Largest difference of the shares of agreeing rays, in standard deviations, of two poses that explain a
frame equally well. Physics: one in 44 normal errors is larger to one side."""
DISTINCT_RAD = radians(10.0)
"""Least angle between two distinct poses. Hand: a third of ``STEP_RAD``."""

Angles = Mapping[str, Angle]


@dataclass(frozen=True, eq=False)
class RigidMethods:
    """Functions that create the methods for a rigid target."""

    methods: Callable[[Target], Methods]
    tracker: Callable[[Target], Tracker[Any]]
    points: Callable[[Any], FloatArray]
    """Function that returns the points of a frame, sensor axes, shape (N, 3)."""
    comparable: bool = False
    """Whether log likelihoods of targets at different angles may be compared."""


def jointed(target: Target, rigid: RigidMethods) -> Methods:
    """Return the methods for a target with joints."""
    shared = _Shared(target, rigid)
    return shared.expecting({joint.name: unknown(joint) for joint in target.joints})


class _Shared:
    """Data that the methods share, for any expected angles."""

    def __init__(self, target: Target, rigid: RigidMethods) -> None:
        self._points = rigid.points
        self.solver = JointSolver(target)
        self.alike = target.equivalence
        self._axes = {joint.name: joint.axis for joint in target.joints}
        turns = Turns.of(target)
        self.turns = [
            RigidTransform.from_rotation(Rotation.from_matrix(turn)) for turn in turns.all[: turns.declared]
        ]
        first, *others = target.joints
        self._first = first.name
        middle = {joint.name: unknown(joint).angle_rad for joint in others}
        angles = _spread(first)
        methods = [rigid.methods(posed(target, {**middle, first.name: angle_rad})) for angle_rad in angles]
        self._searches = [(angle_rad, each.acquirer) for angle_rad, each in zip(angles, methods, strict=True)]
        self._deskew = methods[0].deskew
        self._compares = rigid.comparable and methods[0].likelihoods is not None
        self._tracker_at = lru_cache(KEPT)(lambda key: rigid.tracker(posed(target, _unrounded(key))))
        self._methods_at = lru_cache(KEPT)(lambda key: rigid.methods(posed(target, _unrounded(key))))

    def expecting(self, angles: Angles) -> Methods:
        """Return the methods for expected angles."""
        tracker = _Tracker(self, angles)
        acquirer = _Acquirer(self, tracker, angles)
        likelihoods = self.log_likelihoods if self._compares else None
        return Methods(acquirer, tracker, self._deskew, likelihoods, expecting=self.expecting)

    def log_likelihoods(self, frame: Any, found: Sequence[Registration], /) -> FloatArray:
        """Return the log likelihoods of a frame at poses, each with the target at its own angles, (N,)."""
        alike = with_one_noise(found)
        each_at = [(self._methods_at(_rounded(each.angles)).likelihoods, each) for each in alike]
        return np.array([float(at(frame, [each])[0]) for at, each in each_at if at is not None])

    def at_one_noise(self, frame: Any, found: Sequence[Registration]) -> list[Registration]:
        """Return registrations with comparable log likelihoods, if those that count have other noise."""
        likely = [each for each in found if each.continues_track]
        if not self._compares or len({each.belief.larger_noise_m for each in likely}) < 2:
            return list(found)
        logs = iter(self.log_likelihoods(frame, likely).tolist())
        return [replace(each, log_likelihood=next(logs)) if each.continues_track else each for each in found]

    def are_same(self, one: Aligned | Registration | Rival, other: Aligned | Registration | Rival) -> bool:
        """Return whether two poses with their angles are the same, modulo the exact symmetries."""
        states = [
            State(rotation_matrix(each.T_sensor_target), each.angles)
            for each in (one, other)
            if each.T_sensor_target is not None
        ]
        return len(states) == 2 and are_same(
            *states, alike=self.alike, axes=self._axes, within_rad=DISTINCT_RAD
        )

    def distinct(self, found: Sequence[Aligned]) -> list[Aligned]:
        """Return poses with their angles, best first, without those that are the same as a better one."""
        kept: list[tuple[Aligned, Aligned]] = []
        for each in sorted(found, key=lambda one: one.loss_m2):
            exact = {name: replace(angle, sigma_rad=0.0) for name, angle in each.angles.items()}
            there = replace(each, angles=exact)
            if not any(self.are_same(there, other) for _, other in kept):
                kept.append((each, there))
        return [each for each, _ in kept]

    def searches(self, expected: Angles) -> list[Acquirer[Any]]:
        """Return the searches at the angles that the first joint may have."""
        first = expected[self._first]
        reach_rad = SPREAD * first.sigma_rad + 0.5 * STEP_RAD
        return [
            acquirer
            for angle_rad, acquirer in self._searches
            if abs(angle_rad - first.angle_rad) <= reach_rad
        ]

    def tracker_at(self, angles: Angles) -> Tracker[Any]:
        """Return the tracker of the target at rounded angles."""
        return self._tracker_at(_rounded(angles))

    def acquirer_at(self, angles: Angles) -> Acquirer[Any]:
        """Return the search of the target at rounded angles."""
        return self._methods_at(_rounded(angles)).acquirer

    def points_of(self, frame: Any) -> FloatArray:
        """Return points of a frame, sensor axes, shape (N, 3), m."""
        points_m = self._points(frame)
        return np.ascontiguousarray(points_m[:: max(1, ceil(len(points_m) / POINTS))], np.float64)


class _Tracker:
    """Fits angles and pose alternately, starting from the expected angles."""

    def __init__(self, shared: _Shared, expected: Angles) -> None:
        self._shared, self._expected = shared, expected

    def track(self, measurement: Any, T_sensor_target: RigidTransform) -> Registration:
        angles = self.angles(measurement, T_sensor_target)
        points_m = self._shared.points_of(measurement)
        if len(points_m) == 0:
            return self._shared.tracker_at(angles).track(measurement, T_sensor_target)
        aligned = self._shared.solver.aligned(points_m, T_sensor_target, angles)
        return self.registered(measurement, aligned.T_sensor_target, aligned.angles)

    def registered(self, measurement: Any, pose: RigidTransform, angles: Angles) -> Registration:
        """Return the registration from a pose and angles that are close to the solution."""
        found, last = self._shared.tracker_at(angles).track(measurement, pose), dict[str, float]()
        for _ in range(ROUNDS):
            if found.T_sensor_target is None:
                break
            before, angles = angles, self.angles(measurement, found.T_sensor_target)
            if not _are_apart(angles, before):
                break
            steps = {name: angle.angle_rad - before[name].angle_rad for name, angle in angles.items()}
            angles = {
                name: replace(
                    angle, angle_rad=before[name].angle_rad + _extrapolated(steps[name], last.get(name))
                )
                for name, angle in angles.items()
            }
            last = steps
            found = self._shared.tracker_at(angles).track(measurement, found.T_sensor_target)
        return self.with_angles(measurement, found)

    def angles(self, measurement: Any, pose: RigidTransform) -> dict[str, Angle]:
        """Return the angles that a frame shows at a pose."""
        return self._shared.solver.angles(self._shared.points_of(measurement), pose, self._expected)

    def with_angles(self, measurement: Any, found: Registration) -> Registration:
        """Return a registration with the angles that the frame shows at its pose."""
        if found.T_sensor_target is None:
            return replace(found, angles=self._expected)
        angles = self.angles(measurement, found.T_sensor_target)
        covariance, angles = self._shared.solver.considered(
            self._shared.points_of(measurement), found.T_sensor_target, found.covariance, angles
        )
        parts = found.parts
        if parts is not None:  # like an error of the model, it lasts as long as the same parts are seen
            by_angles = covariance - found.covariance
            parts = replace(parts, of_model=parts.of_model + by_angles)
        return replace(found, covariance=covariance, parts=parts, angles=angles)


class _Acquirer:
    """Searches with the target at some angles, then with the target at the angles of the best pose."""

    def __init__(self, shared: _Shared, tracker: _Tracker, expected: Angles) -> None:
        self._shared, self._tracker, self._expected = shared, tracker, expected

    def acquire(self, measurement: Any) -> Acquisition:
        return self._found(measurement, lambda acquirer: acquirer.acquire(measurement))

    def near(self, measurement: Any, T_sensor_target: RigidTransform) -> Acquisition:
        return self._found(measurement, lambda acquirer: acquirer.near(measurement, T_sensor_target))

    def _found(self, measurement: Any, search: Callable[[Acquirer[Any]], Acquisition]) -> Acquisition:
        searched = [search(each) for each in self._shared.searches(self._expected)]
        poses = [each.pose for each in searched if each.pose is not None]
        found = [
            self._tracker.registered(measurement, each.T_sensor_target, each.angles)
            for each in self._aligned(measurement, poses)[:REGISTERED]
        ]
        found = [each for each in found if each.T_sensor_target is not None]
        found = sorted(self._shared.at_one_noise(measurement, found), key=_order)
        if not found:
            return searched[0]
        best = search(self._shared.acquirer_at(found[0].angles))
        registration = self._tracker.with_angles(measurement, best.registration)
        if best.pose is not None and _are_apart(registration.angles, found[0].angles):
            again = self._tracker.registered(measurement, best.pose, registration.angles)
            registration = again if again.continues_track else registration
        belief = self._with_rivals(measurement, registration, best.belief, found)
        templates = best.templates + sum(each.templates for each in searched)
        return replace(best, registration=replace(registration, belief=belief), templates=templates)

    def _with_rivals(
        self, measurement: Any, best: Registration, belief: Belief, found: Sequence[Registration]
    ) -> Belief:
        """Return the belief in a pose with its rivals, each at the angles that the frame shows at its pose.

        Args:
            measurement: the frame.
            best: the pose, with its angles.
            belief: belief in it among the poses at the same angles.
            found: registrations, best first, each at angles of its own.
        """
        if best.T_sensor_target is None or not belief.continues_track:
            return belief
        pose = best.T_sensor_target
        best, *found = self._shared.at_one_noise(measurement, [best, *found])
        same = [self._shared.are_same(best, other) for other in found]
        compared = found[same.index(True)] if any(same) else best
        rivals = []
        for other, is_best in zip(found, same, strict=True):
            there = other.T_sensor_target
            if is_best or there is None or not other.continues_track or not _explains_alike(compared, other):
                continue
            turn_deg = degrees(_turn_rad(pose, there, self._shared.alike))
            less = float(np.nan_to_num(other.log_likelihood - compared.log_likelihood))
            name = f"turned by {turn_deg:.0f} deg, at other angles of the joints"
            rivals.append(Rival(name, there, less, other.angles))
        at_angles = [
            replace(each, angles=self._tracker.angles(measurement, each.T_sensor_target))
            for each in belief.rivals
        ]
        own = [each for each in at_angles if not any(self._shared.are_same(each, other) for other in rivals)]
        if not rivals:
            return replace(belief, rivals=tuple(own))
        reason = f"{len(rivals) + 1} poses explain the measurement: the next is {rivals[0].name}"
        return replace(belief, level=BeliefLevel.DOUBTFUL, reason=reason, rivals=(*own, *rivals))

    def _aligned(self, measurement: Any, poses: Sequence[RigidTransform]) -> list[Aligned]:
        """Return distinct poses with their angles, best first, from poses and their near-symmetries."""
        shared, found = self._shared, list[Aligned]()
        points_m = shared.points_of(measurement)
        for pose in poses:
            for turn in (RigidTransform.identity(), *shared.turns):
                start = pose * turn
                angles = shared.solver.angles(points_m, start, self._expected)
                found.append(shared.solver.aligned(points_m, start, angles))
        best = shared.distinct(found)[:REGISTERED]
        return shared.distinct([self._least(points_m, each) for each in best])

    def _least(self, points_m: FloatArray, found: Aligned) -> Aligned:
        """Return the best of several poses at which a joint's parts keep their place and the rest turns.

        If these parts are most of the visible target, a fit may end at a wrong minimum in this direction.
        """
        tried = [found]
        for joint in self._shared.solver.joints:
            for turn_rad in COUNTER_TURNS_RAD:
                angle = found.angles[joint.name]
                there = replace(
                    angle, angle_rad=float(np.clip(angle.angle_rad + turn_rad, *joint.limits_rad))
                )
                pose = found.T_sensor_target * joint.turned(angle.angle_rad - there.angle_rad)
                angles = {**found.angles, joint.name: there}
                tried.append(self._shared.solver.aligned(points_m, pose, angles))
        return min(tried, key=lambda one: one.loss_m2)


def _extrapolated(step_rad: float, last_rad: float | None) -> float:
    """Return the sum of all further steps, if each is smaller than the previous one by the same ratio.

    Source: A. C. Aitken, On Bernoulli's Numerical Solution of Algebraic Equations, Proc. Royal Society of
    Edinburgh 46, 1926.
    """
    ratio = 0.0 if not last_rad else min(max(step_rad / last_rad, 0.0), SLOWEST)
    return step_rad / (1.0 - ratio)


def _are_apart(angles: Angles, others: Angles) -> bool:
    """Return whether two sets of angles differ by more than their rounding."""
    return any(
        abs(angle.angle_rad - others[name].angle_rad) > RESOLUTION_RAD for name, angle in angles.items()
    )


def _order(found: Registration) -> tuple[bool, float, float]:
    return not found.continues_track, -np.nan_to_num(found.log_likelihood), -found.explained_share


def _turn_rad(one: RigidTransform, other: RigidTransform, alike: Equivalence) -> float:
    """Return the angle between the attitudes of two poses, modulo the target's symmetries."""
    cosine = float(alike.cosines(rotation_matrix(one)[None], rotation_matrix(other)[None])[0, 0])
    return acos(min(max(cosine, -1.0), 1.0))


def _explains_alike(best: Registration, other: Registration) -> bool:
    """Return whether another pose explains a frame equally well, by likelihood or share of agreeing rays."""
    if np.isfinite(best.log_likelihood):
        return other.log_likelihood > best.log_likelihood + log(NEGLIGIBLE)
    share = best.explained_share
    chance = sqrt(max(share * (1.0 - share), 0.0) / max(best.inliers, 1))
    return other.explained_share > share - CHANCE * chance


def _rounded(angles: Angles) -> tuple[tuple[str, int], ...]:
    return tuple((name, round(angle.angle_rad / RESOLUTION_RAD)) for name, angle in angles.items())


def _unrounded(key: tuple[tuple[str, int], ...]) -> dict[str, float]:
    return {name: RESOLUTION_RAD * step for name, step in key}


def _spread(joint: Joint) -> FloatArray:
    """Return the middles of equal parts of a joint's limits, at most ``STEP_RAD`` apart."""
    least, greatest = joint.limits_rad
    count = ceil((greatest - least) / STEP_RAD)
    return least + (np.arange(count) + 0.5) * (greatest - least) / count
