"""The search in one scan: from thousands of attitudes to a few poses, ranked by likelihood."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rpod_pose.belief import Belief
from rpod_pose.lidar.posterior.sampled_posterior import SampledPosterior
from rpod_pose.lidar.returns.distances import ReturnDistances
from rpod_pose.lidar.scan_alignment import FaceProblem, ScanErrors
from rpod_pose.lidar.scan_fit import ScanFit, ScanModel
from rpod_pose.lidar.scan_registration import (
    CHANCE,
    RESUMED,
    Reach,
    aligned,
    neighbourhood,
    outline_mean,
    reach_of,
)
from rpod_pose.lidar.scan_view import ScanView, SeenScan
from rpod_pose.ports import Registration
from rpod_pose.registration.field_alignment import Points, field_aligned
from rpod_pose.registration.lie_group import PoseArrays, step_between, stepped
from rpod_pose.registration.surface_model import SurfaceModel
from rpod_pose.search.comparison import Comparison
from rpod_pose.search.turns import Turns, matrices
from rpod_pose.search.view_model import ViewModel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar.search import GlobalSearchConfig, SearchLevelConfig
from rpod_schemas.poses import pose_of
from rpod_schemas.types import Float32Array

FIELD_SIGMAS = 6.0
"""Least Geman-McClure scale of the steps in the distance field, in standard deviations of a range. Hand:
narrower steps to the faces follow."""
FACE_SIGMAS = np.array([20.0, 12.0, 8.0])
"""Geman-McClure scales of a candidate's steps to the faces, in standard deviations of a range. Numerics: the
wide scales converge from farther, the narrow ones are more accurate."""
FINE_SIGMAS = np.array([8.0, 4.0, 4.0])
"""Geman-McClure scales of the last steps, for the best candidates, in standard deviations of a range.
Numerics: they continue ``FACE_SIGMAS`` down to four standard deviations."""
HALFWAY = 4.0
"""Largest deficit per return of a pose that a refinement on the outline may still correct. Hand: a larger
value refines more wrong poses, a smaller one may miss a right one."""
UNSETTLED = 0.1
"""Largest share of its log likelihood that a pose may lack because its alignment stopped before the optimum.
Hand: a larger value samples near more poses, a smaller one may miss a rival."""
ABSORBED = 22.5
"""Largest squared distance, in standard deviations, of a pose that belongs to the posterior of another one.
Physics: the chi-square distribution with six degrees of freedom exceeds it once in 1,000."""
FURTHER = 2
"""Number of turns of the main faces that are aligned with a scan of many returns. Numerics: a budget."""
OF_NOTHING_RAD = np.deg2rad(104.0)
"""Standard deviation of an unknown angle. Physics: 360 deg over sqrt(12)."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose of the target relative to the sensor, with its fit to the scan."""

    R: FloatArray
    """R_sensor_target, shape (3, 3)."""
    t: FloatArray
    """Position of the target's origin, sensor axes, shape (3,), m."""
    fit: ScanFit
    information: FloatArray
    """Information matrix of (dtau, dtheta) as in ``normal_equations``, shape (6, 6)."""
    sampled_mass: float | None = None
    """Logarithm of the integral of the likelihood near the pose, from samples; None if it was not sampled."""

    def log_mass(self, radius_m: float) -> float:
        """Return the logarithm of the integral of the likelihood near the pose: its posterior mass.

        Without samples it is the log likelihood plus the logarithm of the volume of the uncertainty
        (Laplace's method). So if two poses explain a scan equally well, the more uncertain one is more
        probable.

        Args:
            radius_m: distance of the target's farthest point from its origin.
        """
        if self.sampled_mass is not None:
            return self.sampled_mass
        loosest: FloatArray = np.repeat((radius_m, OF_NOTHING_RAD), 3)
        information = self.information + np.diag(loosest**-2)
        return self.fit.log_likelihood - 0.5 * float(np.linalg.slogdet(information / (2.0 * np.pi))[1])


@dataclass(frozen=True, eq=False)
class Scanner:
    """The rays of every ``stride``-th row and column of a pattern, with the statistics of their scans."""

    view: ScanView
    distances: ReturnDistances
    statistics: ScanModel
    reach: Reach

    @classmethod
    def of(
        cls,
        view: ScanView,
        config: GlobalSearchConfig,
        surface: SurfaceModel,
        *,
        sigma_range_m: float,
        radius_m: float,
    ) -> Self:
        """Return the scanner of a view; the sigma of a range is 0 if the sensor does not state it."""
        model, acceptance = config.tracking.tuning.model, config.tracking.tuning.acceptance
        statistics = ScanModel(model, acceptance, view, surface, sigma_range_m=sigma_range_m)
        reach = reach_of(view, config.tracking, radius_m)
        return cls(view, ReturnDistances.of(view), statistics, reach)


