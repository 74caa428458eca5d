"""Fit of a pose to a scan: the likelihood of every ray, hit or missed.

The target is cast at the pose. A ray that should meet it gives a return with a probability that is estimated
from the scan itself (``detection``). Its range has a heavy-tailed error whose scale the sensor states
(``scan_likelihood``). A ray that should meet nothing gives a return with a small probability, at any range.
The scan's log likelihood is the sum over the rays.

If the pose is right, this sum has a known expectation and variance. The *deficit*, expected minus actual log
likelihood, therefore measures how inconsistent the scan is with the pose, without any other pose for
comparison. The deficit of a right pose is small and random; that of a wrong one is several units per return.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from math import degrees, e, hypot, log, pi, sqrt
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.windows import window_around
from rpod_pose.belief import Belief, PixelMarks, contradicted
from rpod_pose.cancellation import stop_if_cancelled
from rpod_pose.lidar.neighbour_residuals import neighbour_sums, noise_over
from rpod_pose.lidar.posterior.sampled_posterior import (
    Proposal,
    SampledPosterior,
    draws,
    log_likelihoods,
    sampled_posterior,
)
from rpod_pose.lidar.returns.detection import LINEAR_STEPS, detection, expected_shares
from rpod_pose.lidar.returns.false_returns import lone_returns
from rpod_pose.lidar.scan_likelihood import (
    PEAK,
    STEEPEST,
    Assumptions,
    Rays,
    ScanAgreement,
    ScanStatistics,
    scan_statistics,
)
from rpod_pose.lidar.scan_pattern import UNKNOWN_SIGMA_M
from rpod_pose.lidar.scan_registration import CHANCE
from rpod_pose.lidar.scan_view import ScanView, SeenScan
from rpod_pose.pose_evidence import Misfit
from rpod_pose.registration.lie_group import PoseArrays, stepped
from rpod_pose.registration.surface_model import SurfaceModel, cast_faces
from rpod_pose.search.even_samples import normal_steps, steps_of
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar.search import ScanAcceptanceConfig, ScanModelConfig

ENTROPY = sqrt(2.0 * pi * e)
"""Width of a uniform distribution with the entropy of a normal one, in standard deviations. The information
of a return is the logarithm of the ratio of these widths before and after it. Physics: sqrt(2 pi e)."""
LARGE = 1e3
"""Least size of a target, in standard deviations of a range, at which a return counts fully. Hand: 25 m for
25 mm, about ENVISAT for the documented LIDAR."""
LEAST_DEVIATION = 3.0
"""Least standard deviation of a deficit, for scans in which almost nothing is random. Hand: otherwise any
deficit would refuse a scan in which all rays are certain."""
MARGIN = 3
"""Number of rows and columns around the target and the returns that are evaluated near a pose. Numerics: a
budget; a pose that reaches farther is compared with fewer rays."""

DRAWN_POWER = 4
"""Logarithm to base 2 of the number of poses that are drawn near a pose to check whether it is at an optimum.
Numerics: a budget; if a pose is some standard deviations off, several of 16 are likelier."""

UPHILL_SIGMAS = np.array([1.0, 2.0, 4.0, 8.0])
"""Lengths of the steps uphill, in standard deviations. Numerics: a budget; each is twice the one before."""

_UNEVEN = 0.15
"""Error that the ranges of neighbours may share because of their surface, over the stated sigma. Hand: 3 of
20 mm."""
_LIMIT = 4.0
"""Limit of a residual in the test of the model, over the stated sigma. Physics: one in 16,000 normal errors
is larger."""


@dataclass(frozen=True, eq=False)
class ScanFit:
    """Fit of a pose to a scan."""

    agreement: ScanAgreement
    deficit: float
    """Expected minus actual log likelihood of the scan."""
    deviation: float
    """Standard deviation of the deficit if the pose is right."""

    @classmethod
    def of(cls, statistics: ScanStatistics) -> Self:
        """Return the fit of a pose from the scan's statistics at the pose."""
        agreement, expected, variance = statistics
        return cls(agreement, expected - agreement.log_likelihood, sqrt(variance))

    @property
    def log_likelihood(self) -> float:
        """Log likelihood of the scan at the pose, relative to that of an empty sky."""
        return self.agreement.log_likelihood

    def evidence(self, returns: int) -> dict[str, float]:
        """Return the numbers from which the belief in the pose follows, in a scan of some returns.

        If on average a share s of the rays disagrees, a share up to s + 2 sqrt(s / returns) is expected in a
        scan: two standard deviations more. ``disagreeing_share`` is the s for which the actual share is just
        at this limit.
        """
        chance = sqrt(1.0 / returns)
        return {
            "deficit": self.deficit,
            "deficit_sigma": self.deviation,
            "deficit_sigmas": self.deficit / max(self.deviation, LEAST_DEVIATION),
            "returns": float(returns),
            "agreeing_share": self.agreement.share,
            "disagreeing_share": (sqrt(1.0 - self.agreement.share + chance**2) - chance) ** 2,
        }


