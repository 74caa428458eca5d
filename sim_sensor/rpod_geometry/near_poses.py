"""Casting of a grid's rays at a mesh at many poses near each other, much faster than with ``ray_tree``.

Let the poses differ from a middle pose by at most a shift u and a turn q. Then a point p of the target, at
the distance |p| from its origin, is displaced by at most |u| + q |p| in target axes. So a ray can meet a
triangle at one of these poses only if, at the middle pose, it passes the triangle's box widened by this
length. A triangle that is seen from behind by more than q is met at none of them. The remaining triangles are
listed once for each ray. Most rays beside a target have an empty list; the others have a few triangles, in
the order in which the ray can reach them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_geometry.ray_tree import DEPTH, Ray, RayTree, in_target, met
from rpod_geometry.rays import GridArrays
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.types import Float32Array

ROUNDING = 1e-6
"""Share of its size by which a box is widened, because of rounding."""


class NearPoses(NamedTuple):
    """Poses near a middle pose."""

    R: FloatArray
    """R_sensor_target of the middle pose, shape (3, 3)."""
    t: FloatArray
    """Position of the target at the middle pose, sensor axes, shape (3,), m."""
    apart_m: float
    """Largest distance of a pose's position from that of the middle pose."""
    turn_rad: float
    """Largest angle between a pose's attitude and that of the middle pose."""


class NearTriangles(NamedTuple):
    """Triangles that each ray of a grid may meet at poses near each other."""

    poses: NearPoses
    first: NDArray[np.int64]
    """Index of each ray's first entry in the lists, and the end of the lists, shape (rays + 1,)."""
    place: NDArray[np.int32]
    """Index of each listed triangle in the tree's order, shape (N,)."""
    entry_m: FloatArray
    """Range before which the ray cannot meet the triangle, ascending for each ray, shape (N,)."""


@kernel
def is_near(poses: NearPoses, R: FloatArray, t: FloatArray) -> bool:
    """Return whether a pose R (3, 3), t (3,) of the target in the sensor is among the near ones."""
    apart_m, turn_rad = apart(poses.R, poses.t, R, t)
    return apart_m <= poses.apart_m and turn_rad <= poses.turn_rad


@kernel
def no_triangles(R: FloatArray, t: FloatArray) -> NearTriangles:
    """Return empty lists, which are valid for no pose; R (3, 3) and t (3,) are only stored."""
    poses = NearPoses(R, t, -1.0, -1.0)
    return NearTriangles(poses, np.zeros(1, np.int64), np.empty(0, np.int32), np.empty(0))


@kernel
def apart(R: FloatArray, t: FloatArray, other_R: FloatArray, other_t: FloatArray) -> tuple[float, float]:
    """Return the shift, m, and the turn, rad, between two poses of the target in the sensor.

    Args:
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        other_R: that of the other pose.
        other_t: that of the other pose.
    """
    shift2, chord2 = 0.0, 0.0
    for i in range(3):
        shift2 += (other_t[i] - t[i]) ** 2
        for k in range(3):
            chord2 += (other_R[i, k] - R[i, k]) ** 2  # 8 sin(turn / 2)^2 in sum
    return float(np.sqrt(shift2)), float(2.0 * np.arcsin(min(np.sqrt(chord2 / 8.0), 1.0)))


@kernel
def near_triangles(grid: GridArrays, tree: RayTree, poses: NearPoses) -> NearTriangles:
    """Return the triangles that each ray of a grid may meet at poses near each other."""
    rays, R = grid.components, poses.R
    height, width = rays.shape[1], rays.shape[2]
    first = np.zeros(height * width + 1, np.int64)
    lists = _Lists(np.empty(height * width, np.int32), np.empty(height * width))
    origin, waiting, number = _origin(R, poses.t), np.empty(DEPTH + 1, np.int32), 0
    wide_m = _widths(tree, poses)
    for i in range(height):
        for j in range(width):
            ray = in_target(R, origin, rays[0, i, j], rays[1, i, j], rays[2, i, j])
            begin = number
            waiting[0], left = 0, 1
            while left > 0:
                left -= 1
                node = int(waiting[left])
                if _entry(tree.boxes_m[node], wide_m[node], ray) == np.inf:
                    continue
                if tree.held[node] == 0:
                    waiting[left], waiting[left + 1] = tree.first[node] + 1, tree.first[node]
                    left += 2
                    continue
                for n in range(tree.first[node], tree.first[node] + tree.held[node]):
                    entry = _triangle_entry(tree.sides_m[n], wide_m[node], ray, poses.turn_rad)
                    if entry < np.inf:
                        lists = _grown(lists, number)
                        _insert(lists, begin, number, n, entry)
                        number += 1
            first[i * width + j + 1] = number
    return NearTriangles(poses, first, lists.place[:number], lists.entry_m[:number])