@dataclass(frozen=True, eq=False)
class Model:
    """The target in the three forms that the search needs."""

    views: ViewModel
    surface: SurfaceModel
    turns: Turns


class ScanSearch:
    """Searches one scan; ``truncation_m`` is the distance at which the energy of a point is truncated."""

    def __init__(
        self,
        config: GlobalSearchConfig,
        model: Model,
        scanner: Scanner,
        seen: SeenScan,
        truncation_m: float,
    ) -> None:
        self._config, self._tuning = config, config.tuning
        self._model, self.scanner, self.seen = model, scanner, seen
        self._comparison = Comparison(
            model.views,
            seen,
            scanner.distances.image(seen),
            scanner.statistics.expected_shares,
            truncation_m,
            truncated=seen.cut_off,
        )
        strip_m = scanner.reach.spacing_rad * float(np.linalg.norm(self._comparison.centroid_m))
        self._is_fine = strip_m < scanner.statistics.sigma_range_m  # the outline is more accurate than ranges
        self._few = Points.equal(seen.downsampled(self._tuning.coarse_points))
        sigma_m = scanner.statistics.sigma_range_m
        least_m = FIELD_SIGMAS * sigma_m
        widest_m = max(config.tracking.tuning.widest_share * scanner.reach.radius_m, least_m)
        self._far_m = np.geomspace(widest_m, least_m, self._tuning.coarse_steps)
        self._rough_m, self._fine_m = FACE_SIGMAS * sigma_m, FINE_SIGMAS * sigma_m
        self.few = self._is_fine or self.informative < self._tuning.sufficient_returns
        """Whether several poses near the best one may be as likely, because the returns are few, give little
        information, or the best pose was not at an optimum after its alignment."""

    @property
    def informative(self) -> float:
        """Number of informative returns, as ``ScanModel.informative`` defines it."""
        return self.scanner.statistics.informative(self.seen)

    def search(self, attitudes: Float32Array, level: SearchLevelConfig) -> list[Pose]:
        """Return distinct poses, likeliest first; empty if the target is in view at no attitude.

        Args:
            attitudes: initial R_sensor_target, shape (M, 3, 3).
            level: numbers of attitudes that are compared and refined.
        """
        found: list[Pose] = []
        candidates = self._comparison.candidates(attitudes, compared=level.compared, refined=level.refined)
        for candidate in candidates:
            found.append(self._field_aligned(*candidate))
            if self._is_sure(found[-1]):
                return self.completed(found, siblings=1)
        return self.completed(found, siblings=self._tuning.siblings)

    def completed(self, found: list[Pose], *, siblings: int) -> list[Pose]:
        """Return distinct poses, likeliest first: the given ones, and those with which they may be confused.

        The near-symmetries of the best ``siblings`` poses are all tried.
        """
        tuning, turned = self._tuning, list[Pose]()
        found = list(found)
        for _ in range(tuning.turned):
            best = self.distinct(found)[:siblings]
            chosen = next((pose for pose in best if not self._is_turned(pose, turned)), None)
            if chosen is None:
                break
            chosen = self._finished(chosen)
            turned.append(chosen)
            found += [chosen, *self._turned(chosen, tuning.turns)]
        best = self.distinct(found)[: tuning.few_finished if self.few else tuning.finished]
        finished = self.distinct([self._improved(pose, self._fine_m) for pose in best])
        if self.few:
            return self.closed(finished)
        return self._outlined(finished) if len(self._likely(finished)) > 1 else finished

    def closed(self, ranked: list[Pose]) -> list[Pose]:
        """Return the poses and all turns of the best one, likeliest first, with masses from samples.

        This is for few returns, and for an alignment that stopped before an optimum.
        """
        self.few = True
        if not ranked:
            return []
        first, *others = self._outlined(ranked)
        best = self._polished(first)
        gain = max(best.fit.log_likelihood - first.fit.log_likelihood, 0.0)
        every = [best, *others]
        for _ in range(self._tuning.few_closures):
            every = self.distinct([*every, *self._turned(best, self._tuning.few_turns)])
            likely = self._likely(every, gain)
            every = self.distinct([*map(self._polished, likely), *every[len(likely) :]])
            if every[0] is best:
                break
            best = every[0]
        return every

    def _outlined(self, ranked: list[Pose]) -> list[Pose]:
        """Return poses, likeliest first; those about as likely as the best are refined on the outline."""
        likely = self._likely(ranked)
        return self.distinct([*map(self.outline_refined, likely), *ranked[len(likely) :]])

    def is_settled(self, registration: Registration, poses: Sequence[Pose]) -> bool:
        """Return whether the registered best pose is at an optimum and no other pose is about as likely.

        Otherwise the likelihoods of the poses are not comparable, since their alignments stopped at different
        distances from their optima.
        """
        if registration.T_sensor_target is None:
            return True
        pose = PoseArrays.of(registration.T_sensor_target)
        turn = np.kron(np.eye(2), pose.R.T)
        spread = turn @ registration.covariance @ turn.T
        return len(self._likely(poses)) == 1 and self.scanner.statistics.is_settled(self.seen, pose, spread)

    def ranked(self, poses: Sequence[Pose]) -> list[Pose]:
        """Return poses by falling posterior mass, without those that belong to the posterior of the best."""
        best, *others = sorted(poses, key=lambda pose: -pose.log_mass(self.scanner.reach.radius_m))
        steps = [step_between(pose_of(best.R, best.t), pose_of(other.R, other.t)) for other in others]
        near = [step @ best.information @ step <= ABSORBED for step in steps]
        return [best, *(other for other, inside in zip(others, near, strict=True) if not inside)]

    def sampled_near(self, pose: PoseArrays) -> Pose:
        """Return the posterior mean near a pose, from samples."""
        return self._polished(self.unrefined(pose.R, pose.t))

    def _polished(self, pose: Pose) -> Pose:
        """Return a pose refined on the outline and then by samples of the posterior, unless it is already."""
        return pose if pose.sampled_mass is not None else self._sampled(self.outline_refined(pose))

    def _likely(self, ranked: Sequence[Pose], gain: float = 0.0) -> list[Pose]:
        """Return the poses that are about as likely as the best one.

        Args:
            ranked: the poses, likeliest first.
            gain: log likelihood that the best has gained by a refinement that the others have not had.
        """
        most = max((pose.fit.log_likelihood for pose in ranked[:1]), default=0.0)
        least = most - max(self._tuning.rival_log_likelihood, UNSETTLED * most) - gain
        return [pose for pose in ranked if pose.fit.log_likelihood >= least]

    def _finished(self, pose: Pose) -> Pose:
        """Return a pose after full refinement, so that its near-symmetries start from an accurate pose."""
        pose = self._improved(pose, self._fine_m)
        halfway = 0.0 < pose.fit.deficit < HALFWAY * self.seen.returns
        return self.outline_refined(pose) if halfway and not self.few else pose

    def _is_turned(self, pose: Pose, turned: Sequence[Pose]) -> bool:
        """Return whether a pose's near-symmetries were tried when it was about as likely as now."""
        return any(
            near and pose.fit.log_likelihood <= other.fit.log_likelihood + CHANCE
            for near, other in zip(self.are_close(pose, turned), turned, strict=True)
        )

    def are_close(self, pose: Pose, others: Sequence[Pose]) -> NDArray[np.bool_]:
        """Return which other attitudes are close to that of a pose, modulo exact symmetries, shape (O,)."""
        turns, limit_deg = self._model.turns, self._tuning.distinct_deg
        near: NDArray[np.bool_] = turns.close(matrices([pose]), matrices(others), limit_deg)[0]
        return near

    def face_aligned(self, R: FloatArray, t: FloatArray, scales_m: FloatArray) -> Pose:
        """Return a pose after one step to the faces for each Geman-McClure scale, shape (steps,)."""
        problem = self._problem(scales_m)
        statistics = self.scanner.statistics
        found = aligned(problem, PoseArrays(R, t), self.seen.range_m, statistics.assumed)
        return Pose(*found.pose, ScanFit.of(found.statistics), found.faces.information)

    def fine_aligned(self, R: FloatArray, t: FloatArray) -> Pose:
        """Return a pose after the last steps to the faces."""
        return self.face_aligned(R, t, self._fine_m)

    def _problem(self, scales_m: FloatArray) -> FaceProblem:
        view, statistics = self.scanner.view, self.scanner.statistics
        return FaceProblem(
            self.seen.points_m,
            self.seen.rays,
            self.seen.grid.arrays,
            self._model.surface.faces,
            self._model.surface.coarse_field,
            ScanErrors(statistics.sigma_range_m, statistics.assumed.slack_m, 0.0, 0.0),
            scales_m,
            view.hits.arrays,
        )

    def unrefined(self, R: FloatArray, t: FloatArray) -> Pose:
        """Return a pose as it is, with its fit, without information from any alignment."""
        return Pose(R, t, self.scanner.statistics.fit(self.seen, R, t), np.zeros((6, 6)))

    def _improved(self, pose: Pose, scales_m: FloatArray) -> Pose:
        """Return a pose aligned with the faces, or unchanged if the alignment makes it less likely."""
        moved = self.face_aligned(pose.R, pose.t, scales_m)
        better = moved.fit.log_likelihood >= pose.fit.log_likelihood
        return moved if better else replace(pose, information=moved.information)

    def belief(self, pose: Pose) -> Belief:
        """Return the belief that a pose explains the scan."""
        return self.scanner.statistics.belief(self.seen, pose.R, pose.t, pose.fit)

    def _is_sure(self, pose: Pose) -> bool:
        likely = pose.fit.deficit <= -self._tuning.sure_surplus * self.seen.returns
        return likely and not self._is_fine and self.informative >= self._tuning.sure_returns

    def _turned(self, pose: Pose, count: int) -> list[Pose]:
        """Return a pose's near-symmetries and best other turns, at its position and at the centroid."""
        turns = self._model.turns
        found = self._best_turned(pose, turns.all, count, sure=turns.declared)
        return found if self.few else found + self._best_turned(pose, turns.further, FURTHER)

    def _best_turned(self, pose: Pose, turns: FloatArray, count: int, *, sure: int = 0) -> list[Pose]:
        """Return a pose after the best of some turns; the arguments are those of ``Comparison.turned``."""
        found = self._comparison.turned(PoseArrays(pose.R, pose.t), turns, count, sure=sure)
        return [
            self._field_aligned(R, t) if centred else self._improved(self.unrefined(R, t), self._rough_m)
            for (R, t), centred in found
        ]

    def _field_aligned(self, R: FloatArray, t: FloatArray) -> Pose:
        """Return a rough pose aligned with the ranges, or with the outline if this makes it less likely.

        The ranges of a small target may be mostly noise, and an alignment by them alone may end anywhere.
        """
        rough = field_aligned(self._few, PoseArrays(R, t), self._model.surface.coarse_field, self._far_m)
        moved, start = self.face_aligned(*rough, self._rough_m), self.unrefined(R, t)
        if moved.fit.log_likelihood >= start.fit.log_likelihood:
            return moved
        return self.outline_refined(start)

    def outline_refined(self, pose: Pose) -> Pose:
        """Return a pose refined on the outline too; unchanged if no return is on a ray of the pattern."""
        if not (self.seen.range_m > 0.0).any():  # all returns lie beside the pattern
            return pose
        scanner = self.scanner
        problem, start = self._problem(self._fine_m), PoseArrays(pose.R, pose.t)
        found = outline_mean(problem, start, self.seen.range_m, scanner.statistics.assumed, scanner.reach)
        fit = ScanFit.of(found.statistics)
        if fit.log_likelihood < pose.fit.log_likelihood - CHANCE:
            return replace(pose, information=found.information)
        return Pose(*found.pose, fit, found.information)

    def _sampled(self, pose: Pose) -> Pose:
        """Return the mean of the posterior near a pose, or the likeliest sample if the mean is unlikely.

        While a sample is likelier than the pose, the pose is refined from there and sampled again.
        """
        if not (self.seen.range_m > 0.0).any():
            return pose
        start, found = self._posterior(pose)
        for _ in range(RESUMED - 1):
            refined = self.outline_refined(self.unrefined(*stepped(start, found.likeliest)))
            if not refined.fit.log_likelihood > pose.fit.log_likelihood + CHANCE:
                break
            pose = refined
            start, found = self._posterior(pose)
        mean, fit, covariance = self.scanner.statistics.mean(self.seen, start, found)
        information: FloatArray = np.linalg.inv(covariance).astype(np.float64)
        return Pose(*mean, ScanFit.of(fit), information, found.log_mass)

    def _posterior(self, pose: Pose) -> tuple[PoseArrays, SampledPosterior]:
        """Return a pose and the posterior near it."""
        start = PoseArrays(pose.R, pose.t)
        rough = neighbourhood(pose.information, start, self.scanner.reach)
        return start, self.scanner.statistics.posterior(self.seen, start, rough)

    def distinct(self, poses: list[Pose]) -> list[Pose]:
        """Return the poses in falling order of likelihood, without those close to a better one."""
        ranked = sorted(poses, key=lambda pose: -pose.fit.log_likelihood)
        return self._model.turns.distinct(ranked, self._tuning.distinct_deg)
