"""The edges that a rendering of the target shows, with the place and the probability of each.

An edge of the model is not always an edge of the image. It may be hidden, its faces may be equally bright,
and edges less than a pixel apart merge into one. Therefore the target is rendered at the pose on the camera's
own pixels, as a Lambertian body lit from the camera with the albedo of its classes (``brightness``), and is
smoothed like the image. The image should show an edge where the rendering has its steepest change beside this
edge. Both places are found by the same search (``steepest``), so that neighbours shift both in the same way.
How far a neighbour shifts an edge depends on which of them is brighter. Therefore the brightness of each
surface is fitted to the image first (``brightness_fit.fitted``).

A user knows materials only roughly. If the logarithm of the change has a standard deviation s, then the
probability that the image shows more than the least change that counts is Phi(ln(change / least) / s). s
contains the spread of the albedo's logarithm, and the noise of the image over the least change, which matters
for changes near the least one. An edge that the rendering does not show is searched in its geometric place,
since its faces may differ more than their classes do. But its probability is 0, so its absence proves
nothing.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_geometry.rays import NEAREST_M
from rpod_pose.pmd.joint.brightness.patch_renderer import PatchRenderer, Rendered, Shown
from rpod_pose.pmd.joint.edge_search import (
    EdgeArrays,
    Lens,
    Patch,
    Profile,
    across_edge,
    bilinear,
    imaged,
    steepest,
)
from rpod_pose.pmd.joint.frame import JointFrame
from rpod_pose.registration.lie_group import PoseArrays, in_sensor, in_target
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

STILL_PX = 0.5
"""Largest motion in the image after which a rendering is still valid. Physics: coarse rays that are half a
pixel apart show the same parts."""
ALIGNED_PX = 0.1
"""Largest motion in the image after which edges are in the places of a rendering. Physics: the spread of
clear edges at the true pose is 0.13 px."""
OWN_PX = 1.0
"""Largest distance between an edge and its change in the rendering. Physics: the width of a pixel."""
MERGED_PX = 1.7
"""Largest distance of two edges that are one change of the image. Physics: two steps under a normal blur have
one steepest place if they are nearer than twice its width, 1.6 px by the smoothing alone."""
ALIASED_PX = 0.25
"""Displacement of an edge that counts as 0 before the last steps. Physics: half of ``STILL_PX``; in a
rendering at a pose as far away, the displacement differs as much."""
DIRECTIONS = 4
"""Number of directions of edges that are distinguished in a pixel. Hand: they are 45 deg apart; edges that
are closer are one change."""
BEYOND_PX = 3.0
"""Distance from an edge at which the image shows what is beyond it, px. Physics: twice the standard deviation
of the smoothing, 1.6 px, and a pixel that mixes both."""
MOST_AT_FIRST = 1000
"""Approximate largest number of samples before the last steps of an alignment. Numerics: a budget of
computation, several times the number that may count as independent (``effective_edges``)."""
LEAST_RATIO = 0.3
"""Least change of a rendering over the least change that counts. Hand: a smaller one gives no place of the
edge."""


class ExpectedEdges(NamedTuple):
    """Samples of edges that the image may show; each array has the shape (N,)."""

    pose: PoseArrays
    """Pose of the rendering."""
    sample: NDArray[np.int64]
    """Indices of the samples in the model."""
    place: FloatArray
    """Distance along the profile from the projected edge to the rendering's change, px."""
    probability: FloatArray
    """Probability that the image shows the change; 0 if the rendering does not show it."""
    change: FloatArray
    """Expected change of amplitude over two pixels."""
    merged: NDArray[np.bool_]
    """Whether the rendering shows another edge so near that the image may show only that one."""
    before: NDArray[np.bool_]
    """Whether the edge is the target's outline before something bright."""

    def only(self, chosen: NDArray[np.bool_]) -> "ExpectedEdges":
        """Return the samples that a mask, shape (N,), selects."""
        return ExpectedEdges(
            self.pose,
            self.sample[chosen],
            self.place[chosen],
            self.probability[chosen],
            self.change[chosen],
            self.merged[chosen],
            self.before[chosen],
        )


class EdgeSight(NamedTuple):
    """The edges that one image should show at a pose, and the image."""

    edges: EdgeArrays
    lens: Lens
    patch: Patch
    expected: ExpectedEdges
    """The samples that the image may show, by a rendering near the pose."""
    every: int = 1
    """Distance of two samples along an edge, over that of the model's samples."""


