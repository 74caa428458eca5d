"""Points of a frame's depth image, and their residuals: distances from the target's surface.

A point is the trimmed mean of nine pixels, and their scatter about a plane gives its noise.

The distance field needs no correspondence, so that a pose converges in it from afar. But its values are known
only on the nodes of a grid, and are trilinear between them. Around convex edges, and around parts that are
thinner than a cell, it is wrong by a share of a cell: it is positive on the surface itself. For a large
target and a close camera, this error is much larger than the noise of the ranges. Therefore a rendering near
the pose determines the face on which a pixel's ray ends. The residual is then the distance from the plane of
that face, which is exact (projective point to plane, G. Blais, M. D. Levine, IEEE PAMI 17, 1995).

At an outline a pixel may show another face than the rendering. The error of the field is at most one cell. So
if the distance from the plane exceeds that in the field by more than a cell, the plane is that of another
face. Such a point keeps the field's distance.
"""

import math
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_geometry.rays import NEAREST_M
from rpod_pose.pmd.depth_view import FARTHEST_M, variance_about_plane
from rpod_pose.pmd.joint.edge_search import CoarsePixels
from rpod_pose.registration.distance_field import FieldArrays
from rpod_pose.registration.field_alignment import FieldEvidence, Points, seen_sample
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import Vector, in_target
from rpod_pose.registration.normal_equations import add_range_bias, add_residual, geman_mcclure
from rpod_pose.registration.surface_model import Faces
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.types import Float32Array

OUTER = 4
"""Inverse of the share of sorted ranges that the trimmed mean leaves out at each end. Hand: two outliers
among nine ranges do no harm at either end."""
MIDDLE_OVER_MEAN = 1.06
"""Standard deviation of the trimmed mean over that of the mean of all ranges. Physics: with normal errors it
is 1.07 for nine ranges, and 1 for three, of which none is left out."""
FEWEST = 3
"""Least number of valid depths among nine. Hand: fewer are found on outlines and ghosts."""


class DepthImages(NamedTuple):
    """The images of a frame in the form that the kernel takes."""

    depth_m: Float32Array
    """z-depth, m, shape (height, width); NaN or 0 if a pixel has none."""
    amplitude: Array
    """Amplitude, same shape."""
    least: Float32Array
    """Least amplitude at which the depth of a pixel is used, same shape."""


class CoarseRanges(NamedTuple):
    """Measurements of the coarse pixels with their eight neighbours, each of shape (rows, columns)."""

    range_m: FloatArray
    """Trimmed mean range of the nine; NaN if fewer than ``FEWEST`` have depth or the pixel is too dark."""
    sigma_m: FloatArray
    """Standard deviation of that range."""
    strength: FloatArray
    """Amplitude of the pixel itself if it has a range, otherwise 0."""
    shade: FloatArray
    """Mean amplitude of the nine."""


@kernel
def coarse_ranges(
    images: DepthImages, rays_z: FloatArray, pixels: CoarsePixels, steepest: float
) -> CoarseRanges:
    """Return the measurements of every ``stride``-th pixel with its neighbours.

    The range is a trimmed mean: the nine ranges are sorted, and a quarter is left out at each end, so that a
    mixed pixel at an outline does not shift the result. The noise is the standard deviation of that mean. It
    is estimated from the scatter of the nine about a plane.

    Args:
        images: images of the frame.
        rays_z: z component of the coarse pixels' unit rays, shape (rows, columns).
        pixels: positions of the coarse pixels; all lie in the image.
        steepest: largest change of a face's depth from one pixel to the next, over the depth.
    """
    depth, amplitude, least = images
    height, width = depth.shape
    ranges, sigmas = np.full(rays_z.shape, np.nan), np.zeros(rays_z.shape)
    strengths, shades = np.zeros(rays_z.shape), np.zeros(rays_z.shape)
    nine, block = np.empty(9), np.empty((9, 3))
    for i in range(rays_z.shape[0]):
        for j in range(rays_z.shape[1]):
            row, column = pixels.offset + i * pixels.stride, pixels.offset + j * pixels.stride
            if row >= height or column >= width:
                continue
            count, seen, light = 0, 0, 0.0
            for v in range(max(row - 1, 0), min(row + 2, height)):
                for u in range(max(column - 1, 0), min(column + 2, width)):
                    seen += 1
                    light += amplitude[v, u]
                    z = np.float64(depth[v, u])
                    if not NEAREST_M < z < FARTHEST_M or amplitude[v, u] < least[v, u]:
                        continue
                    k = count
                    while k > 0 and nine[k - 1] > z:
                        nine[k] = nine[k - 1]
                        k -= 1
                    nine[k] = z
                    block[count, 0], block[count, 1], block[count, 2] = u, v, z
                    count += 1
            shades[i, j] = light / seen
            if count >= FEWEST and amplitude[row, column] >= least[row, column]:
                outer = count // OUTER
                middle = nine[outer : count - outer].mean()
                variance = variance_about_plane(block, count, steepest * middle)
                ranges[i, j] = middle / rays_z[i, j]
                sigmas[i, j] = MIDDLE_OVER_MEAN * math.sqrt(variance / count) / rays_z[i, j]
                strengths[i, j] = amplitude[row, column]
    return CoarseRanges(ranges, sigmas, strengths, shades)


