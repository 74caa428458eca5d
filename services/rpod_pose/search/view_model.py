"""A target as a few hundred surface points, with a table of the directions from which each is visible.

Casting a target takes ten times as long as projecting a few hundred of its points. Which points are visible
depends, to a good approximation, on the direction of the sensor alone; it is tabulated once, over directions
spread evenly.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rpod_geometry.kernels import kernel
from rpod_geometry.rays import Hits, RayGrid, cast
from rpod_pose.registration.brightness import albedos
from rpod_pose.registration.closest_point import Surface
from rpod_pose.registration.distance_field import FieldArrays
from rpod_pose.search.attitude_grid import BORESIGHT, even_directions
from rpod_schemas.arrays import FloatArray
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Camera, Float32Array
from rpod_target import Target
from rpod_target.tables import Tables, kept_of

VIEWS = 600
"""Number of directions in the table. Numerics: memory; they are about 8 deg apart."""
FROM_RADII = 2.5
"""Distance of the viewpoints, in radii of the target. Hand: the visible points change little with the
distance."""
CUBE = 16
"""Cells along each edge of the cube that finds the nearest direction. Numerics: a cell is about 6 deg wide,
less than ``VIEWS`` are apart."""
PIXELS = 128
"""Pixels along each side of the images that show which points are hidden. Numerics: each is 1.7 % of the
target's radius."""
ANCHORS = 5
"""Number of surface regions. Hand: a truncated scan may show any one of them; the time of a search grows with
it."""
FEW_POINTS = 80
"""Number of points in the comparison of all attitudes. Numerics: a budget of computation."""
AREA = 7
"""Row of ``Points.columns`` that holds the areas. Physics: of the order of the columns."""


class Points(NamedTuple):
    """Surface points of a target, as the kernels take them."""

    columns: Float32Array
    """Position, normal, normal times position, area share and albedo in rows, shape (9, K)."""
    seen_from: NDArray[np.bool_]
    """Whether each point is visible from each direction, shape (VIEWS, K)."""
    cube: NDArray[np.int32]
    """Indices of directions, for ``view_of``, shape (6, CUBE, CUBE)."""


@dataclass(frozen=True, eq=False)
class ViewModel:
    """A target's surface points, and its distance field for rough comparisons."""

    points: Points
    few_points: Points
    """The first few of the points, for the comparison of all attitudes."""
    cube: NDArray[np.int32]
    """Indices of directions, for ``view_of``, shape (6, CUBE, CUBE)."""
    centroids_m: FloatArray
    """Centroid of the surface visible from far away in each direction, target axes, shape (VIEWS, 3)."""
    anchors_m: FloatArray
    """The origin, and the centres of the surface's regions, target axes, shape (1 + ANCHORS, 3)."""
    squares: FieldArrays
    """Squared distance field, truncated, m2."""

    @classmethod
    def of(cls, target: Target, coarse_field: FieldArrays, *, count: int, truncation_m: float) -> Self:
        """Return the model of a target with at most ``count`` points."""
        origin_m, spacing_m, distances_m = coarse_field
        scale_m = np.sqrt(spacing_m * target.radius_m) / 4.0  # so that both sides of a panel are kept
        lifted = np.hstack((target.model_points_m, scale_m * target.model_normals))
        chosen = spread(lifted, count)
        places_m, normals = target.model_points_m[chosen], target.model_normals[chosen]
        albedo, directions = _albedo(target, places_m), even_directions(VIEWS)
        seen, cube = _kept_seen(target, places_m, normals, directions), _cube(directions)

        def first(number: int) -> Points:
            _, owner = cKDTree(lifted[chosen[:number]]).query(lifted)
            areas = np.bincount(owner, minlength=len(chosen[:number])) / len(lifted)
            offsets_m = (places_m[:number] * normals[:number]).sum(axis=1)
            rows = (places_m[:number].T, normals[:number].T, offsets_m, areas, albedo[:number])
            columns = np.ascontiguousarray(np.vstack(rows), np.float32)
            return Points(columns, seen[:, :number].copy(), cube)

        squares = np.full(
            distances_m.shape, truncation_m**2, np.float32
        )  # the border stands for all places outside
        inner = (slice(1, -1),) * 3
        squares[inner] = np.minimum(distances_m[inner] ** 2, truncation_m**2)
        every = first(count)
        weights = np.maximum(directions @ normals.T, 0.0) * seen * every.columns[AREA]
        centroids_m = weights @ places_m / weights.sum(axis=1, keepdims=True)
        regions_m, _ = kmeans2(target.model_points_m, ANCHORS, minit="++", seed=0)
        return cls(
            every,
            first(FEW_POINTS),
            cube,
            centroids_m,
            np.vstack((np.zeros(3), regions_m)),
            FieldArrays(origin_m, spacing_m, squares),
        )


def spread(points: FloatArray, count: int) -> NDArray[np.int64]:
    """Return indices of points, shape (N, D), each farthest from all before (T. F. Gonzalez, 1985)."""
    distances = np.full(len(points), np.inf)
    order = [0]
    while len(order) < min(count, len(points)):
        distances = np.minimum(distances, ((points - points[order[-1]]) ** 2).sum(axis=1))
        order.append(int(distances.argmax()))
    return np.array(order)


