"""Registration of a scan in one call: alignment with the target, and how well the pose explains the scan.

First the ranges are aligned with the target's faces. The outline is used too (``outline``) in two cases: it
can determine a direction better than the faces do, or the scan is less likely than the pose predicts. Then
pose and information are those of the posterior from all rays, with returns or without.

Python takes about a microsecond to pass an array to a kernel. Therefore these kernels do in one call what
belongs together.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_pose.lidar.outline.steps import Scene, outline_steps
from rpod_pose.lidar.posterior.step_posterior import Steps, propagated
from rpod_pose.lidar.scan_alignment import (
    FEWEST,
    FaceFit,
    FaceProblem,
    add_face_points,
    excess,
    face_aligned,
    without_influential,
)
from rpod_pose.lidar.scan_likelihood import (
    HALF_BEAM_RAD,
    Assumptions,
    Rays,
    ScanStatistics,
    rendered_likelihood,
    scan_agreement,
    scan_statistics,
)
from rpod_pose.lidar.scan_view import ScanView, spacing_rad
from rpod_pose.registration.field_alignment import FieldProblem, Points, field_aligned
from rpod_pose.registration.lie_group import PoseArrays, stepped
from rpod_pose.registration.normal_equations import gradient_of, information_of, no_sums
from rpod_pose.registration.surface_model import cast_faces
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.lidar.search import ProjectiveIcpConfig

ROUNDS = 5
"""Largest number of rounds in which the outline is found again. Numerics: a budget; a round that moves the
outline by less than ``STRAIGHT`` is the last one."""
STRAIGHT = 0.125
"""Largest motion of the outline, over the distance of neighbouring rays, at which it counts as a straight
line. Hand: a larger one ends the rounds earlier."""
STRETCH = 3.0
"""Factor on the standard deviations of a pose near which samples are drawn. Numerics: the first samples must
be wider than the posterior; later rounds narrow them."""
RESUMED = 4
"""Largest number of times that poses near a registration are sampled. Numerics: a budget of computation."""
CHANCE = 3.0
"""Decrease of the log likelihood from the optimum to a typical right pose. Physics: half of the mean of a
chi-square variable, for six unknowns."""


class Reach(NamedTuple):
    """Limits of a tracker: errors of its predictions, and the accuracy of the outline."""

    near_share: float
    """Least share of agreeing rays at which a prediction counts as close."""
    spacing_rad: float
    """Angle between neighbouring rays."""
    radius_m: float
    """Distance of the target's farthest point from its origin."""
    surplus: float
    """Least excess of the actual over the expected log likelihood for each return, at a surely right pose."""


class ScanRegistration(NamedTuple):
    """A registered scan."""

    pose: PoseArrays
    """Pose of the target in the sensor."""
    faces: FaceFit
    """Alignment with the faces; its pose differs from ``pose`` if it was refused."""
    information: FloatArray
    """Information matrix of (dtau, dtheta) at the pose, from ranges and outline, shape (6, 6)."""
    statistics: ScanStatistics
    """Statistics of the scan at the pose."""
    converged: bool
    """Whether the last step moved the outline by less than ``STRAIGHT``; True if the outline is not used."""


def reach_of(view: ScanView, config: ProjectiveIcpConfig, radius_m: float) -> Reach:
    """Return the limits of a tracker with a scan pattern, for a target of a given radius, m."""
    spacing = max(spacing_rad(view.azimuth_rad), spacing_rad(view.elevation_rad))
    return Reach(config.tuning.near_share, spacing, radius_m, config.tuning.sure_surplus)


def is_sure(found: ScanRegistration, returns: int, reach: Reach) -> bool:
    """Return whether a registration converged, and its scan is as likely as at a right pose."""
    return found.converged and bool(_deficit(found) <= -reach.surplus * returns)


