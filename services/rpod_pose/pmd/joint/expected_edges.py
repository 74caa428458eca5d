"""The edges that a rendering of the target shows, and the place at which it shows each.

A model's edge is not always an edge of the image. It may be hidden, its faces may be equally bright, and
edges less than a pixel apart merge into one. Therefore the target is rendered at the pose on the camera's own
pixels, as a Lambertian body lit from the camera with the albedo of its classes (``brightness``), and smoothed
like the image. The steepest change of the rendering beside an edge is the place at which the image should
show that edge: both places are found by the same search (``steepest``), so that neighbours shift both alike.

A user knows materials only roughly. If the logarithm of the change has a standard deviation s, then the
probability that the image shows more than the least change that counts is Phi(ln(change / least) / s). s
contains the spread of the albedo's logarithm and the noise of the image. An edge that the rendering does not
show is searched in its geometric place, since its faces may differ more than their classes do; but it is not
expected, so it proves nothing if it is missing.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_geometry.rays import GridArrays, RenderBuffers, cast_pose
from rpod_pose.pmd.joint.edge_search import (
    EdgeArrays,
    Lens,
    Patch,
    Profile,
    across_edge,
    imaged,
    steepest,
)
from rpod_pose.registration.brightness import albedos
from rpod_pose.registration.lie_group import PoseArrays, in_sensor, in_target
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array
from rpod_target import Target

NEAR_M = 0.05
"""Least z of a sample that is projected."""
OWN_PX = 1.0
"""Greatest distance of a change of the rendering that still belongs to the edge: a pixel's width."""
ALIASED_PX = 0.25
"""Displacement below which an edge lies on itself: rays half a pixel apart show it no better."""
CELL_PX = 1
"""Side of the cells of the image in which one edge of each direction counts: closer ones are one change."""
DIRECTIONS = 4
"""Number of directions of edges that are told apart in a cell."""
LEAST_RATIO = 0.3
"""Least change of a rendering over the least change that counts: a fainter one says nothing of the place."""
TYPICAL_SAMPLES = 1000
"""Number of pixels from which the rendering's median brightness is estimated."""
BLUR_REACH = 3
"""Half length of the smoothing's kernel, px."""


def blur_weights(deviation_px: float) -> FloatArray:
    """Return the weights of a Gaussian smoothing, shape (2 * BLUR_REACH + 1,)."""
    return np.asarray(cv2.getGaussianKernel(2 * BLUR_REACH + 1, deviation_px), np.float64).ravel()


class Appearance(NamedTuple):
    """The target as its rendering needs it."""

    triangles_m: FloatArray
    """Corners, target axes, shape (T, 3, 3)."""
    normals: FloatArray
    """Outward unit normals, target axes, shape (T, 3)."""
    albedo: FloatArray
    """Median albedo of each triangle's class, shape (T,)."""
    radius_m: float
    """Radius of the bounding sphere about the origin."""

    @classmethod
    def of(cls, target: Target) -> "Appearance":
        """Return the appearance of a target."""
        triangles_m, normals = (np.ascontiguousarray(part) for part in (target.triangles_m, target.normals))
        return cls(triangles_m, normals, albedos(target), target.radius_m)


class Fine(NamedTuple):
    """The camera's own pixels around the target, and the buffers of a rendering on them."""

    grid: GridArrays
    """Rays of the patch's pixels, shape (per_px * rows, per_px * columns)."""
    per_px: int
    """Number of rays for each pixel, along rows and columns."""
    hits: RenderBuffers
    """First hits, same shape."""
    shade: Float32Array
    """Smoothed brightness, shape (rows, columns)."""
    blur: FloatArray
    """Weights of the smoothing, shape (2 * BLUR_REACH + 1,)."""
    clip: float
    """Brightness at which the rendering is clipped, over its median, as in the image."""


class ExpectedEdges(NamedTuple):
    """Samples that the image may show."""

    pose: FloatArray
    """R and t of the rendering, shape (4, 3); NaN before the first."""
    length: NDArray[np.int64]
    """Their number, shape (1,)."""
    sample: NDArray[np.int64]
    """Their indices in the model, shape (N,); the first ``length`` are valid, as below."""
    place: FloatArray
    """Distance from the projected edge to the rendering's change, along the profile, px, shape (N,)."""
    probability: FloatArray
    """Probability that the image shows the change, shape (N,)."""
    change: FloatArray
    """Expected change of amplitude over two pixels, shape (N,)."""

    @classmethod
    def room(cls, samples: int) -> "ExpectedEdges":
        """Return room for a model's samples."""
        numbers = (np.empty(samples) for _ in range(3))
        return cls(np.full((4, 3), np.nan), np.zeros(1, np.int64), np.empty(samples, np.int64), *numbers)


