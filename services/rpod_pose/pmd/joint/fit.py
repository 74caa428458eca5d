"""Joint least-squares fit of depth points and amplitude edges.

The unknowns are those of ``normal_equations``: (dtau, dtheta), and the bias, which is the length by which all
ranges of the frame are too long. The camera's wiggling causes such an error. Edges are free of it: if they
determine the range, they correct the depth; if not, the standard deviation of the bias enters the covariance.
"""

import math
from typing import NamedTuple

import numpy as np

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.rays import GridArrays, RenderBuffers, cast_pose
from rpod_pose.pmd.joint.depth_points import Planes, add_depth_points
from rpod_pose.pmd.joint.edge_search import (
    Patch,
    Profile,
    across_edge,
    imaged,
    steepest,
)
from rpod_pose.pmd.joint.expected_edges import EdgeSight, add_in_place
from rpod_pose.registration.distance_field import FieldArrays
from rpod_pose.registration.field_alignment import FieldEvidence, Points
from rpod_pose.registration.gauss_newton import Linear, State, linearises, minimised
from rpod_pose.registration.lie_group import PoseArrays, Vector, in_sensor, in_target
from rpod_pose.registration.normal_equations import (
    SUMS,
    UNKNOWNS,
    add_residual,
    geman_mcclure,
    information_of,
    no_sums,
)
from rpod_schemas.arrays import FloatArray

REACH_M, REACH_RAD = 0.5, 0.2
"""Prior standard deviations of a step. Numerics: they matter only in directions that no residual observes."""
SCALE, LAST_SCALE = 0.2, 0.13
"""Geman-McClure scale of an edge's residual over the reach of its search, and that in the last steps. Hand:
a smaller value ignores displaced edges, a larger one follows wrong edges. The scale in the last steps is 0.4
px, three times the spread of clear edges at the true pose."""
BLUNTNESS_PX = 1.4
"""Standard deviation of an edge's position caused by noise, px, over the ratio of noise to change of
amplitude. Hand: about the width over which a change is blurred; expected errors are proportional to it."""
SHIFT_PX = 0.5
"""Standard deviation of the shift, towards the darker side, that all edges beside saturated pixels share.
Physics: a fully clipped change moves by the width of the lens's and the smoothing's blur, about a pixel."""


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


class EdgeErrors(NamedTuple):
    """Assumed errors of edges."""

    noise_px: float
    """Least standard deviation of an edge's position in the image."""
    most_edges: float
    """Largest number of samples that count as independent, since neighbours share their errors."""
    reach_px: float
    """Half length of the search in the last steps; edges have less weight while the search is longer."""
    scale: float = SCALE
    """Geman-McClure scale of a residual over the reach of the search."""
    px_per_m: float = 0.0
    """Motion in the image, px, per metre across the line of sight, at the depth of the visible points."""
    independent: float = 1.0
    """Share of the samples whose errors are independent; samples close in the image share their pixels."""
    merged: bool = True
    """Whether samples are used that the rendering merges with other edges."""


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
    """Return the problem of the last steps: distances from planes, and a narrower scale for edges."""
    return problem._replace(planes=planes, edge_errors=problem.edge_errors._replace(scale=LAST_SCALE))


class EdgeEvidence(NamedTuple):
    """Statistics of the edge samples."""

    squares_px2: float
    """Sum of the inliers' squared residuals."""
    inliers: int
    """Number of samples within the Geman-McClure scale."""
    checked: int
    """Number of samples whose place in the image could be searched."""
    found: int
    """Number of the checked samples that are near their place: within ``SCALE`` times the reach."""
    expected: float
    """Number of the checked samples that are expected near their place at the right pose."""
    in_place: FloatArray
    """Sum of the weights (``add_in_place``) of the found samples, its expectation at the right pose, and the
    expectation of the sum of squared weights, shape (3,)."""
    shifted: int
    """Number of inliers beside saturated pixels."""
    noise_px2: float
    """Sum of the variances of the inliers' positions caused by the image's noise."""
    shift: FloatArray
    """Normal equations of the inliers beside saturated pixels for residuals of one pixel towards the darker
    side, shape (35,)."""


