"""Registration of a scan in one call: alignment with the target, and how well the pose explains the scan.

Python takes about a microsecond for each array that it gives to a kernel. These kernels therefore do in one
call what belongs together.
"""

from typing import NamedTuple

from rpod_geometry.kernels import kernel
from rpod_pose.lidar.scan_alignment import FaceFit, FaceProblem, face_aligned
from rpod_pose.lidar.scan_likelihood import (
    Assumptions,
    Rays,
    ScanStatistics,
    scan_agreement,
    scan_statistics,
)
from rpod_pose.registration.field_alignment import FieldProblem, field_aligned
from rpod_pose.registration.lie_group import PoseArrays
from rpod_schemas.arrays import FloatArray


class ScanRegistration(NamedTuple):
    """A registered scan."""

    pose: PoseArrays
    """Pose of the target in the sensor."""
    faces: FaceFit
    """Alignment with the faces; its pose is another one if it was refused."""
    statistics: ScanStatistics
    """Statistics of the scan at the pose."""


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
    return ScanRegistration(fit.pose, fit, statistics)


@kernel
def refined(
    problem: FaceProblem, start: PoseArrays, range_m: FloatArray, assumed: Assumptions
) -> ScanRegistration:
    """Return ``aligned``, with the start as the pose if that explains the scan better.

    The faces alone may move a pose that agrees with the outline away from it.
    """
    at_start = scan_agreement(range_m, start.R, start.t, _rays(problem), assumed)
    return _refined(problem, start, at_start.log_likelihood, range_m, assumed)


@kernel
def tracked(  # noqa: PLR0917
    far: FieldProblem,
    problem: FaceProblem,
    start: PoseArrays,
    range_m: FloatArray,
    assumed: Assumptions,
    near_share: float,
) -> ScanRegistration:
    """Return ``refined`` from a predicted pose; if it is far off, it is aligned in the distance field first.

    Args:
        far: some of the returns, the target's distance field, and the scales of the first steps.
        problem: all returns and the target.
        start: predicted pose of the target in the sensor.
        range_m: measured range of each ray, 0 without a return, shape (rows, columns).
        assumed: statistics of returns.
        near_share: share of agreeing rays from which the prediction counts as close.
    """
    likelihood, agreeing, inconsistent, missing = scan_agreement(
        range_m, start.R, start.t, _rays(problem), assumed
    )
    if agreeing < near_share * (agreeing + inconsistent + missing):
        start = field_aligned(far.points, start, far.field, far.scales_m)
        return refined(problem, start, range_m, assumed)
    return _refined(problem, start, likelihood, range_m, assumed)


@kernel
def _refined(
    problem: FaceProblem, start: PoseArrays, likelihood: float, range_m: FloatArray, assumed: Assumptions
) -> ScanRegistration:
    """Return ``refined`` from a start whose log likelihood is known."""
    found = aligned(problem, start, range_m, assumed)
    if likelihood <= found.statistics.agreement.log_likelihood:
        return found
    statistics = scan_statistics(range_m, start.R, start.t, _rays(problem), assumed)
    return ScanRegistration(start, found.faces, statistics)


@kernel
def _rays(problem: FaceProblem) -> Rays:
    """Return the rays of a problem with its target and its buffers."""
    buffers = problem.buffers
    return Rays(problem.grid, problem.faces, buffers.range_m, buffers.triangle)
