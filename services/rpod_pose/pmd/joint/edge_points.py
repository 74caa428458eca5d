"""The factors of edges: residuals in the image, and shifts that edges share.

A smoothed image shows an edge beside saturated pixels too far on its darker side, by a length that all such
edges share. This shift is an unknown of the fit, which is eliminated from its normal equations. So these
edges lose the information that they have in common, and the others keep theirs.

The outline before something bright without ranges is shifted towards its brighter side: a pixel that mixes
both adds their phasors, so that its amplitude is smaller than the sum. The shift depends on brightness and
range, which differ from edge to edge, but not at random. So a part is shared, and a part is each edge's own.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_pose.pmd.joint.brightness.amplitude_noise import noise_of_place
from rpod_pose.pmd.joint.edge_search import Imaged, Lens, Profile, across_edge, imaged, steepest
from rpod_pose.pmd.joint.expected_edges import ALIASED_PX, EdgeSight, add_in_place
from rpod_pose.registration.lie_group import PoseArrays, Vector, in_sensor, in_target
from rpod_pose.registration.normal_equations import SUMS, add_residual, geman_mcclure, gradient_of
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd.joint import JointEdgeConfig
from rpod_schemas.types import Float32Array

SCALE, LAST_SCALE = 0.2, 0.13
"""Geman-McClure scale of an edge's residual over the reach of its search, and that in the last steps. Hand:
a smaller value ignores displaced edges, a larger one follows wrong edges. The scale in the last steps is 0.4
px, three times the spread of clear edges at the true pose."""
SHIFT_PX = 0.5
"""Standard deviation of the shift that edges beside saturated pixels, or before something bright, share.
Physics: a fully clipped change moves by the width of the lens's and the smoothing's blur, about a pixel.
Where opposite phasors mix, it moves by at most the standard deviation of the smoothing, 0.8 px."""


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
    place_noise: float = noise_of_place(JointEdgeConfig().blur_px)
    """Noise of an edge's position, px, times its change over the noise of the image (``noise_of_place``)."""
    px_per_m: float = 0.0
    """Motion in the image, px, per metre across the line of sight, at the depth of the visible points."""
    independent: float = 1.0
    """Share of the samples whose errors are independent; samples close in the image share their pixels."""
    merged: bool = True
    """Whether samples are used that the rendering merges with other edges."""
    aliased_px: float = ALIASED_PX
    """Displacement of an edge from its geometric place that counts as 0."""

    @classmethod
    def of(cls, config: JointEdgeConfig) -> "EdgeErrors":
        """Return the errors that a configuration assumes."""
        return cls(
            config.sigma_px,
            float(config.effective_edges),
            config.final_search_px,
            place_noise=noise_of_place(config.blur_px),
        )


class EdgeSums(NamedTuple):
    """Sums for shifts that edges share, towards their darker sides, for curvature and for noise."""

    beside: FloatArray
    """Normal equations of the inliers beside saturated pixels for residuals of one pixel, shape (35,)."""
    weight: float
    """Sum of the weights of these inliers."""
    pull: float
    """Sum of their weighted residuals, px."""
    every: FloatArray
    """Normal equations of all inliers for residuals of one pixel with the curvature of the loss as weight,
    shape (35,)."""
    bend: FloatArray
    """Normal equations of all samples with their weights less the curvature of the loss, shape (35,)."""
    white_px2: float
    """Mean of the weight times the variance of the position by the image's noise, with the weights."""


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
    sums: EdgeSums
    """What shifts that edges share, and noise, would do."""