class JointEvidence(NamedTuple):
    """Statistics of points and edges."""

    points: FieldEvidence
    edges: EdgeEvidence
    parts: FloatArray
    """Normal equations of points and edges for three kinds of errors, shape (3, 35). Each is multiplied by
    the variance of that kind over the assumed variance: the frame's noise; the sensor's calibration, and the
    excess of the points' residuals; the excess of the edges' residuals."""
    shift: FloatArray
    """Normal equations for a shift, of one standard deviation, that all edges beside saturated pixels share,
    shape (35,)."""


class JointFit(NamedTuple):
    """A pose aligned with a frame."""

    state: State
    information: FloatArray
    """Information matrix of (dtau, dtheta, bias) in the last step, shape (7, 7)."""
    evidence: JointEvidence
    """Statistics of the last step."""


@kernel
def add_edge_points(
    sums: FloatArray, sight: EdgeSight, pose: PoseArrays, reach: float, errors: EdgeErrors
) -> EdgeEvidence:
    """Add the factors of samples of edges, residuals in px, to the sums, shape (35,); return their evidence.

    The residual is the distance of the image's steepest change from that of the rendering, which moves with
    the projected edge. (a, d) is the unit vector across the edge in the image, U are the lens's derivatives
    with respect to the slopes s, and z is the sample's depth. A displacement x of the sample in sensor axes
    moves it across the edge by h . x with h = (g_x, g_y, -g . s) / z and g = (a, d) U. In target axes h is
    k = R^T h. So the residual -place has the normal -k.

    Args:
        sums: information and gradient, input and output.
        sight: edges of the model, expected edges, lens and image.
        pose: pose to linearise at.
        reach: half length of the search, px.
        errors: assumed errors of edges.
    """
    edges, lens, patch, expected_edges = sight
    (R, t), places, directions = pose, edges.places_m, edges.directions
    squares, inliers, checked, found, expected, shifted, noise_px2 = 0.0, 0, 0, 0, 0.0, 0, 0.0
    near2, c2, shift, in_place = (SCALE * reach) ** 2, (errors.scale * reach) ** 2, no_sums(), np.zeros(3)
    for m in range(len(expected_edges.sample)):
        if expected_edges.merged[m] and not errors.merged:
            continue
        n = expected_edges.sample[m]
        x, y, z = places[n, 0], places[n, 1], places[n, 2]
        px, py, pz = in_sensor(R, x, y, z)
        px, py, pz = px + t[0], py + t[1], pz + t[2]
        per_z = 1.0 / pz
        sx, sy = px * per_z, py * per_z
        at = imaged(sx, sy, lens)
        towards = in_sensor(R, directions[n, 0], directions[n, 1], directions[n, 2])
        across, down = across_edge(at, towards, sx, sy)
        if across == 0.0 and down == 0.0:
            continue
        shown = expected_edges.place[m]
        column, row = at.column - patch.column + shown * across, at.row - patch.row + shown * down
        place, change = steepest(patch.image, Profile(column, row, across, down), reach, patch.least)
        if change < 0.0:
            continue
        e2 = place * place
        checked += 1
        near = change > 0.0 and e2 < near2
        found += near
        noisy_px = BLUNTNESS_PX * patch.noise / max(expected_edges.change[m], change)
        share = expected_edges.probability[m] * share_within(SCALE * reach, errors.noise_px, noisy_px)
        expected += share
        add_in_place(in_place, share, near)
        if change == 0.0:
            continue
        gx = across * at.column_by_x + down * at.row_by_x
        gy = across * at.column_by_y + down * at.row_by_y
        kx, ky, kz = in_target(R, gx * per_z, gy * per_z, -(gx * sx + gy * sy) * per_z)
        add_residual(sums, Vector(-kx, -ky, -kz), Vector(x, y, z), -place, geman_mcclure(e2, c2))
        if e2 < c2:
            inliers += 1
            squares += e2
            noise_px2 += noisy_px**2
            darker = darker_side(patch, Profile(column, row, across, down), place)
            if darker != 0.0:
                shifted += 1
                weight = geman_mcclure(e2, c2)
                add_residual(shift, Vector(-kx, -ky, -kz), Vector(x, y, z), darker, weight)
    return EdgeEvidence(squares, inliers, checked, found, expected, in_place, shifted, noise_px2, shift)