def neighbourhood(
    information: FloatArray, pose: PoseArrays, reach: Reach, *, stretch: float = STRETCH
) -> FloatArray:
    """Return a covariance of (dtau, dtheta), shape (6, 6), that covers neighbouring optima of a pose.

    Args:
        information: information matrix of (dtau, dtheta) at the pose, shape (6, 6).
        pose: pose of the target in the sensor.
        reach: limits; a neighbouring optimum moves no point farther than to the next ray.
        stretch: factor on the standard deviations; 1 for those of the pose.
    """
    held = np.diag(_held(pose, reach))
    covariance: FloatArray = np.linalg.inv(information / stretch**2 + held).astype(np.float64)
    return covariance


@kernel
def aligned(
    problem: FaceProblem, start: PoseArrays, range_m: FloatArray, assumed: Assumptions
) -> ScanRegistration:
    """Return the registration after one step to the faces for each of the problem's scales.

    Args:
        problem: the returns and the target.
        start: pose of the target in the sensor, close to the solution.
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        assumed: statistics of returns.
    """
    fit = face_aligned(problem, start)
    statistics = scan_statistics(range_m, fit.pose.R, fit.pose.t, _rays(problem), assumed)
    return ScanRegistration(fit.pose, fit, _of_faces(problem, fit), statistics, True)


@inner_kernel
def _of_faces(problem: FaceProblem, fit: FaceFit) -> FloatArray:
    """Return the information of an alignment with the faces, for the actual variance of residuals, (6, 6)."""
    return fit.information / excess(fit.squares_m2, fit.inliers, problem.errors.sigma_m)


def refined(
    problem: FaceProblem, start: PoseArrays, range_m: FloatArray, assumed: Assumptions, reach: Reach
) -> ScanRegistration:
    """Return the registration from a pose that is close to the solution.

    The alignment with the faces may move a pose away from the outline with which it agrees. Then the start is
    kept.

    Args:
        problem: all returns and the target.
        start: pose of the target in the sensor.
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        assumed: statistics of returns.
        reach: limits of the tracker.
    """
    nothing = np.empty(0)
    far = FieldProblem(Points(problem.points_m, nothing), problem.field, nothing)
    # With near_share 0 each start counts as close, so that the distance field is not used. A separate kernel
    # would contain all of ``tracked`` and take as long to compile.
    return tracked(far, problem, start, range_m, assumed, reach._replace(near_share=0.0))


@kernel
def tracked(  # noqa: PLR0917
    far: FieldProblem,
    problem: FaceProblem,
    start: PoseArrays,
    range_m: FloatArray,
    assumed: Assumptions,
    reach: Reach,
) -> ScanRegistration:
    """Return the registration from a predicted pose.

    If the prediction is far off, it is also aligned in the distance field first, and the likelier result is
    returned.

    Args:
        far: some of the returns, the target's distance field, and the Geman-McClure scales of its steps.
        problem: all returns and the target.
        start: predicted pose of the target in the sensor.
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        assumed: statistics of returns.
        reach: limits of the tracker.
    """
    there = scan_agreement(range_m, start.R, start.t, _rays(problem), assumed)
    found = _refined(problem, start, there.log_likelihood, range_m, assumed)
    best, begin = found, start
    near = there.agreeing >= reach.near_share * (there.agreeing + there.inconsistent + there.missing)
    if not near:
        placed = field_aligned(far.points, start, far.field, far.scales_m)
        best = aligned(problem, placed, range_m, assumed)
        if best.statistics.agreement.log_likelihood < found.statistics.agreement.log_likelihood:
            found, best = best, found
        begin = best.pose
    if _is_sufficient(best, problem, reach):
        return best
    best = outline_mean(problem, begin, range_m, assumed, reach)
    return _better_by_outline(best, found, problem, range_m, assumed, reach)