class Planes(NamedTuple):
    """Planes of the faces that the points' pixels show at a pose, target axes."""

    normals: FloatArray
    """Outward unit normals, shape (N, 3); zero if the pixel shows no face."""
    offsets_m: FloatArray
    """Offsets n . q of the planes, shape (N,)."""

    @classmethod
    def none(cls, count: int) -> Self:
        """Return the planes of ``count`` points whose pixels show no face."""
        return cls(np.zeros((count, 3)), np.zeros(count))

    @classmethod
    def of(cls, faces: Faces, shown: NDArray[np.int32]) -> Self:
        """Return the planes of faces by their indices, -1 for none, shape (N,)."""
        seen = shown >= 0
        return cls(
            np.where(seen[:, None], faces.normals[shown], 0.0), np.where(seen, faces.offsets_m[shown], 0.0)
        )

    def only(self, chosen: NDArray[np.bool_]) -> "Planes":
        """Return the planes of the chosen points; a mask of shape (N,)."""
        return Planes(self.normals[chosen], self.offsets_m[chosen])


@kernel
def add_depth_points(  # noqa: PLR0917
    sums: FloatArray, points: Points, planes: Planes, state: State, field: FieldArrays, scale: float
) -> FieldEvidence:
    """Add the factors of measured points to the sums, shape (35,); return their evidence.

    If ranges are too long by the bias b, a point lies at q - b d, where d is its unit ray in target axes. So
    the derivative of the residual with respect to b is -n . d with the normal n.

    Args:
        sums: information and gradient, input and output.
        points: N measured points.
        planes: planes of the faces that the points' pixels show.
        state: pose and bias to linearise at.
        field: the target's distance field.
        scale: Geman-McClure scale, m, above 0.
    """
    R, t, bias = state.pose.R, state.pose.t, state.bias_m
    places, trust, c2 = points.places_m, points.trust, scale * scale
    weights, squares, inliers, trusted = 0.0, 0.0, 0, 0.0
    for n in range(places.shape[0]):
        px, py, pz = places[n, 0], places[n, 1], places[n, 2]
        ray, range_m = in_target(R, px, py, pz), np.sqrt(px * px + py * py + pz * pz)
        x, y, z = in_target(R, px - t[0], py - t[1], pz - t[2])
        back = bias / range_m
        place = Vector(x - back * ray.x, y - back * ray.y, z - back * ray.z)
        face = Vector(planes.normals[n, 0], planes.normals[n, 1], planes.normals[n, 2])
        along = face.x * ray.x + face.y * ray.y + face.z * ray.z
        from_plane = face.x * place.x + face.y * place.y + face.z * place.z - planes.offsets_m[n]
        distance, g = from_plane, face
        if not (along < 0.0 and abs(from_plane) <= field.spacing_m):  # nearer, the field decides nothing
            in_field = seen_sample(field, place, ray, range_m, 2.0 * scale)
            if not (along < 0.0 and abs(from_plane) <= abs(in_field.distance) + field.spacing_m):
                distance, g = in_field
                along = g.x * ray.x + g.y * ray.y + g.z * ray.z
        if along == 0.0:
            continue
        d2 = distance * distance
        weight = trust[n] * geman_mcclure(d2, c2)
        weights += weight
        add_residual(sums, g, place, distance, weight)
        add_range_bias(sums, g, place, -along / range_m, distance, weight)
        inlier = 1 if d2 < c2 else 0
        inliers += inlier
        squares += inlier * trust[n] * d2
        trusted += inlier * trust[n]
    return FieldEvidence(weights, squares, inliers, trusted)
