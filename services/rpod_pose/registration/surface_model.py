"""Model of the target for kernels that cast rays: its faces and its distance field."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.ray_tree import RayTree, cast_tree, ray_tree, silhouette_m2
from rpod_geometry.rays import GridArrays, RenderBuffers, cast_pose
from rpod_geometry.shared_corners import SharedCorners, cast_shared, shared_corners
from rpod_pose.registration.brightness import albedos
from rpod_pose.registration.distance_field import FieldArrays, checked, field_arrays
from rpod_pose.registration.lie_group import in_sensor
from rpod_schemas.arrays import FloatArray
from rpod_target import Target
from rpod_target.mesh.topology import directed_edges, welded

COARSE_CELLS = 3
"""Number of cells of the distance field in a cell of the coarse field, along each axis. Numerics: a 27th of
the memory, for steps that are wider than a cell."""

FLAT = 1e-6
"""Largest sine of the angle between two faces in one plane. Numerics: the rounding of coordinates."""
PER_HIT = 12
"""Largest number of triangles for each ray on the target at which an image is cast by testing all triangles.
Numerics: measured times of four patterns of 441 to 16,384 rays, eight targets of 24 to 12,872 triangles, five
ranges. The chosen way took 1.01 times the faster one's time on average, 2.5 times at most."""
MANY = 5000
"""Number of triangles above which shared corners are looked up once, however many rays meet the target.
Numerics: measured times of the rays of a camera (352 x 287 pixels): 0.76 in place of 1.02 ms for 20,000
triangles, and the same for 5,400."""
LINES = 1024
"""Number of lines by which the mean silhouette of a mesh is measured. Numerics: its error is a tenth if it
fills 9 % of its sphere."""


class Edges(NamedTuple):
    """The edges of a target at which its surface may end for a sensor: convex ones and borders."""

    ends_m: FloatArray
    """Ends, target axes, counter-clockwise about the first face, shape (E, 2, 3)."""
    faces: NDArray[np.int32]
    """Faces beside each edge, shape (E, 2); the same face twice at a border."""


class Faces(NamedTuple):
    """The target's triangles in the form that the kernels take."""

    triangles_m: FloatArray
    """Corners, target axes, shape (T, 3, 3)."""
    normals: FloatArray
    """Outward unit normals, target axes, shape (T, 3)."""
    offsets_m: FloatArray
    """Offsets of the triangles' planes, n . v0, shape (T,), m."""
    albedo: FloatArray
    """Median albedo of the class of each triangle's material, shape (T,)."""
    tree: RayTree
    """The same triangles in a tree of boxes, for single rays."""
    silhouette_m2: float
    """Mean area of the target's silhouette over all directions."""
    edges: Edges
    """Edges of the triangles at which the surface may end."""
    shared: SharedCorners
    """The corners that the triangles share."""

    @classmethod
    def of(cls, target: Target) -> "Faces":
        """Return the triangles of a target."""
        triangles_m, normals = (np.ascontiguousarray(each) for each in (target.triangles_m, target.normals))
        tree = ray_tree(triangles_m)
        return cls(
            triangles_m,
            normals,
            np.einsum("ij,ij->i", normals, triangles_m[:, 0]),
            albedos(target),
            tree,
            silhouette_m2(tree, np.random.default_rng(0).random((LINES, 4))),
            outline_edges(triangles_m, normals),
            shared_corners(triangles_m),
        )


@kernel
def cast_faces(grid: GridArrays, faces: Faces, R: FloatArray, t: FloatArray, buffers: RenderBuffers) -> None:
    """Fill the first hit of every ray on outer sides, by the fastest of three ways of casting.

    Args:
        grid: ``RayGrid.arrays``.
        faces: the target.
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        buffers: output.
    """
    triangles, hits = faces.triangles_m.shape[0], _expected_hits(grid, faces, R, t)
    if triangles > PER_HIT * hits:
        cast_tree(grid, faces.tree, R, t, buffers.range_m, buffers.triangle)
    elif triangles > min(hits, MANY):  # most triangles lie between the rays, or each has few of them
        cast_shared(grid, faces.shared, R, t, buffers.range_m, buffers.triangle)
    else:
        cast_pose(grid, faces.triangles_m, R, t, True, buffers.range_m, buffers.triangle)