@inlined_kernel
def _better_by_outline(  # noqa: PLR0917
    best: ScanRegistration,
    other: ScanRegistration,
    problem: FaceProblem,
    range_m: FloatArray,
    assumed: Assumptions,
    reach: Reach,
) -> ScanRegistration:
    """Return the best registration so far, or one with the outline from another pose if that is better.

    Args:
        best: best registration so far, with the outline.
        other: registration with the faces alone.
        problem: all returns and the target.
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        assumed: statistics of returns.
        reach: limits of the tracker.
    """
    likely = other.statistics.agreement.log_likelihood >= best.statistics.agreement.log_likelihood - CHANCE
    if _is_unexplained(best) or (likely and not _are_alike(best.pose, other.pose, reach)):
        best = _more_likely(best, outline_mean(problem, other.pose, range_m, assumed, reach))
    if _is_unexplained(best):
        best = _more_likely(best, outline_mean(problem, best.pose, range_m, assumed, reach))
    return best


@inlined_kernel
def _more_likely(best: ScanRegistration, other: ScanRegistration) -> ScanRegistration:
    """Return the other registration if its log likelihood is higher by more than ``CHANCE``."""
    least = best.statistics.agreement.log_likelihood + CHANCE
    return other if other.statistics.agreement.log_likelihood > least else best


@inlined_kernel
def _is_unexplained(found: ScanRegistration) -> bool:
    """Return whether there is a return that no face explains.

    Either it is clutter, or the pose has moved along faces until a few returns were assigned to wrong faces
    beside an outline. The information does not show the second case, since it contains these returns.
    """
    agreement = found.statistics.agreement
    return bool(agreement.inconsistent + agreement.grazing > 0)


@inlined_kernel
def _are_alike(one: PoseArrays, other: PoseArrays, reach: Reach) -> bool:
    """Return whether two poses are so close that the outline is straight between them."""
    moved_m, turned2 = sqrt(((one.t - other.t) ** 2).sum()), ((one.R - other.R) ** 2).sum() / 2.0
    straight_m = STRAIGHT * reach.spacing_rad * sqrt((one.t**2).sum())
    return bool(moved_m + reach.radius_m * sqrt(turned2) < straight_m)


@inner_kernel
def _is_sufficient(found: ScanRegistration, problem: FaceProblem, reach: Reach) -> bool:
    """Return whether the pose is surely right, and determined by the faces as well as by the outline."""
    returns = problem.points_m.shape[0]
    likely = _deficit(found) <= -reach.surplus * returns
    finite = np.isfinite(found.information).all()
    return bool(likely and finite and not _is_unexplained(found) and _determined(found, returns, reach))


@inlined_kernel
def _deficit(found: ScanRegistration) -> float:
    """Return the expected minus the actual log likelihood of the scan."""
    return found.statistics.expected - found.statistics.agreement.log_likelihood


@inner_kernel
def _determined(found: ScanRegistration, returns: int, reach: Reach) -> bool:
    """Return whether the faces determine all directions better than the outline could.

    About 4 sqrt(returns) rays are beside the outline. Two of them bound each place of the outline within a
    strip whose width is the distance of neighbouring rays. With n places, the outline is known to about the
    n-th part of this width.
    """
    pose, strip_m = found.pose, reach.spacing_rad * sqrt((found.pose.t**2).sum())
    limit_m = strip_m / (2.0 * sqrt(max(returns, 1)))
    covariance = np.linalg.inv(found.information + np.diag(_held(pose, reach)) * 1e-6)
    spread_m2 = 0.0
    for k in range(3):
        spread_m2 = max(spread_m2, covariance[k, k], covariance[3 + k, 3 + k] * reach.radius_m**2)
    return spread_m2 <= limit_m * limit_m


@inner_kernel
def _farthest(steps: Steps, step: FloatArray) -> float:
    """Return the largest motion of the outline, m, beside any ray in a step (dtau, dtheta), shape (6,)."""
    farthest = 0.0
    for e in range(steps.number):
        moved = 0.0
        for k in range(6):
            moved += steps.rows[e, k] * step[k]
        farthest = max(farthest, abs(moved))
    return farthest


