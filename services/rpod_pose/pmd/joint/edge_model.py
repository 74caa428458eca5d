"""Samples of those edges of the target that an amplitude image shows at their true position.

The outline of a curved surface is left out. Such a surface darkens towards its limb, so that the steepest
change of the image is a pixel or more away from the outline.
"""

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rpod_pose.pmd.joint.edge_search import EdgeArrays
from rpod_pose.registration.brightness import spreads
from rpod_schemas.arrays import FloatArray
from rpod_target import Target
from rpod_target.mesh.topology import components, edges

CREASE_RAD = np.radians(15.0)
"""Least angle between two faces at an edge. Hand: with a smaller angle they belong to one curved surface,
which darkens towards its limb."""


BEND_RAD = np.radians(35.0)
"""Largest angle between two edges of one line. Physics: between a hexagon's 60 deg and the 30 deg of a circle
of 12 sides."""
WELD = 1e-6
"""Largest distance of two ends that count as the same point, over the target's extent. Numerics: the rounding
of a mesh in single precision."""


@dataclass(frozen=True, eq=False)
class EdgeModel:
    """Samples of creases and of boundaries between materials."""

    places_m: FloatArray
    """Positions of the samples, target axes, shape (N, 3)."""
    directions: FloatArray
    """Unit vectors along the edges, target axes, shape (N, 3)."""
    normals: FloatArray
    """Normals of the faces on both sides, target axes, shape (N, 2, 3); n and -n if there is one face."""
    spreads: FloatArray
    """Standard deviations of the logarithms of the faces' albedos, shape (N, 2)."""
    parts: NDArray[np.intp]
    """Index of the target's part to which each sample belongs, shape (N,)."""
    lines: NDArray[np.intp]
    """Index of each sample's line, shape (N,). A line is a sequence of edges that continue each other."""

    @classmethod
    def of(cls, target: Target, *, spacing_m: float) -> "EdgeModel":
        """Return samples of a target's edges with distances of at most ``spacing_m``."""
        parts = [
            _edges_of_part(target, np.flatnonzero(target.triangle_part == part))
            for part in range(len(target.parts))
        ]
        numbers = np.repeat(np.arange(len(parts)), [len(segments_m) for segments_m, _, _ in parts])
        segments_m, normals, spread = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        line = _lines(segments_m, numbers)
        lengths_m = np.linalg.norm(segments_m[:, 1] - segments_m[:, 0], axis=1)
        counts = np.array([max(1, ceil(length_m / spacing_m)) for length_m in lengths_m], np.intp)
        index = np.repeat(np.arange(len(segments_m)), counts)
        shares = [(np.arange(count) + 0.5) / count for count in counts]
        share = np.concatenate([*shares, np.zeros(0)])[:, None]  # a sphere has no edge
        start_m, end_m = segments_m[index, 0], segments_m[index, 1]
        directions = (end_m - start_m) / lengths_m[index, None]
        places_m = (1.0 - share) * start_m + share * end_m
        return cls(
            places_m,
            directions,
            np.ascontiguousarray(normals[index]),
            spread[index],
            numbers[index],
            line[index],
        )

    @property
    def arrays(self) -> EdgeArrays:
        """The samples in the form that the kernels take."""
        return EdgeArrays(self.places_m, self.directions, self.normals, self.spreads)


def _lines(segments_m: FloatArray, parts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the index of the line of each segment, shape (E,).

    Two segments of a part that share an end belong to one line if the angle between them is less than
    ``BEND_RAD``.
    """
    if not len(segments_m):
        return np.zeros(0, np.intp)
    along = segments_m[:, 1] - segments_m[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    ends_m = np.concatenate((segments_m[:, 0], segments_m[:, 1]))
    outwards = np.concatenate((-along, along))  # away from the segment
    pairs = cKDTree(ends_m).query_pairs(WELD * float(np.ptp(ends_m)), output_type="ndarray")
    of_end = np.tile(np.arange(len(segments_m)), 2)
    one, other = of_end[pairs[:, 0]], of_end[pairs[:, 1]]
    turn = np.einsum("ij,ij->i", outwards[pairs[:, 0]], -outwards[pairs[:, 1]])
    on = (turn > np.cos(BEND_RAD)) & (one != other) & (parts[one] == parts[other])
    return components(np.column_stack((one, other))[on], size=len(segments_m))


def _edges_of_part(target: Target, triangles: NDArray[np.intp]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the edges of one part, and the normals and spreads of the faces on both sides.

    Edges are given by their ends, shape (E, 2, 3), m. Normals have the shape (E, 2, 3), spreads
    (``EdgeModel.spreads``) the shape (E, 2).
    """
    segments_m, faces = edges(target.triangles_m[triangles])
    faces = triangles[faces]
    normals, material = target.normals[faces], target.triangle_material[faces]
    normals[faces[:, 0] == faces[:, 1], 1] *= -1.0
    cosine = np.einsum("ij,ij->i", normals[:, 0], normals[:, 1])
    visible = (cosine < np.cos(CREASE_RAD)) | (material[:, 0] != material[:, 1])
    visible &= (np.ptp(segments_m, axis=1) != 0.0).any(axis=1)
    return segments_m[visible], normals[visible], spreads(target)[faces[visible]]