class _Lists(NamedTuple):
    """The lists of triangles while they grow, as in ``NearTriangles``."""

    place: NDArray[np.int32]
    entry_m: FloatArray


@inlined_kernel
def _grown(lists: _Lists, number: int) -> _Lists:
    """Return lists with space for at least one triangle more than ``number``."""
    if number < lists.place.size:
        return lists
    return _Lists(
        np.concatenate((lists.place, np.empty(number, np.int32))),
        np.concatenate((lists.entry_m, np.empty(number))),
    )


@inlined_kernel
def _insert(lists: _Lists, begin: int, end: int, n: int, entry_m: float) -> None:
    """Insert a triangle into the list from ``begin`` to ``end``, in the order of the ranges."""
    place, entries_m, after = lists.place, lists.entry_m, end
    while after > begin and entries_m[after - 1] > entry_m:
        place[after], entries_m[after] = place[after - 1], entries_m[after - 1]
        after -= 1
    place[after], entries_m[after] = n, entry_m


@kernel
def cast_near(  # noqa: PLR0917
    grid: GridArrays,
    tree: RayTree,
    near: NearTriangles,
    R: FloatArray,
    t: FloatArray,
    range_m: Float32Array,
    triangle: NDArray[np.int32],
) -> None:
    """Fill ``range_m`` and ``triangle`` like ``ray_tree.cast_tree``, at one of the near poses.

    Args:
        grid: ``RayGrid.arrays``.
        tree: the target's mesh.
        near: triangles that each of the rays may meet.
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        range_m: output, shape (rows, columns), m.
        triangle: output, shape (rows, columns).
    """
    rays, origin, width = grid.components, _origin(R, t), triangle.shape[1]
    first, place, entry_m = near.first, near.place, near.entry_m
    for i in range(triangle.shape[0]):
        for j in range(width):
            begin, end = first[i * width + j], first[i * width + j + 1]
            nearest, found = np.inf, -1
            if begin < end:
                ray = in_target(R, origin, rays[0, i, j], rays[1, i, j], rays[2, i, j])
                for n in range(begin, end):
                    if entry_m[n] >= nearest:
                        break
                    along = met(tree.sides_m, int(place[n]), ray)
                    if along < nearest:
                        nearest, found = along, int(place[n])
            range_m[i, j], triangle[i, j] = nearest, -1 if found < 0 else tree.triangle[found]


@inlined_kernel
def _origin(R: FloatArray, t: FloatArray) -> FloatArray:
    """Return the position of the sensor in target axes, shape (3,), m, from the target's pose R, t."""
    origin = np.empty(3)
    for k in range(3):
        origin[k] = -(R[0, k] * t[0] + R[1, k] * t[1] + R[2, k] * t[2])
    return origin


@inner_kernel
def _widths(tree: RayTree, poses: NearPoses) -> FloatArray:
    """Return the largest displacement by the poses of a point in each node's box, shape (nodes,), m."""
    wide_m = np.empty(tree.held.size)
    for node in range(wide_m.size):
        size2 = 0.0
        for k in range(3):
            size2 += max(-tree.boxes_m[node, k], tree.boxes_m[node, 3 + k]) ** 2
        wide_m[node] = poses.apart_m + (poses.turn_rad + ROUNDING) * np.sqrt(size2)
    return wide_m