class EdgeSight(NamedTuple):
    """Edges and the image in which they are searched."""

    edges: EdgeArrays
    lens: Lens
    patch: Patch
    expected: ExpectedEdges
    """The samples that the image may show, by a rendering near the pose."""
    noise_px: float
    """Standard deviation of an edge's position in the image."""


@kernel
def expect_edges(sight: EdgeSight, pose: PoseArrays, appearance: Appearance, fine: Fine) -> None:
    """Render the target at a pose and fill ``sight.expected`` with the samples that it does not hide.

    Args:
        sight: edges, image and lens; the expected edges are output.
        pose: pose of the target.
        appearance: the target.
        fine: pixels of the patch; input and output.
    """
    edges, lens, patch, expected = sight.edges, sight.lens, sight.patch, sight.expected
    expected.length[0] = 0
    expected.pose[:3], expected.pose[3] = pose.R, pose.t
    rows, columns = fine.shade.shape
    if min(rows, columns) <= 2 * BLUR_REACH or patch.typical <= 0.0:
        return
    typical = rendered(appearance, pose, fine)
    if typical <= 0.0:
        return
    taken = np.zeros((rows // CELL_PX + 1, columns // CELL_PX + 1, DIRECTIONS), np.bool_)
    gain, count = patch.typical / typical, 0
    faintest = LEAST_RATIO * patch.least / gain
    R, t = pose
    sensor = in_target(R, -t[0], -t[1], -t[2])
    for n in range(len(edges.places_m)):
        spread = seen_spread(edges, n, sensor)
        if spread < 0.0:
            continue
        x, y, z = in_sensor(R, edges.places_m[n, 0], edges.places_m[n, 1], edges.places_m[n, 2])
        x, y, z = x + t[0], y + t[1], z + t[2]
        if z < NEAR_M:
            continue
        at = imaged(x / z, y / z, lens)
        u, v = at.column - patch.column, at.row - patch.row
        if not (0.0 <= v < rows - 1 and 0.0 <= u < columns - 1):  # also true for NaN and beyond integers
            continue
        i, j = int(v), int(u)
        pixel_m = (1.0 + 1.0 / lens.fx) * nearby_m(fine, i, j)
        if math.sqrt(x * x + y * y + z * z) > pixel_m:  # a pixel's width behind all four
            continue
        towards = in_sensor(R, edges.directions[n, 0], edges.directions[n, 1], edges.directions[n, 2])
        across, down = across_edge(at, towards, x / z, y / z)
        way = int(DIRECTIONS * (math.atan2(down, across) / math.pi + 1.0)) % DIRECTIONS
        cell = (i // CELL_PX, j // CELL_PX, way)
        if taken[cell]:
            continue
        taken[cell] = True
        shown = steepest(fine.shade, Profile(u, v, across, down), OWN_PX, faintest)
        own = shown.change > 0.0 and abs(shown.place) <= OWN_PX
        change = gain * shown.change if own else LEAST_RATIO * patch.least
        deviation = math.hypot(spread, patch.noise / change)
        expected.sample[count] = n
        expected.place[count] = shown.place if own and abs(shown.place) > ALIASED_PX else 0.0
        expected.probability[count] = 0.5 * math.erfc(
            math.log(patch.least / change) / math.sqrt(2.0) / deviation
        )
        expected.change[count] = change
        count += 1
    expected.length[0] = count


@kernel
def moved_px(sight: EdgeSight, pose: PoseArrays, radius_m: float) -> float:
    """Return how far a target has moved in the image since its rendering, px; NaN before the first."""
    before, t = sight.expected.pose, pose.t
    turned = np.sqrt(np.square(pose.R - before[:3]).sum() / 2.0)  # 2 sin(angle / 2)
    shifted_m = np.sqrt(np.square(t - before[3]).sum())
    return float(sight.lens.fx * (shifted_m + turned * radius_m) / max(t[2], NEAR_M))


@kernel
def nearby_m(fine: Fine, i: int, j: int) -> float:
    """Return the greatest range, m, of four pixels from row i and column j on; inf for sky."""
    n = fine.per_px
    return float(fine.hits.range_m[n * i : n * (i + 2), n * j : n * (j + 2)].max())


@kernel
def seen_spread(edges: EdgeArrays, sample: int, sensor: tuple[float, float, float]) -> float:
    """Return the larger spread of the faces beside a sample that are turned to the sensor; -1 if none is.

    Args:
        edges: the model's samples.
        sample: index of the sample.
        sensor: position of the sensor, target axes, m.
    """
    x, y, z = edges.places_m[sample]
    towards, spread = (sensor[0] - x, sensor[1] - y, sensor[2] - z), -1.0
    for side in range(2):
        a, b, c = edges.normals[sample, side]
        if a * towards[0] + b * towards[1] + c * towards[2] > 0.0:
            spread = max(spread, edges.spreads[sample, side])
    return spread


@kernel
def rendered(appearance: Appearance, pose: PoseArrays, fine: Fine) -> float:
    """Render the target's smoothed brightness at a pose; return its median, 0 if nothing is in view."""
    hits = fine.hits
    cast_pose(fine.grid, appearance.triangles_m, pose.R, pose.t, True, hits.range_m, hits.triangle)
    typical = shaded(appearance, pose, fine)
    smoothed(fine)
    return typical


@kernel
def shaded(appearance: Appearance, pose: PoseArrays, fine: Fine) -> float:
    """Fill the brightness of a rendering, clipped; return its median before clipping, 0 if it is empty.

    Lambert's law with light from the camera: albedo times the cosine of incidence over the squared range, in
    the middle of each triangle. Within a triangle it changes slowly, so that it makes no edges.

    Args:
        appearance: the target.
        pose: pose of the target.
        fine: the rendering; input and output.
    """
    shade, triangle, per_px = fine.shade, fine.hits.triangle, fine.per_px
    rows, columns = shade.shape
    light = np.zeros(len(appearance.albedo) + 1, np.float32)  # the last, index -1, is that of the sky
    sx, sy, sz = in_target(pose.R, -pose.t[0], -pose.t[1], -pose.t[2])
    for k in range(len(appearance.albedo)):
        corners, normal = appearance.triangles_m[k], appearance.normals[k]
        x = sx - (corners[0, 0] + corners[1, 0] + corners[2, 0]) / 3.0
        y = sy - (corners[0, 1] + corners[1, 1] + corners[2, 1]) / 3.0
        z = sz - (corners[0, 2] + corners[1, 2] + corners[2, 2]) / 3.0
        squares = x * x + y * y + z * z
        cosine = abs(normal[0] * x + normal[1] * y + normal[2] * z) / math.sqrt(squares)
        light[k] = appearance.albedo[k] * cosine / (squares * per_px * per_px)
    for i in range(rows):
        for j in range(columns):
            total = np.float32(0.0)
            for v in range(per_px * i, per_px * (i + 1)):
                for u in range(per_px * j, per_px * (j + 1)):
                    total += light[triangle[v, u]]
            shade[i, j] = total
    step = rows * columns // TYPICAL_SAMPLES + 1
    few, count = np.empty(rows * columns // step + 1), 0
    for pixel in range(0, rows * columns, step):
        here = shade[pixel // columns, pixel % columns]
        if here > 0.0:
            few[count] = here
            count += 1
    typical = float(np.median(few[:count])) if count else 0.0
    most = np.float32(fine.clip * typical)
    for i in range(rows):
        for j in range(columns):
            shade[i, j] = min(shade[i, j], most)
    return typical


@kernel
def smoothed(fine: Fine) -> None:
    """Smooth the brightness in place along rows, then along columns; a border stays as it is."""
    shade, weights = fine.shade, fine.blur.astype(np.float32)
    rows, columns = shade.shape
    line = np.empty_like(shade)
    for i in range(rows):
        for j in range(columns):
            line[i, j] = shade[i, j]
        for j in range(BLUR_REACH, columns - BLUR_REACH):
            total = np.float32(0.0)
            for k in range(2 * BLUR_REACH + 1):
                total += weights[k] * shade[i, j + k - BLUR_REACH]
            line[i, j] = total
    for i in range(BLUR_REACH, rows - BLUR_REACH):
        for j in range(columns):
            shade[i, j] = 0.0
        for k in range(2 * BLUR_REACH + 1):
            weight = weights[k]
            for j in range(columns):
                shade[i, j] += weight * line[i + k - BLUR_REACH, j]