@kernel
def expect_edges(edges: EdgeArrays, lens: Lens, patch: Patch, shown: Shown) -> ExpectedEdges:
    """Return the samples of edges that are visible in a rendering.

    Args:
        edges: the model's samples.
        lens: the camera.
        patch: the image around the target.
        shown: the target rendered on the patch's pixels.
    """
    shade, fitted_shade, window, (R, t) = shown.shade, shown.fitted, shown.window, shown.pose
    (rows, columns), range_m, per_px = patch.image.shape, shown.range_m, shown.per_px
    most = len(edges.places_m) if shown.typical > 0.0 and patch.typical > 0.0 else 0
    sample, count = np.empty(most, np.int64), 0
    merged, before = np.zeros(most, np.bool_), np.zeros(most, np.bool_)
    place, probability, contrast = np.empty(most), np.empty(most), np.empty(most)
    taken = np.zeros((rows, columns, DIRECTIONS), np.bool_)
    gain = patch.typical / shown.typical if most else 1.0
    least, faintest = LEAST_RATIO * patch.least, LEAST_RATIO * patch.least / gain
    sensor = in_target(R, -t[0], -t[1], -t[2])
    for n in range(most):
        spread = seen_spread(edges, n, sensor)
        if spread < 0.0:
            continue
        x, y, z = in_sensor(R, edges.places_m[n, 0], edges.places_m[n, 1], edges.places_m[n, 2])
        x, y, z = x + t[0], y + t[1], z + t[2]
        if z < NEAREST_M:
            continue
        at = imaged(x / z, y / z, lens)
        u, v = at.column - patch.column, at.row - patch.row
        if not (0.0 <= v < rows - 1 and 0.0 <= u < columns - 1):  # also for NaN
            continue
        i, j = int(v), int(u)
        if math.sqrt(x * x + y * y + z * z) > (1.0 + 1.0 / lens.fx) * nearby_m(range_m, per_px, i, j):
            continue
        towards = in_sensor(R, edges.directions[n, 0], edges.directions[n, 1], edges.directions[n, 2])
        across, down = across_edge(at, towards, x / z, y / z)
        way = int(DIRECTIONS * (math.atan2(down, across) / math.pi + 1.0)) % DIRECTIONS
        if taken[i, j, way]:
            continue
        profile = Profile(u - window.column, v - window.row, across, down)
        change, _ = own_change(shade, profile, faintest)
        fitted_change, shift = own_change(fitted_shade, profile, least)
        before[count] = is_before_bright(patch, shown, Profile(u, v, across, down))
        sample[count], place[count] = n, shift
        contrast[count] = gain * change if change else least
        shown_by = shown_probability(contrast[count], spread, patch.noise, patch.least)
        probability[count] = shown_by if change else 0.0
        merged[count] = not fitted_change and steepest(fitted_shade, profile, MERGED_PX, least).change > 0.0
        taken[i, j, way], count = True, count + 1
    return ExpectedEdges(
        shown.pose,
        sample[:count],
        place[:count],
        probability[:count],
        contrast[:count],
        merged[:count],
        before[:count],
    )


@inlined_kernel
def own_change(shade: Float32Array, profile: Profile, least: float) -> tuple[float, float]:
    """Return the change of a rendering that belongs to an edge, and its place, px; 0, 0 if there is none.

    Args:
        shade: the rendering, shape (rows, columns).
        profile: line across the edge.
        least: least change that counts.
    """
    found = steepest(shade, profile, OWN_PX, least)
    own = found.change > 0.0 and abs(found.place) <= OWN_PX
    return (found.change, found.place) if own else (0.0, 0.0)


@inner_kernel
def is_before_bright(patch: Patch, shown: Shown, profile: Profile) -> bool:
    """Return whether the target ends at an edge, and the image is bright beyond it.

    Args:
        patch: the image.
        shown: the target rendered on the patch's pixels.
        profile: line across the edge, in the patch.
    """
    if not patch.unranged.size:
        return False
    rows, columns = patch.image.shape
    for side in (-1.0, 1.0):
        u = profile.column + side * BEYOND_PX * profile.across
        v = profile.row + side * BEYOND_PX * profile.down
        if not (0.0 <= v < rows - 1 and 0.0 <= u < columns - 1):
            continue
        n = shown.per_px
        if np.isfinite(shown.range_m[int(n * (v + 0.5)), int(n * (u + 0.5))]):
            continue
        if patch.unranged[int(v + 0.5), int(u + 0.5)] and bilinear(patch.image, u, v) > patch.least:
            return True
    return False


@kernel
def shown_probability(change: float, spread: float, noise: float, least: float) -> float:
    """Return the probability that an image shows a change.

    Args:
        change: expected change of amplitude over two pixels.
        spread: standard deviation of its logarithm caused by the materials.
        noise: standard deviation of a change in the image.
        least: least change that counts.
    """
    deviation = math.hypot(spread, noise / least)
    return 0.5 * math.erfc(math.log(least / change) / math.sqrt(2.0) / deviation)


@kernel
def add_in_place(in_place: FloatArray, share: float, is_found: bool) -> None:
    """Add an edge to the sums of ``EdgeEvidence.in_place``.

    The weight of an edge is the information that its absence would give: minus the logarithm of the
    probability that it is not found at the right pose.

    Args:
        in_place: sums, input and output, shape (3,).
        share: probability of finding the edge near its place at the right pose.
        is_found: whether it was found there.
    """
    weight = -math.log1p(-share)
    in_place[1] += weight * share
    in_place[2] += weight * weight * share
    if is_found:
        in_place[0] += weight