@kernel
def add_edge_points(  # noqa: PLR0917
    sums: FloatArray,
    sight: EdgeSight,
    pose: PoseArrays,
    reach: float,
    errors: EdgeErrors,
    counted: bool = True,
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
        counted: whether all of the evidence is asked for. Otherwise ``expected``, ``in_place``,
            ``noise_px2`` and all of ``sums`` but ``beside`` and its sums are 0: a fit needs them in its
            last step only.
    """
    edges, lens, patch, expected_edges, _ = sight
    R, places, directions = pose.R, edges.places_m, edges.directions
    image, saturated, least = patch.image, patch.saturated, patch.least
    squares, inliers, checked, found, expected, shifted, noise_px2 = 0.0, 0, 0, 0, 0.0, 0, 0.0
    near2, c2, in_place = (SCALE * reach) ** 2, (errors.scale * reach) ** 2, np.zeros(3)
    more = _Growing(np.zeros(SUMS), np.zeros(SUMS), np.zeros(SUMS), np.zeros(4))
    for m in range(len(expected_edges.sample)):
        if expected_edges.merged[m] and not errors.merged:
            continue
        n = expected_edges.sample[m]
        seen = seen_edge(places, directions, n, pose, lens)
        at, across, down = seen.at, seen.across, seen.down
        if across == 0.0 and down == 0.0:
            continue
        shown = expected_edges.place[m] * (abs(expected_edges.place[m]) > errors.aliased_px)
        column, row = at.column - patch.column + shown * across, at.row - patch.row + shown * down
        line = Profile(column, row, across, down)
        place, change = steepest(image, line, reach, least)
        if change < 0.0:
            continue
        e2, checked = place * place, checked + 1
        near = change > 0.0 and e2 < near2
        found += near
        noisy_px = 0.0
        if counted:
            noisy_px = errors.place_noise * patch.noise / max(expected_edges.change[m], change)
            share = expected_edges.probability[m] * share_within(SCALE * reach, errors.noise_px, noisy_px)
            expected += share
            add_in_place(in_place, share, near)
        if change == 0.0:
            continue
        kx, ky, kz = _slope(R, seen)
        normal, at_m, before = Vector(-kx, -ky, -kz), _row(places, n), expected_edges.before[m]
        weight = geman_mcclure(e2, c2) / (1.0 + before * (SHIFT_PX / errors.noise_px) ** 2)
        add_residual(sums, normal, at_m, -place, weight)
        edge = SideEdge(normal, at_m, place, weight, before)
        curvature = _add_curvature(more, edge, noisy_px, c2) if counted else 0.0
        if e2 < c2:
            inliers, squares = inliers + 1, squares + e2
            noise_px2 += noisy_px**2
            shifted += _add_shifts(more, image, saturated, line, edge, curvature, counted)
    return EdgeEvidence(squares, inliers, checked, found, expected, in_place, shifted, noise_px2, _all(more))


class _Growing(NamedTuple):
    """The sums of ``EdgeSums`` while they grow."""

    beside: FloatArray
    """Inliers beside saturated pixels, shape (35,)."""
    every: FloatArray
    """All inliers with their curvatures, shape (35,)."""
    bend: FloatArray
    """All samples with their weights less their curvatures, shape (35,)."""
    shift: FloatArray
    """Weight and pull; sums of squared weights times variances, and of weights; shape (4,)."""


class SideEdge(NamedTuple):
    """An edge whose side is asked for."""

    normal: Vector
    """Normal of its residual, target axes, px/m."""
    at: Vector
    """Its place on the target, target axes, m."""
    place: float
    """Its place on the line across it, px."""
    weight: float
    """Weight of its residual."""
    before: bool
    """Whether it is an outline before something bright."""


class _SeenEdge(NamedTuple):
    """A sample of an edge, projected."""

    at: Imaged
    across: float
    down: float
    """Unit vector across the edge in the image; 0, 0 for an edge seen from its end."""
    x: float
    y: float
    """Slopes x / z and y / z."""
    per_z: float
    """One over z, 1/m."""


@inlined_kernel
def seen_edge(places: FloatArray, directions: FloatArray, n: int, pose: PoseArrays, lens: Lens) -> _SeenEdge:
    """Return a sample of an edge, projected.

    Args:
        places: as in ``EdgeArrays``, shape (N, 3).
        directions: as in ``EdgeArrays``, shape (N, 3).
        n: index of the sample.
        pose: pose of the target.
        lens: the camera.
    """
    (R, t), (px, py, pz) = pose, in_sensor(pose.R, places[n, 0], places[n, 1], places[n, 2])
    px, py, pz = px + t[0], py + t[1], pz + t[2]
    per_z = 1.0 / pz
    x, y = px * per_z, py * per_z
    at = imaged(x, y, lens)
    towards = in_sensor(R, directions[n, 0], directions[n, 1], directions[n, 2])
    across, down = across_edge(at, towards, x, y)
    return _SeenEdge(at, across, down, x, y, per_z)


@inlined_kernel
def _row(places: FloatArray, n: int) -> Vector:
    """Return one row of an array of places, shape (N, 3)."""
    return Vector(places[n, 0], places[n, 1], places[n, 2])


@inlined_kernel
def _slope(R: FloatArray, seen: _SeenEdge) -> Vector:
    """Return the motion across an edge, px, per metre of motion of its sample, target axes; R is (3, 3)."""
    at, across, down, per_z = seen.at, seen.across, seen.down, seen.per_z
    gx = across * at.column_by_x + down * at.row_by_x
    gy = across * at.column_by_y + down * at.row_by_y
    return in_target(R, gx * per_z, gy * per_z, -(gx * seen.x + gy * seen.y) * per_z)


@inlined_kernel
def _add_curvature(sums: _Growing, edge: SideEdge, noisy_px: float, scale2: float) -> float:
    """Add an edge to the sums of curvature and noise; return the second derivative of its loss.

    The loss of ``geman_mcclure`` with the weight w has the second derivative w (1 - 4 r^2 / (c^2 + r^2)).

    Args:
        sums: input and output.
        edge: the edge.
        noisy_px: standard deviation of its position by the image's noise.
        scale2: c^2, px^2.
    """
    e2 = edge.place * edge.place
    bent = 4.0 * edge.weight * e2 / (scale2 + e2)
    add_residual(sums.bend, edge.normal, edge.at, 0.0, bent)
    sums.shift[2] += (edge.weight * noisy_px) ** 2
    sums.shift[3] += edge.weight
    return edge.weight - bent


@inner_kernel
def _all(sums: _Growing) -> EdgeSums:
    """Return the sums of all samples."""
    weight, pull, white, weights = sums.shift
    white_px2 = white / weights if weights > 0.0 else 0.0
    return EdgeSums(sums.beside, weight, pull, sums.every, sums.bend, white_px2)


@inlined_kernel
def _add_shifts(  # noqa: PLR0917
    sums: _Growing,
    image: Float32Array,
    saturated: NDArray[np.uint8],
    line: Profile,
    edge: SideEdge,
    curvature: float,
    counted: bool,
) -> int:
    """Add an edge to the sums of the shifts; return 1 if it is one of those that share one, otherwise 0.

    Args:
        sums: input and output.
        image: the image, shape (rows, columns).
        saturated: mask as in ``Patch``, shape (rows, columns) or (0, 0).
        line: line across the edge.
        edge: the edge.
        curvature: second derivative of its loss.
        counted: whether it is added to the sums of all edges.
    """
    if not (counted or edge.before or saturated.size > 0):
        return 0
    darker, shared = darker_side(image, line, edge.place), 0
    if counted:
        add_residual(sums.every, edge.normal, edge.at, darker, curvature)
    if edge.before or is_beside_saturated(saturated, line, edge.place):
        add_residual(sums.beside, edge.normal, edge.at, darker, edge.weight)
        sums.shift[0] += edge.weight
        sums.shift[1] -= edge.weight * darker * edge.place
        shared = 1
    return shared


@inlined_kernel
def is_beside_saturated(saturated: NDArray[np.uint8], profile: Profile, place: float) -> bool:
    """Return whether an edge at a place on a line across it, px, is shifted by saturated pixels.

    Args:
        saturated: mask as in ``Patch``, shape (rows, columns) or (0, 0).
        profile: line across the edge.
        place: place of the edge on it, px.
    """
    if not saturated.size:
        return False
    row, column = int(profile.row + place * profile.down), int(profile.column + place * profile.across)
    return bool(saturated[row, column] > 0)


@inlined_kernel
def darker_side(image: Float32Array, profile: Profile, place: float) -> float:
    """Return the darker side of an edge: -1 ahead, 1 behind.

    Args:
        image: the image, shape (rows, columns).
        profile: line across the edge.
        place: place of the edge on it, px.
    """
    column, row, across, down = profile
    ahead = image[int(row + (place + 2.0) * down), int(column + (place + 2.0) * across)]
    behind = image[int(row + (place - 2.0) * down), int(column + (place - 2.0) * across)]
    return -1.0 if ahead < behind else 1.0


@inner_kernel
def share_within(reach: float, own: float, noisy: float) -> float:
    """Return the share of normal errors within +-``reach``, if their variance is own^2 + noisy^2."""
    return math.erf(reach / math.sqrt(2.0 * (own * own + noisy * noisy)))


class Shifted(NamedTuple):
    """Covariance and gradients of the errors of edges after the elimination of a shared shift."""

    noisy: FloatArray
    """Covariance of the gradient by noise of all edges, as sums, shape (35,)."""
    beside: FloatArray
    """Gradient for the part of the shift that the fit does not know, of one standard deviation, (6,)."""
    every: FloatArray
    """Gradient for a shift of all edges by one pixel towards their darker sides, shape (6,)."""


@inner_kernel
def without_shift(of_edges: FloatArray, shifts: EdgeSums, per_px2: float) -> Shifted:
    """Eliminate the shift of edges beside saturated pixels from the sums of the edges, in place.

    The shift d is an unknown with the prior N(0, ``SHIFT_PX``). With the column c of its products with the
    pose's unknowns, its own information s (that of the residuals, w, and the prior's) and its gradient b, the
    elimination leaves A - c c^T / s and g - c b / s (Schur complement). With k = c / s, noise of the edges
    causes the gradient g - k b, whose covariance is A - c k^T - k c^T + w k k^T.

    Args:
        of_edges: sums over all edges with their weight, shape (35,), input and output.
        shifts: sums of the shifts, with the weight 1.
        per_px2: weight of an edge, 1/px2.
    """
    noisy, every = of_edges.copy(), per_px2 * gradient_of(shifts.every, 6)
    column, own = per_px2 * gradient_of(shifts.beside, 6), per_px2 * shifts.weight
    known, entry = 1.0 / (own + SHIFT_PX**-2), 0
    for i in range(6):
        for j in range(i, 6):
            product = column[i] * column[j] * known
            of_edges[entry] -= product
            noisy[entry] -= product * (2.0 - own * known)
            entry += 1
        of_edges[entry] -= column[i] * known * per_px2 * shifts.pull
        entry += 1
    return Shifted(noisy, column * (known / SHIFT_PX), every - column * (known * own))