@inlined_kernel
def _triangle_entry(sides: FloatArray, wide_m: float, ray: Ray, turn_rad: float) -> float:
    """Return the least range at which a ray may meet a triangle, m; inf if it does at none of the poses.

    Args:
        sides: first corner and two sides from it, shape (3, 3), m.
        wide_m: largest displacement of the triangle by the poses.
        ray: the ray at the middle pose.
        turn_rad: largest turn.
    """
    if _from_behind(sides, ray, turn_rad):
        return np.inf
    entry_m = _entry(_box(sides), wide_m, ray)
    return np.inf if entry_m < np.inf and _beside(sides, wide_m, ray, entry_m) else entry_m


@inlined_kernel
def _box(sides: FloatArray) -> FloatArray:
    """Return the bounds of a triangle, shape (6,), from its first corner and two sides from it, (3, 3), m."""
    box = np.empty(6)
    for k in range(3):
        box[k] = sides[0, k] + min(0.0, sides[1, k], sides[2, k])
        box[3 + k] = sides[0, k] + max(0.0, sides[1, k], sides[2, k])
    return box


@inlined_kernel
def _normal(sides: FloatArray) -> tuple[float, float, float]:
    """Return the outward normal of a triangle, of any length, from its corner and sides, shape (3, 3), m."""
    ax, ay, az = sides[1, 0], sides[1, 1], sides[1, 2]
    bx, by, bz = sides[2, 0], sides[2, 1], sides[2, 2]
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined_kernel
def _from_behind(sides: FloatArray, ray: Ray, turn_rad: float) -> bool:
    """Return whether a ray sees a triangle from behind at all of the poses.

    Args:
        sides: first corner and two sides from it, shape (3, 3), m.
        ray: the ray at the middle pose.
        turn_rad: largest turn.
    """
    x, y, z = _normal(sides)
    along = x * ray.x + y * ray.y + z * ray.z
    return bool(along > (turn_rad + ROUNDING) * np.sqrt(x * x + y * y + z * z))


@inlined_kernel
def _beside(sides: FloatArray, wide_m: float, ray: Ray, entry_m: float) -> bool:
    """Return whether a ray passes a triangle at all of the poses.

    The whole triangle is on one side of the plane through the sensor and one side of the triangle. If a ray
    is on the other side, its distance from the triangle beyond a range s is at least s times the sine of its
    angle to the plane.

    Args:
        sides: first corner and two sides from it, shape (3, 3), m.
        wide_m: largest displacement of the triangle by the poses.
        ray: the ray at the middle pose.
        entry_m: least range at which the ray may meet the triangle.
    """
    ox, oy, oz = sides[0, 0] - ray.from_x, sides[0, 1] - ray.from_y, sides[0, 2] - ray.from_z
    nx, ny, nz = _normal(sides)
    sign = 1.0 if nx * ox + ny * oy + nz * oz < 0.0 else -1.0  # seen from outside, or from behind
    for i in range(3):
        j = (i + 1) % 3
        ax, ay, az = ox, oy, oz
        bx, by, bz = ox, oy, oz
        if i > 0:
            ax, ay, az = ox + sides[i, 0], oy + sides[i, 1], oz + sides[i, 2]
        if j > 0:
            bx, by, bz = ox + sides[j, 0], oy + sides[j, 1], oz + sides[j, 2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        outside = sign * (x * ray.x + y * ray.y + z * ray.z)
        if outside > 0.0 and (entry_m * outside) ** 2 > wide_m * wide_m * (x * x + y * y + z * z):
            return True
    return False


@inlined_kernel
def _entry(box: Array, wide: float, ray: Ray) -> float:
    """Return the least range at which a ray may meet the content of a box, m; inf if it never does.

    Args:
        box: least and greatest corner, target axes, shape (6,), m.
        wide: largest displacement of the content by the poses, m.
        ray: the ray at the middle pose.
    """
    ax, bx = (box[0] - wide - ray.from_x) * ray.per_x, (box[3] + wide - ray.from_x) * ray.per_x
    ay, by = (box[1] - wide - ray.from_y) * ray.per_y, (box[4] + wide - ray.from_y) * ray.per_y
    az, bz = (box[2] - wide - ray.from_z) * ray.per_z, (box[5] + wide - ray.from_z) * ray.per_z
    begin = max(min(ax, bx), min(ay, by), min(az, bz), 0.0)
    end = min(max(ax, bx), max(ay, by), max(az, bz))
    return begin if begin <= end else np.inf