class Sights:
    """Predicts the edges that the image of one frame should show, and remembers the renderings.

    Args:
        edges: the model's samples.
        renderer: renders the target.
        frame: the frame.
    """

    def __init__(self, edges: EdgeArrays, renderer: PatchRenderer, frame: JointFrame) -> None:
        self._edges, self._renderer, self._frame = edges, renderer, frame
        self._rendered: list[Rendered] = []
        self._seen: dict[int, EdgeSight] = {}
        self._some: dict[int, EdgeSight] = {}
        self._every, self._some_edges = 1, edges

    def at(self, pose: PoseArrays) -> EdgeSight:
        """Return the edges at a pose, from an earlier rendering if its pose is near enough."""
        number = self._rendered_near(pose, STILL_PX)
        if number not in self._seen:
            self._seen[number] = self._edges_of(self._rendered[number].shown, self._edges)
            if len(self._seen) == 1:
                self._every = max(1, -(-len(self._seen[number].expected.sample) // MOST_AT_FIRST))
                self._some_edges = self._edges.thinned(self._every)
        return self._seen[number]

    def some_at(self, pose: PoseArrays) -> EdgeSight:
        """Return the edges at a pose by some of their samples, about ``MOST_AT_FIRST``."""
        if self._every == 1:
            return self.at(pose)
        number = self._rendered_near(pose, STILL_PX)
        if number not in self._some:
            sight = self._edges_of(self._rendered[number].shown, self._some_edges)
            self._some[number] = sight._replace(every=self._every)
        return self._some[number]

    def shown_at(self, pose: PoseArrays) -> Shown:
        """Return a rendering at a pose, or an earlier one whose pose is near enough."""
        return self._rendered[self._rendered_near(pose, STILL_PX)].shown

    def finally_at(self, pose: PoseArrays) -> EdgeSight:
        """Return the edges at an aligned pose, with a brightness that follows the image within surfaces.

        From a pose that is not aligned, displaced edges would be taken for changes of brightness.
        """
        rendered = self._rendered[self._rendered_near(pose, ALIGNED_PX)]
        return self._edges_of(self._renderer.followed(rendered, self._frame.patch), self._edges)

    def _rendered_near(self, pose: PoseArrays, most_px: float) -> int:
        """Return the number of a rendering that is at most a motion in the image away from a pose."""
        frame, radius_m = self._frame, self._renderer.radius_m
        moved = [frame.moved_px(rendered.shown.pose, pose, radius_m) for rendered in self._rendered]
        if moved and min(moved) < most_px:
            return int(np.argmin(moved))
        self._rendered.append(self._renderer.render(frame.rays, frame.per_px, pose, frame.patch))
        return len(moved)

    def _edges_of(self, shown: Shown, edges: EdgeArrays) -> EdgeSight:
        """Return those of some edges that a rendering shows."""
        lens, patch = self._frame.lens, self._frame.patch
        return EdgeSight(edges, lens, patch, expect_edges(edges, lens, patch, shown))

    def blank(self, pose: PoseArrays) -> EdgeSight:
        """Return a sight without edges at a pose, for uses that need only the depth; nothing is rendered."""
        none, no, frame = np.empty(0), np.empty(0, np.bool_), self._frame
        expected = ExpectedEdges(pose, np.empty(0, np.int64), none, none, none, no, no)
        return EdgeSight(self._edges, frame.lens, frame.patch, expected)


@inlined_kernel
def nearby_m(range_m: Float32Array, per_px: int, i: int, j: int) -> float:
    """Return the largest range, m, of the rays of 2 by 2 pixels from row i and column j on; inf for sky.

    Args:
        range_m: as in ``Shown``, shape (per_px * rows, per_px * columns).
        per_px: as in ``Shown``.
        i: row of the first pixel.
        j: its column.
    """
    most = np.float32(0.0)
    for v in range(per_px * i, per_px * (i + 2)):
        for u in range(per_px * j, per_px * (j + 2)):
            most = max(most, range_m[v, u])
    return float(most)


@inlined_kernel
def seen_spread(edges: EdgeArrays, sample: int, sensor: tuple[float, float, float]) -> float:
    """Return the larger spread of the faces beside a sample that face the sensor; -1 if none does.

    Args:
        edges: the model's samples.
        sample: index of the sample.
        sensor: position of the sensor, target axes, m.
    """
    places, normals, spread = edges.places_m, edges.normals, -1.0
    x, y, z = sensor[0] - places[sample, 0], sensor[1] - places[sample, 1], sensor[2] - places[sample, 2]
    for side in range(2):
        towards = normals[sample, side, 0] * x + normals[sample, side, 1] * y + normals[sample, side, 2] * z
        if towards > 0.0:
            spread = max(spread, edges.spreads[sample, side])
    return spread