@inner_kernel
def _expected_hits(grid: GridArrays, faces: Faces, R: FloatArray, t: FloatArray) -> float:
    """Return the approximate number of rays that meet the target; all if a part of it is behind the sensor.

    It is the number of rays in the rows and columns of the target's box, times the share that the mean
    silhouette fills of them.

    Args:
        grid: ``RayGrid.arrays``.
        faces: the target.
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
    """
    box_m = faces.tree.boxes_m[0]
    left, right, top, bottom, middle_m = np.inf, -np.inf, np.inf, -np.inf, 0.0
    for n in range(8):
        x, y, z = box_m[3 * (n & 1)], box_m[1 + 3 * (n >> 1 & 1)], box_m[2 + 3 * (n >> 2)]
        corner = in_sensor(R, x, y, z)
        ahead_m = corner.z + t[2]
        if not ahead_m > 0.0:
            return float(grid.row_lower.size * grid.column_lower.size)
        across, down = (corner.x + t[0]) / ahead_m, (corner.y + t[1]) / ahead_m
        left, right, top, bottom = min(left, across), max(right, across), min(top, down), max(bottom, down)
        middle_m += ahead_m / 8.0
    columns = int(np.searchsorted(grid.column_lower, right) - np.searchsorted(grid.column_upper, left))
    rows = int(np.searchsorted(grid.row_lower, bottom) - np.searchsorted(grid.row_upper, top))
    # A corner beside the sensor has a huge slope, but only the part of the box within the grid has rays.
    across = min(right, grid.column_upper[-1]) - max(left, grid.column_lower[0])
    down = min(bottom, grid.row_upper[-1]) - max(top, grid.row_lower[0])
    filled = faces.silhouette_m2 / (max(across, 0.0) * max(down, 0.0) * middle_m**2)
    return float(max(rows, 0) * max(columns, 0) * min(filled, 1.0))


def outline_edges(triangles_m: FloatArray, normals: FloatArray) -> Edges:
    """Return the edges of a mesh at which its surface may end for a sensor.

    A surface never ends at an edge between two faces in one plane, or at a concave edge. If more than two
    faces meet at an edge, it is a border of each of them.

    Args:
        triangles_m: corners, target axes, shape (T, 3, 3), counter-clockwise from outside.
        normals: outward unit normals, shape (T, 3).
    """
    directed = directed_edges(welded(triangles_m))
    _, edge, counts = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    order = np.argsort(edge, kind="stable")
    two = np.repeat(counts == 2, counts)
    first, second = order[two].reshape(-1, 2).T
    one, other = first // 3, second // 3
    ends_m = np.stack([triangles_m, np.roll(triangles_m, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    beyond_m = triangles_m[other].mean(axis=1) - ends_m[first, 0]
    height_m = np.einsum("ij,ij->i", normals[one], beyond_m)
    convex = height_m < -FLAT * np.linalg.norm(beyond_m, axis=1)
    alone = order[~two]
    return Edges(
        np.ascontiguousarray(np.concatenate([ends_m[first[convex]], ends_m[alone]])),
        np.concatenate(
            [np.stack([one, other], axis=1)[convex], np.repeat(alone // 3, 2).reshape(-1, 2)]
        ).astype(np.int32),
    )


@dataclass(frozen=True, eq=False)
class SurfaceModel:
    """A target's faces and distance field in the form that the kernels take."""

    faces: Faces
    coarse_field: FieldArrays
    """The distance field at every third node: small enough for a processor's cache."""

    @classmethod
    def of(cls, target: Target) -> Self:
        """Return the model of a target.

        Raises:
            rpod_target.TargetError: the target has no distance field.
        """
        return cls(Faces.of(target), coarse_field(target))


def coarse_field(target: Target) -> FieldArrays:
    """Return the distance field of a target at every third node.

    Raises:
        rpod_target.TargetError: the target has no distance field.
    """
    origin_m, spacing_m, values = field_arrays(target)
    coarse = values[::COARSE_CELLS, ::COARSE_CELLS, ::COARSE_CELLS].copy()
    return checked(target, FieldArrays(origin_m, COARSE_CELLS * spacing_m, coarse))