@kernel
def _held(pose: PoseArrays, reach: Reach) -> FloatArray:
    """Return the prior information that no point moves farther than to the next ray in a step, shape (6,)."""
    held, strip_m = np.empty(6), max(reach.spacing_rad * sqrt((pose.t**2).sum()), 1e-6 * reach.radius_m)
    held[:3] = strip_m**-2
    held[3:] = (strip_m / reach.radius_m) ** -2
    return held


@kernel
def outline_mean(
    problem: FaceProblem, start: PoseArrays, range_m: FloatArray, assumed: Assumptions, reach: Reach
) -> ScanRegistration:
    """Return the posterior mean of the pose from ranges and outline near a pose; arguments as ``refined``."""
    rays, pose, information = _rays(problem), start, np.zeros((6, 6))
    inliers, squares, likelihood, kept, step, converged = 0, 0.0, -np.inf, start, np.zeros(6), False
    straight_m = STRAIGHT * reach.spacing_rad * sqrt((start.t**2).sum())
    for number in range(ROUNDS):
        cast_faces(rays.grid, rays.faces, pose.R, pose.t, problem.buffers)
        here, power = rendered_likelihood(range_m, pose, rays, assumed)
        if here < likelihood - CHANCE:  # the outline is not straight over such a long step
            step *= 0.5
            pose = stepped(kept, step)
            continue
        kept, likelihood = pose, max(here, likelihood)
        scale = problem.scales_m[min(number, problem.scales_m.size - 1)]
        evidence = add_face_points(no_sums(), problem, pose, scale)
        if evidence.inliers < FEWEST:
            break
        inliers, squares = evidence.inliers, evidence.squares_m2
        whole = inliers / max(evidence.faded, 1e-6) / excess(squares, inliers, problem.errors.sigma_m)
        of_ranges = information_of(evidence.sums, 6)
        if not np.isfinite(of_ranges).all():
            break
        steps = outline_steps(Scene(range_m, pose, rays, assumed, power))
        found = propagated(
            steps,
            of_ranges * whole,
            gradient_of(evidence.sums, 6) * whole,
            _held(pose, reach),
            sqrt(assumed.slack_m**2 + HALF_BEAM_RAD**2 / 3.0 * (pose.t**2).sum()),
        )
        if not np.isfinite(found.mean).all():
            break
        information = without_influential(of_ranges, evidence.rows) * whole + found.information
        step = found.mean
        pose = stepped(pose, step)
        converged = _farthest(steps, step) < straight_m
        if number > 0 and converged:
            break
    statistics = scan_statistics(range_m, pose.R, pose.t, rays, assumed)
    if statistics.agreement.log_likelihood < likelihood - CHANCE:
        pose, statistics = kept, scan_statistics(range_m, kept.R, kept.t, rays, assumed)
    faces = FaceFit(pose, information, squares, inliers)
    return ScanRegistration(pose, faces, information, statistics, converged)


@inlined_kernel
def _refined(
    problem: FaceProblem, start: PoseArrays, likelihood: float, range_m: FloatArray, assumed: Assumptions
) -> ScanRegistration:
    """Return ``refined`` from a start whose log likelihood is known; other arguments as for ``refined``."""
    found = aligned(problem, start, range_m, assumed)
    if likelihood <= found.statistics.agreement.log_likelihood:
        return found
    statistics = scan_statistics(range_m, start.R, start.t, _rays(problem), assumed)
    return ScanRegistration(start, found.faces, found.information, statistics, True)


@inlined_kernel
def _rays(problem: FaceProblem) -> Rays:
    """Return the rays of a problem with its target and its buffers."""
    buffers = problem.buffers
    return Rays(problem.grid, problem.faces, buffers.range_m, buffers.triangle)
