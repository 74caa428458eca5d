"""Residuals of measured points: distances from the planes of the faces that their pixels show.

The distance field needs no correspondence, so that a pose converges in it from afar. But it is known on the
nodes of a grid alone, and trilinear between them. Around convex edges, and around parts that are thinner than
a cell, it says that the surface itself lies outside: by a share of a cell, which is far more than the noise
of the ranges if the target is large and the camera close. Where a rendering near the pose tells on which face
a pixel's ray ends, the residual is the distance from the plane of that face, which is exact (projective point
to plane, G. Blais, M. D. Levine, IEEE PAMI 17, 1995).

At an outline a pixel may show another face than the rendering. The field is off by a cell at most, so that a
plane that is farther from the point than the field says, by more than a cell, is that of another face. Such a
point keeps the field's distance.
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_pose.registration.distance_field import FieldArrays
from rpod_pose.registration.field_alignment import FieldEvidence, Points, seen_sample
from rpod_pose.registration.gauss_newton import State
from rpod_pose.registration.lie_group import Vector, in_target
from rpod_pose.registration.normal_equations import add_range_bias, add_residual, geman_mcclure
from rpod_pose.registration.surface_model import Faces
from rpod_schemas.arrays import FloatArray


class Planes(NamedTuple):
    """Planes of the faces that the points' pixels show at a pose, target axes."""

    normals: FloatArray
    """Outward unit normals, shape (N, 3); zero where the pixel shows none."""
    offsets_m: FloatArray
    """Offsets n . q of the planes, shape (N,)."""

    @classmethod
    def none(cls, count: int) -> Self:
        """Return no plane for any of a number of points."""
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

    If ranges are too long by the bias b, a point lies at q - b d, d its ray in target axes: the residual's
    derivative by b is minus its normal along the ray.

    Args:
        sums: information and gradient, input and output.
        points: N measured points.
        planes: their planes.
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
        distance, g = seen_sample(field, place, ray, range_m, 2.0 * scale)
        face = Vector(planes.normals[n, 0], planes.normals[n, 1], planes.normals[n, 2])
        from_plane = face.x * place.x + face.y * place.y + face.z * place.z - planes.offsets_m[n]
        along = face.x * ray.x + face.y * ray.y + face.z * ray.z
        if along < 0.0 and abs(from_plane) <= abs(distance) + field.spacing_m:
            distance, g = from_plane, face
        else:
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
