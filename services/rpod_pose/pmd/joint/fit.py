"""Joint least-squares fit of depth points and amplitude edges.

The unknowns are those of ``normal_equations``: (dtau, dtheta), and the bias, which is the length by which all
ranges of the frame are too long. The camera's wiggling causes such an error. Edges are free of it: if they
determine the range, they correct the depth; if not, the standard deviation of the bias enters the covariance.
"""

from typing import NamedTuple

import numpy as np

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.rays import GridArrays, RenderBuffers
from rpod_pose.pmd.joint.depth_points import Planes, add_depth_points
from rpod_pose.pmd.joint.edge_points import (
    LAST_SCALE,
    EdgeErrors,
    EdgeEvidence,
    add_edge_points,
    without_shift,
)
from rpod_pose.pmd.joint.expected_edges import EdgeSight
from rpod_pose.registration.distance_field import FieldArrays
from rpod_pose.registration.field_alignment import FieldEvidence, Points
from rpod_pose.registration.gauss_newton import Linear, State, linearises, minimised
from rpod_pose.registration.lie_group import PoseArrays
from rpod_pose.registration.normal_equations import (
    SUMS,
    UNKNOWNS,
    information_of,
    no_sums,
)
from rpod_pose.registration.surface_model import Faces, cast_faces
from rpod_schemas.arrays import FloatArray

REACH_M, REACH_RAD = 0.5, 0.2
"""Prior standard deviations of a step. Numerics: they matter only in directions that no residual observes."""


class DepthErrors(NamedTuple):
    """Assumed errors of the depth, m."""

    noise_m: float
    """Least standard deviation of a residual."""
    most_points: float
    """Largest number of residuals that count as independent, since neighbours share their errors."""
    bias_m: float
    """Standard deviation of the length by which all ranges are too long."""
    uneven_m: float
    """Standard deviation of range errors that differ across the target."""
    slack_m: float
    """Standard deviation of the model's own error, which also applies to edges."""
    white_m2: float = 0.0
    """Variance of the points' weighted mean caused by the frame's noise, times the sum of their weights."""
    spread_m2: float = 0.0
    """Expected weighted mean square of the points' residuals if the frame's noise is their only error."""


class JointProblem(NamedTuple):
    """Points and edges of a frame to be aligned with the target."""

    points: Points
    planes: Planes
    """Planes of the faces that the points' pixels show near the pose."""
    field: FieldArrays
    """Distance field of the target, for points without a plane."""
    sight: EdgeSight
    """Edges that the image should show, and the image."""
    depth_errors: DepthErrors
    edge_errors: EdgeErrors
    schedule: FloatArray
    """Geman-McClure scale of the points, m, and reach of the edges' search, px, by step, shape (S, 2)."""


def near_the_pose(problem: JointProblem, planes: Planes) -> JointProblem:
    """Return the problem of the last steps: distances from planes, and edges nearer to their exact places.

    In the steps before, an edge displaced by less than ``ALIASED_PX`` counts as in place. Its displacement
    depends on the brightness fitted at the pose, and leads to a false minimum from a pose beside the truth.
    """
    errors = problem.edge_errors._replace(scale=LAST_SCALE, aliased_px=0.0)
    return problem._replace(planes=planes, edge_errors=errors)


class JointEvidence(NamedTuple):
    """Statistics of points and edges."""

    points: FieldEvidence
    edges: EdgeEvidence
    parts: FloatArray
    """Normal equations of points and edges for three kinds of errors, shape (3, 35). Each is multiplied by
    the variance of that kind over the assumed variance: the frame's noise; the sensor's calibration, and the
    excess of the points' residuals; the excess of the edges' residuals."""
    beside: FloatArray
    """Gradient for the shift of edges beside saturated pixels, as ``Shifted``, shape (6,)."""
    every: FloatArray
    """Gradient for a shift of all edges, as ``Shifted``, shape (6,)."""


class JointFit(NamedTuple):
    """A pose aligned with a frame."""

    state: State
    information: FloatArray
    """Information matrix of (dtau, dtheta, bias) in the last step, shape (7, 7)."""
    evidence: JointEvidence
    """Statistics of the last step."""


class Shares(NamedTuple):
    """Weights of the residuals of a frame's points and edges: the inverse of their variances."""

    points: float
    """Weight of a point, 1/m2."""
    edges: float
    """Weight of a sample of an edge, 1/px2."""


@kernel
def _shares(problem: JointProblem, points: FieldEvidence, edges: EdgeEvidence, reach: float) -> Shares:
    """Return the weights of the sums over all points and all edges."""
    depth, edge_errors = problem.depth_errors, problem.edge_errors
    of_points, of_edges = 0.0, 0.0
    if points.inliers > 0:
        squares, weight = points.squares_m2, points.trusted
        variance = max(squares / weight, depth.noise_m**2) / min(depth.most_points, weight)
        of_points = 1.0 / (weight * (variance + depth.uneven_m**2 + depth.slack_m**2))
    if edges.inliers > 0:
        variance = max(edges.squares_px2 / edges.inliers, edge_errors.noise_px**2)
        variance /= min(edge_errors.most_edges, edge_errors.independent * edges.inliers)
        widened = (reach / edge_errors.reach_px) ** 4
        of_edges = 1.0 / (edges.inliers * widened * (variance + (depth.slack_m * edge_errors.px_per_m) ** 2))
    return Shares(of_points, of_edges)