def _albedo(target: Target, points_m: FloatArray) -> FloatArray:
    nearest = np.zeros(len(points_m), np.int32)
    every = np.ones(len(target.triangles_m), bool)
    Surface.of(target.triangles_m, target.normals).closest(points_m, every, nearest)
    return albedos(target)[nearest]


def _kept_seen(
    target: Target, points_m: FloatArray, normals: FloatArray, directions: FloatArray
) -> NDArray[np.bool_]:
    """Return the result of ``_seen``, from the cache if it has it: the images take half a second."""
    inputs = target.triangles_m, target.radius_m, points_m, normals, directions, FROM_RADII, PIXELS

    def make() -> Tables:
        return {"seen": _seen(target, points_m, normals, directions)}

    return kept_of(target, "seen", 1, inputs, make)["seen"]


def _seen(
    target: Target, points_m: FloatArray, normals: FloatArray, directions: FloatArray
) -> NDArray[np.bool_]:
    """Return which points are visible from a viewpoint in each direction, shape (directions, points)."""
    range_m = FROM_RADII * target.radius_m
    focal_px = PIXELS / 2.2 * np.sqrt(FROM_RADII**2 - 1.0)
    middle = (PIXELS - 1) / 2.0
    camera = Camera(width=PIXELS, height=PIXELS, fx=focal_px, fy=focal_px, cx=middle, cy=middle)
    grid = RayGrid.pinhole(camera)
    hits = Hits.of(grid)
    slack_m = 3.0 * range_m / focal_px
    seen = np.zeros((len(directions), len(points_m)), bool)
    for index, direction in enumerate(directions):
        R = Rotation.align_vectors(-BORESIGHT, direction)[0]
        pose = make_pose(rotation=R, translation_m=range_m * BORESIGHT)
        cast(grid, target.triangles_m, pose, out=hits)
        local_m = pose.apply(points_m)
        column, row = np.rint(focal_px * local_m[:, :2].T / local_m[:, 2] + middle).astype(np.intp)
        behind = np.linalg.norm(local_m, axis=1) > hits.range_m[row, column] + slack_m
        seen[index] = ((R.apply(normals) * local_m).sum(axis=1) < 0.0) & ~behind
    return seen


def _cube(directions: FloatArray) -> NDArray[np.int32]:
    """Return the nearest direction of each cell of a cube's faces -x, +x, -y, +y, -z, +z; (6, CUBE, CUBE)."""
    middle = (np.arange(CUBE) + 0.5) / CUBE * 2.0 - 1.0
    u, v = np.meshgrid(middle, middle, indexing="ij")
    faces = [
        np.roll(np.stack((np.full_like(u, side), u, v), axis=-1), axis, axis=-1)
        for axis in range(3)
        for side in (-1.0, 1.0)
    ]
    cells = np.stack(faces)
    _, nearest = cKDTree(directions).query(cells / np.linalg.norm(cells, axis=-1, keepdims=True))
    return np.asarray(nearest, np.int32)


@kernel
def view_of(x: float, y: float, z: float, cube: NDArray[np.int32]) -> int:
    """Return the index of the tabulated direction nearest to (x, y, z), target axes; any for NaN.

    The largest component chooses the face of a cube, the other two over it choose the cell. ``max(0.0, NaN)``
    is 0.0, so that no index is outside of the cube.

    Args:
        x: first component of the direction, of any length.
        y: second component.
        z: third component.
        cube: ``ViewModel.cube``, shape (6, CUBE, CUBE).
    """
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, u, v, w = (1 if x > 0.0 else 0), y, z, ax
    elif ay >= az:
        face, u, v, w = (3 if y > 0.0 else 2), z, x, ay
    else:
        face, u, v, w = (5 if z > 0.0 else 4), x, y, az
    if not w > 0.0:  # the origin has no direction
        return 0
    half = 0.5 * cube.shape[1]
    last = cube.shape[1] - 1
    i, j = int(min(max(0.0, (u / w + 1.0) * half), last)), int(min(max(0.0, (v / w + 1.0) * half), last))
    return int(cube[face, i, j])


@kernel
def centroids_in_view(
    attitudes: Float32Array, place: FloatArray, centroids: FloatArray, cube: NDArray[np.int32]
) -> Float32Array:
    """Return the centroid of the surface that each attitude shows, target axes, shape (M, 3), m.

    Args:
        attitudes: R_sensor_target, shape (M, 3, 3).
        place: position of the target in the sensor, shape (3,), m.
        centroids: ``ViewModel.centroids_m``, shape (VIEWS, 3).
        cube: ``ViewModel.cube``.
    """
    seen = np.empty((attitudes.shape[0], 3), np.float32)
    for m in range(attitudes.shape[0]):
        R = attitudes[m]
        x = -(R[0, 0] * place[0] + R[1, 0] * place[1] + R[2, 0] * place[2])
        y = -(R[0, 1] * place[0] + R[1, 1] * place[1] + R[2, 1] * place[2])
        z = -(R[0, 2] * place[0] + R[1, 2] * place[1] + R[2, 2] * place[2])
        seen[m] = centroids[view_of(x, y, z, cube)]
    return seen