class ScanModel:
    """Statistical model of a sensor's scans of a target.

    Args:
        config: assumptions about the scans.
        acceptance: limits within which a pose explains a scan.
        view: rays of the scan pattern.
        surface: model of the target.
        sigma_range_m: standard deviation of a range that the sensor states; 0 if it does not.
        tolerance_m: standard deviation of the target's surface that its file declares.
    """

    def __init__(
        self,
        config: ScanModelConfig,
        acceptance: ScanAcceptanceConfig,
        view: ScanView,
        surface: SurfaceModel,
        *,
        sigma_range_m: float = 0.0,
        tolerance_m: float = 0.0,
    ) -> None:
        self._view, self._acceptance = view, acceptance
        self.sigma_range_m = config.sigma_range_m or sigma_range_m or UNKNOWN_SIGMA_M
        self._uneven_m = hypot(_UNEVEN * self.sigma_range_m, tolerance_m)
        self._faces = surface.faces
        self._shares = expected_shares(config.surest_detection)
        self._radius_m = float(np.linalg.norm(surface.faces.triangles_m, axis=2).max())
        self.assumed = _assumptions(config, self.sigma_range_m, self._radius_m)
        worse = config.model_copy(update=dict(acceptance.pessimistic))
        self._pessimistic = _assumptions(worse, self.sigma_range_m, self._radius_m)

    def informative(self, seen: SeenScan) -> float:
        """Return the number of returns, multiplied by the information of one relative to a large target."""
        ratio = 2.0 * self._radius_m / self.sigma_range_m
        return seen.returns * min(max(log(ratio / ENTROPY) / log(LARGE / ENTROPY), 0.0), 1.0)

    def _rays(self, seen: SeenScan) -> Rays:
        """Return the rays of a scan with the pattern's buffers."""
        hits = self._view.hits
        return Rays(seen.grid.arrays, self._faces, hits.range_m, hits.triangle)

    def fit(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> ScanFit:
        """Return how well a pose explains a scan.

        Args:
            seen: the scan.
            R: R_sensor_target, shape (3, 3).
            t: position of the target's origin, sensor axes, shape (3,), m.
        """
        stop_if_cancelled()
        return ScanFit.of(scan_statistics(seen.range_m, R, t, self._rays(seen), self.assumed))

    @property
    def expected_shares(self) -> tuple[float, FloatArray]:
        """The argument ``detection`` of ``energies``: steps of the table per unit of echo, and the table."""
        return LINEAR_STEPS * self.assumed.least_range_m**2, self._shares

    def belief(self, seen: SeenScan, R: FloatArray, t: FloatArray, fit: ScanFit) -> Belief:
        """Return the belief in a pose whose fit is known; arguments as for ``fit``."""
        rays = fit.agreement
        evidence = fit.evidence(seen.returns)
        if self._explains(evidence):
            return Belief(evidence=evidence)
        pessimistic = self._pessimistic_fit(seen, R, t).evidence(seen.returns)
        if self._explains(pessimistic):
            return Belief(evidence=pessimistic)
        reason = (
            f"does not explain the scan: of {seen.returns} returns {rays.inconsistent} contradict the pose, "
            f"{rays.missing:.0f} more are missing"
        )
        return self._marked(contradicted(reason, **evidence), seen, R, missing=rays.missing >= 1.0)

    def explains(self, seen: SeenScan, fit: ScanFit) -> bool:
        """Return whether a fit explains a scan with errors as large as sensor and target state."""
        return self._explains(fit.evidence(seen.returns))

    def without_false_returns(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> SeenScan | None:
        """Return a scan without its false returns if a pose explains it then, otherwise None.

        The pose has to explain those lone returns that may be of surfaces. In the result all are left out,
        since they would pull the pose. The arguments are those of ``fit``.
        """
        cast_faces(seen.grid.arrays, self._faces, R, t, self._view.hits.arrays)
        lone = lone_returns(seen, self._agreeing(seen, R))
        if lone.of_surfaces == len(lone.places):
            return None
        likely = seen.without(lone.places[lone.of_surfaces :])
        fits = self.fit(likely, R, t), self._pessimistic_fit(likely, R, t)
        explained = any(self._explains(fit.evidence(likely.returns)) for fit in fits)
        return seen.without(lone.places) if explained else None

    def _pessimistic_fit(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> ScanFit:
        statistics = scan_statistics(seen.range_m, R, t, self._rays(seen), self._pessimistic)
        return ScanFit.of(statistics)

    def _agreeing(self, seen: SeenScan, R: FloatArray) -> NDArray[np.bool_]:
        """Return the mask of the returns that the target explains better than clutter does.

        The target is at the pose that was cast last, with the rotation R.
        """
        hits = self._view.hits
        met, measured = hits.triangle >= 0, seen.range_m > 0.0
        normals = self._faces.normals[hits.triangle] @ R.T
        cosine = -(normals * seen.grid.directions).sum(axis=-1)
        slack_m = self.assumed.slack_m / np.maximum(cosine, STEEPEST)
        variance = self.assumed.sigma_m**2 + slack_m**2
        tail = 1.0 + 0.25 * (seen.range_m - np.where(met, hits.range_m, 0.0)) ** 2 / variance
        density = PEAK / (np.sqrt(variance * tail) * tail * tail)
        agreeing: NDArray[np.bool_] = measured & met & (density > self.assumed.clutter_density)
        return agreeing

    def _marked(self, belief: Belief, seen: SeenScan, R: FloatArray, *, missing: bool) -> Belief:
        """Return a belief with the rays that are inconsistent with the pose that was cast last.

        These are the returns that clutter explains better than the target does. If more returns are missing
        than the echoes explain, they are also the rays that meet the target and gave no return.
        """
        marked = (seen.range_m > 0.0) & ~self._agreeing(seen, R)
        if missing:
            marked |= (self._view.hits.triangle >= 0) & (seen.range_m == 0.0)
        if not marked.any():
            return belief
        marks = PixelMarks(marked, 1)
        column, row = marks.centre_px
        azimuth, elevation = self._view.azimuth_rad[column], self._view.elevation_rad[row]
        where = f"most of them around azimuth {degrees(azimuth):.1f}, elevation {degrees(elevation):.1f} deg"
        return replace(belief, reason=f"{belief.reason}; {where}", marks=marks)

    def misfit(self, seen: SeenScan, R: FloatArray, t: FloatArray) -> Misfit:
        """Return the test of the target's model by the residuals of neighbouring returns.

        The range noise of two pulses is independent. So the mean product of neighbours' residuals is 0,
        whatever the size of the noise is. A face at another place than in the model, or a wrong pose, shifts
        neighbours in the same direction. The part that the file's tolerances and ``_UNEVEN`` explain is
        subtracted. Residuals are limited to ``_LIMIT``, so that outliers count but do not dominate. Returns
        beside the target, more than one ray from its outline, have the limit as their residual; the number of
        pairs that is expected by chance is subtracted.
        """
        hits = self._view.hits
        cast_faces(seen.grid.arrays, self._faces, R, t, hits.arrays)
        sums = neighbour_sums(seen.range_m, hits.range_m, hits.triangle, _LIMIT * self.sigma_range_m)
        expected_m2 = self._uneven_m**2 * sums.products + sums.chance_m2
        noise = noise_over(seen.range_m, hits.range_m, hits.triangle, self.sigma_range_m)
        return Misfit(sums.product_m2 - expected_m2, sums.squares_m4, noise)

    def _explains(self, evidence: Mapping[str, float]) -> bool:
        acceptance = self._acceptance
        return (
            evidence["deficit_sigmas"] <= acceptance.max_deficit
            and evidence["disagreeing_share"] <= acceptance.inconsistent_share
        )

    def is_settled(self, seen: SeenScan, pose: PoseArrays, covariance: FloatArray) -> bool:
        """Return whether a pose is as likely as poses near it; arguments as for ``more_likely_pose``."""
        return bool(np.isfinite(covariance).all()) and self.more_likely_pose(seen, pose, covariance) is None

    def more_likely_pose(self, seen: SeenScan, pose: PoseArrays, covariance: FloatArray) -> PoseArrays | None:
        """Return a pose near a given one whose log likelihood is higher by more than ``CHANCE``, or None.

        An alignment may stop before the optimum, for example among thousands of small faces. A pose that is
        drawn from the covariance at an optimum has a log likelihood that is lower by three on average. On a
        slope the same holds for most of the drawn poses, since few of them lie uphill. Therefore their
        gradient is followed too.

        Args:
            seen: the scan.
            pose: the pose.
            covariance: covariance of (dtau, dtheta) as in ``normal_equations``, shape (6, 6).
        """
        steps = np.vstack((np.zeros(6), steps_of(covariance, DRAWN_POWER)))
        measured, rays = self._cropped(seen, pose)
        logs = log_likelihoods(measured, pose, steps, rays, self.assumed)
        if logs.max() <= logs[0] + CHANCE:
            along = uphill(steps[1:], logs[1:] - logs[0])
            steps = np.vstack((steps[0], along))
            logs = np.append(logs[0], log_likelihoods(measured, pose, along, rays, self.assumed))
        best = logs.argmax()
        return stepped(pose, steps[best]) if logs[best] > logs[0] + CHANCE else None

    def posterior(self, seen: SeenScan, pose: PoseArrays, covariance: FloatArray) -> SampledPosterior:
        """Return the posterior of poses near a given one.

        Args:
            seen: the scan.
            pose: the pose.
            covariance: rough covariance of (dtau, dtheta) as in ``normal_equations``, too large rather than
                too small, shape (6, 6).
        """
        measured, rays = self._cropped(seen, pose)
        proposal = Proposal(covariance, draws())
        found: SampledPosterior = sampled_posterior(measured, pose, rays, self.assumed, proposal)
        return found

    def _cropped(self, seen: SeenScan, pose: PoseArrays) -> tuple[FloatArray, Rays]:
        """Return the measured ranges and the rays near the returns and the target at a pose."""
        hits = self._view.hits
        cast_faces(seen.grid.arrays, self._faces, pose.R, pose.t, hits.arrays)
        rows, columns = window_around((seen.range_m > 0.0) | (hits.triangle >= 0), (MARGIN, MARGIN))
        measured = np.ascontiguousarray(seen.range_m[rows, columns])
        buffers = np.empty(measured.shape, np.float32), np.empty(measured.shape, np.int32)
        return measured, Rays(seen.grid.block(rows, columns), self._faces, *buffers)

    def mean(
        self, seen: SeenScan, pose: PoseArrays, posterior: SampledPosterior
    ) -> tuple[PoseArrays, ScanStatistics, FloatArray]:
        """Return the mean of a posterior, the scan's statistics there, and the covariance of (dtau, dtheta).

        If there are several optima, their mean may explain the scan worse than they do. Then the likeliest
        sample is returned, with the covariance about it.

        Args:
            seen: the scan.
            pose: the pose from which the posterior's steps are counted.
            posterior: the posterior.
        """
        mean, likeliest = stepped(pose, posterior.mean), stepped(pose, posterior.likeliest)
        there, best = self._statistics(seen, mean), self._statistics(seen, likeliest)
        if there.agreement.log_likelihood >= best.agreement.log_likelihood - CHANCE:
            return mean, there, posterior.covariance
        off = posterior.likeliest - posterior.mean
        return likeliest, best, posterior.covariance + np.outer(off, off)

    def _statistics(self, seen: SeenScan, pose: PoseArrays) -> ScanStatistics:
        found: ScanStatistics = scan_statistics(seen.range_m, pose.R, pose.t, self._rays(seen), self.assumed)
        return found


def _assumptions(config: ScanModelConfig, sigma_range_m: float, radius_m: float) -> Assumptions:
    return Assumptions(
        sigma_m=config.noise_scale * sigma_range_m,
        slack_m=min(config.slack_sigmas * sigma_range_m, config.slack_share * radius_m),
        clutter_share=config.clutter_share,
        clutter_density=config.clutter_share / config.clutter_depth_m,
        least_range_m=config.least_range_m,
        detection=detection(config.surest_detection, config.clutter_share),
    )


def uphill(steps: FloatArray, gains: FloatArray) -> FloatArray:
    """Return steps uphill, for steps that were drawn from a covariance and their log likelihoods.

    The gains are fitted by a slope and a common curvature, in units of the covariance.

    Args:
        steps: drawn steps, shape (N, 6).
        gains: log likelihood of each relative to that of no step, shape (N,).
    """
    of_gains, of_steps = _inverses()
    slope = of_gains @ gains
    direction = slope[:6] / max(float(np.linalg.norm(slope[:6])), 1e-12)
    along: FloatArray = np.outer(UPHILL_SIGMAS, direction @ (of_steps @ steps))
    return along


@cache
def _inverses() -> tuple[FloatArray, FloatArray]:
    """Return the inverses that fit gains, (7, N), and a root of the covariance, (6, N), to the draws."""
    drawn = normal_steps(DRAWN_POWER)
    curved = np.column_stack((drawn, (drawn**2).sum(axis=1)))
    of_gains: FloatArray = np.linalg.pinv(curved).astype(np.float64, copy=False)
    of_steps: FloatArray = np.linalg.pinv(drawn).astype(np.float64, copy=False)
    return of_gains, of_steps