@kernel
def joint_shares(problem: JointProblem, state: State) -> Shares:
    """Return the weights of points and edges in the last step of a problem, at a pose."""
    scale, reach = problem.schedule[-1]
    points = add_depth_points(no_sums(), problem.points, problem.planes, state, problem.field, scale)
    edges = add_edge_points(no_sums(), problem.sight, state.pose, reach, problem.edge_errors, False)
    return _shares(problem, points, edges, reach)


@kernel
def cell_information(problem: JointProblem, state: State, shares: Shares) -> FloatArray:
    """Return the second derivatives of the loss of some points and edges, weighted as all are, (7, 7)."""
    scale, reach = problem.schedule[-1]
    sums, of_edges = no_sums(), no_sums()
    add_depth_points(sums, problem.points, problem.planes, state, problem.field, scale)
    edges = add_edge_points(of_edges, problem.sight, state.pose, reach, problem.edge_errors)
    return information_of(shares.points * sums + shares.edges * (of_edges - edges.sums.bend), UNKNOWNS)


@linearises(JointProblem)
@inner_kernel
def joint_equations(problem: JointProblem, state: State, step: int) -> Linear[JointEvidence]:
    """Return the normal equations of points and edges, each weighted by the variance of its residuals.

    The sums of the points are divided by their total weight and by the variance of their mean, so that they
    count as at most ``most_points`` independent points. The sums of the edges are treated in the same way,
    with a smaller weight while the search is wide. The bias has a prior of its own.
    """
    depth, pose = problem.depth_errors, state.pose
    scale, reach = problem.schedule[step]
    of_points, of_edges, hold = no_sums(), no_sums(), np.zeros(UNKNOWNS)
    points = add_depth_points(of_points, problem.points, problem.planes, state, problem.field, scale)
    is_last = step + 1 >= problem.schedule.shape[0]
    edges = add_edge_points(of_edges, problem.sight, pose, reach, problem.edge_errors, is_last)
    if not (is_last or np.isfinite(of_edges).all()):  # no further step is made
        edges = add_edge_points(no_sums(), problem.sight, pose, reach, problem.edge_errors)
    shares = _shares(problem, points, edges, reach)
    of_points, of_edges = shares.points * of_points, shares.edges * of_edges
    shifted = without_shift(of_edges, edges.sums, shares.edges)
    parts = np.zeros((3, SUMS))
    if points.inliers > 0:
        per_variance = shares.points * points.trusted
        excess = max(0.0, points.squares_m2 / points.trusted - depth.spread_m2)
        parts[0] += per_variance * depth.white_m2 / points.trusted * of_points
        excess /= min(depth.most_points, points.trusted)
        parts[1] += per_variance * (depth.uneven_m**2 + excess) * of_points
    if edges.inliers > 0:
        per_variance = shares.edges * edges.inliers
        excess = max(0.0, edges.squares_px2 - edges.noise_px2) / edges.inliers
        independent = problem.edge_errors.independent * edges.inliers
        excess /= min(problem.edge_errors.most_edges, independent)
        parts[0] += per_variance * edges.sums.white_px2 / independent * shifted.noisy
        parts[2] += per_variance * excess * shifted.noisy
    total = of_points + of_edges
    total[SUMS - 2] += 1.0 / depth.bias_m**2
    total[SUMS - 1] += state.bias_m / depth.bias_m**2
    hold[:3] = REACH_M**-2
    hold[3:6] = REACH_RAD**-2
    return Linear(total, hold, True, JointEvidence(points, edges, parts, shifted.beside, shifted.every))


@kernel
def align(problem: JointProblem, start: State) -> JointFit:
    """Return the pose after one step for each row of the problem's schedule."""
    fit = minimised(problem, start, problem.schedule.shape[0])
    return JointFit(fit.state, information_of(fit.linear.sums, UNKNOWNS), fit.linear.evidence)


class Measured(NamedTuple):
    """Ranges of the coarse pixels, and their tolerances."""

    range_m: FloatArray
    """Range, shape (rows, columns), NaN without one."""
    sigma_m: FloatArray
    """Standard deviation of their noise, same shape."""
    tolerance_m: float
    """Least tolerance of a range; the tolerance is twice the noise of the range if that is larger."""
    missing: float
    """Weight of a pixel that shows the target in the rendering and has no range."""


@kernel
def agreement(
    measured: Measured, grid: GridArrays, faces: Faces, pose: PoseArrays, buffers: RenderBuffers
) -> tuple[float, float]:
    """Return the total weight of the coarse pixels that agree with a pose, and that of all checked pixels.

    Args:
        measured: the frame.
        grid: rays of the coarse pixels.
        faces: the target.
        pose: its pose.
        buffers: output, the target rendered at the pose.
    """
    range_m, owner = buffers
    cast_faces(grid, faces, pose.R, pose.t, buffers)
    agreeing, checked = 0.0, 0.0
    for i in range(range_m.shape[0]):
        for j in range(range_m.shape[1]):
            m = measured.range_m[i, j]
            if np.isnan(m):
                checked += measured.missing if owner[i, j] >= 0 else 0.0
                continue
            checked += 1.0
            tolerance = max(measured.tolerance_m, 2.0 * measured.sigma_m[i, j])
            if owner[i, j] >= 0 and abs(m - range_m[i, j]) < tolerance:
                agreeing += 1.0
    return agreeing, checked