@inner_kernel
def darker_side(patch: Patch, profile: Profile, place: float) -> float:
    """Return the darker side of an edge beside saturated pixels: -1 ahead, 1 behind, 0 for any other edge.

    Args:
        patch: the image.
        profile: line across the edge.
        place: place of the edge on it, px.
    """
    column, row, across, down = profile
    if not patch.saturated.size or not patch.saturated[int(row + place * down), int(column + place * across)]:
        return 0.0
    ahead = patch.image[int(row + (place + 2.0) * down), int(column + (place + 2.0) * across)]
    behind = patch.image[int(row + (place - 2.0) * down), int(column + (place - 2.0) * across)]
    return -1.0 if ahead < behind else 1.0


@inner_kernel
def share_within(reach: float, own: float, noisy: float) -> float:
    """Return the share of normal errors within +-``reach``, if their variance is own^2 + noisy^2."""
    return math.erf(reach / math.sqrt(2.0 * (own * own + noisy * noisy)))


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
        variance += (SHIFT_PX * edges.shifted / edges.inliers) ** 2
        of_edges = 1.0 / (edges.inliers * widened * (variance + (depth.slack_m * edge_errors.px_per_m) ** 2))
    return Shares(of_points, of_edges)


@kernel
def joint_shares(problem: JointProblem, state: State) -> Shares:
    """Return the weights of points and edges in the last step of a problem, at a pose."""
    scale, reach = problem.schedule[-1]
    points = add_depth_points(no_sums(), problem.points, problem.planes, state, problem.field, scale)
    edges = add_edge_points(no_sums(), problem.sight, state.pose, reach, problem.edge_errors)
    return _shares(problem, points, edges, reach)


@kernel
def cell_information(problem: JointProblem, state: State, shares: Shares) -> FloatArray:
    """Return the information of some points and edges, with the weights that all of them have, (7, 7)."""
    scale, reach = problem.schedule[-1]
    sums, of_edges = no_sums(), no_sums()
    add_depth_points(sums, problem.points, problem.planes, state, problem.field, scale)
    add_edge_points(of_edges, problem.sight, state.pose, reach, problem.edge_errors)
    return information_of(shares.points * sums + shares.edges * of_edges, UNKNOWNS)


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
    edges = add_edge_points(of_edges, problem.sight, pose, reach, problem.edge_errors)
    shares = _shares(problem, points, edges, reach)
    of_points, of_edges = shares.points * of_points, shares.edges * of_edges
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
        parts[0] += per_variance * edges.noise_px2 / (edges.inliers * independent) * of_edges
        parts[2] += per_variance * excess * of_edges
    total = of_points + of_edges
    total[SUMS - 2] += 1.0 / depth.bias_m**2
    total[SUMS - 1] += state.bias_m / depth.bias_m**2
    hold[:3] = REACH_M**-2
    hold[3:6] = REACH_RAD**-2
    return Linear(
        total, hold, True, JointEvidence(points, edges, parts, SHIFT_PX * shares.edges * edges.shift)
    )


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
    measured: Measured, grid: GridArrays, triangles: FloatArray, pose: PoseArrays, buffers: RenderBuffers
) -> tuple[float, float]:
    """Return the total weight of the coarse pixels that agree with a pose, and that of all checked pixels.

    Args:
        measured: the frame.
        grid: rays of the coarse pixels.
        triangles: triangles of the target, shape (T, 3, 3), m.
        pose: pose of the target.
        buffers: output, the target rendered at the pose.
    """
    range_m, owner = buffers
    cast_pose(grid, triangles, pose.R, pose.t, True, range_m, owner)
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
