"""Places between neighbouring rays at which a near surface ends, for a pose at which the target is rendered.

A surface ends at an edge of the mesh between a face that is seen from outside and one that is not, or at a
border of the mesh. Such an edge is compared only with those pairs of neighbouring rays that meet different
surfaces. The edge crosses the plane of the two rays in a point. This point gives the place between them and
its range, and the direction of the edge gives the normal, all without casting a ray.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel
from rpod_geometry.lines import slopes_ahead
from rpod_geometry.rays import GridArrays
from rpod_pose.lidar.scan_likelihood import Assumptions, Rays
from rpod_pose.registration.lie_group import PoseArrays, Vector, in_sensor, in_target
from rpod_pose.registration.surface_model import Faces
from rpod_schemas.arrays import FloatArray

JUMP = 4.0
"""Least difference of two ranges at which a surface ends, in standard deviations of a range. Physics: the
noise of a difference is 1.4 times that of a range, so that one in 200 pairs on one surface seems to be a
jump."""
NEARER = 0.5
"""Largest distance of an edge from the surface that ends there, over the distance from this surface to the
one behind it. Hand: an edge that is farther away belongs to a hidden surface."""


class Places(NamedTuple):
    """Places of the outline, each between two neighbouring rays."""

    number: int
    """Number of places, N; the arrays may be longer."""
    direction: FloatArray
    """Unit direction of each place in sensor axes, shape (N, 3)."""
    normal: FloatArray
    """Unit normal of the outline, sensor axes, perpendicular to the direction, towards the near surface,
    shape (N, 3)."""
    range_m: FloatArray
    """Range of the near surface there, shape (N,)."""
    rays: NDArray[np.int64]
    """Row-major indices of the ray that meets the near surface and of the one that passes it, (N, 2)."""
    faces: NDArray[np.int64]
    """Face of the near surface, and the face behind it, -1 for none, shape (N, 2)."""


class Block(NamedTuple):
    """Rows and columns of the pattern that an edge may cross."""

    top: int
    bottom: int
    """Last row + 1."""
    left: int
    right: int
    """Last column + 1."""


class Pair(NamedTuple):
    """Two neighbouring rays between which a surface may end."""

    number: int
    """Number of the pair, which is also that of its place."""
    one: int
    """Row-major index of the first ray."""
    two: int
    """Row-major index of the other ray."""


class Seen(NamedTuple):
    """A visible edge at which a surface ends, sensor axes."""

    face: int
    """The face that ends."""
    start: Vector
    """One end, m."""
    end: Vector
    """The other end, m."""
    turn: float
    """1 if the edge runs counter-clockwise about the face, seen from outside, -1 if clockwise."""


@inlined_kernel
def places(pose: PoseArrays, rays: Rays, assumed: Assumptions) -> Places:
    """Return the places of the outline at a pose.

    Args:
        pose: pose of the target in the sensor.
        rays: rays and target; their buffers hold the target rendered at the pose.
        assumed: statistics of returns.
    """
    width, directions = rays.face.shape[1], rays.grid.components
    pairs, count = _ending(pose, rays, JUMP * assumed.sigma_m)
    found = Places(
        count,
        np.empty((count, 3)),
        np.empty((count, 3)),
        np.empty(count),
        np.full((count, 2), -1),
        np.empty((count, 2), np.int64),
    )
    edges, off_m = rays.faces.edges, np.full(count, np.inf)
    facing = _facing(pose, rays.faces)
    for n in range(edges.faces.shape[0]):
        one, two = edges.faces[n, 0], edges.faces[n, 1]
        if facing[one] == facing[two] and not (one == two and facing[one]):
            continue
        start, end = _ends(pose, edges.ends_m[n])
        block = _block(rays.grid, start, end)
        if block.top == block.bottom and block.left == block.right:  # the edge lies between the rays
            continue
        edge = Seen(int(np.int64(one if facing[one] else two)), start, end, 1.0 if facing[one] else -1.0)
        for i in range(max(block.top - 1, 0), block.bottom):
            for j in range(max(block.left - 1, 0), block.right):
                ray = i * width + j
                for way in range(2):
                    if pairs[way, i, j] < 0 or (i < block.top if way == 0 else j < block.left):
                        continue
                    other = ray + (1 if way == 0 else width)
                    u = _crossing(directions, edge, ray, other)
                    if u >= 0.0:
                        _compare(found, off_m, (pose, rays), edge, Pair(pairs[way, i, j], ray, other), u)
    return _without_empty(found)


@inlined_kernel
def on_plane(pose: PoseArrays, rays: Rays, face: int, ray: int) -> float:
    """Return the range at which a ray, a row-major index, meets a face's plane, m; inf if it never does."""
    width, directions = rays.face.shape[1], rays.grid.components
    i, j = ray // width, ray % width
    d = in_target(pose.R, directions[0, i, j], directions[1, i, j], directions[2, i, j])
    t = in_target(pose.R, pose.t[0], pose.t[1], pose.t[2])
    n = rays.faces.normals[face]
    height = rays.faces.offsets_m[face] + n[0] * t.x + n[1] * t.y + n[2] * t.z
    found = height / (n[0] * d.x + n[1] * d.y + n[2] * d.z)
    return found if found > 0.0 else np.inf


@inlined_kernel
def _ending(pose: PoseArrays, rays: Rays, limit_m: float) -> tuple[NDArray[np.int32], int]:
    """Return the number of each pair of neighbours between which a surface may end, and the number of pairs.

    Args:
        pose: pose of the target in the sensor.
        rays: rays and target; their buffers hold the target rendered at the pose.
        limit_m: largest distance of a ray's hit from the other ray's plane at which both meet one surface.

    Returns:
        Pairs of a ray and the next one in its row, and in its column, -1 for others, (2, rows, columns).
    """
    height, width = rays.face.shape
    pairs, count = np.full((2, height, width), np.int32(-1)), 0
    for i in range(height):
        for j in range(width):
            for way in range(2):
                k, m = i + way, j + 1 - way
                if k == height or m == width:
                    continue
                a, b = int(np.int64(rays.face[i, j])), int(np.int64(rays.face[k, m]))
                if a == b:
                    continue
                if a >= 0 and b >= 0:
                    one, two = i * width + j, k * width + m
                    forth = abs(on_plane(pose, rays, a, two) - np.float64(rays.range_m[k, m]))
                    aback = abs(on_plane(pose, rays, b, one) - np.float64(rays.range_m[i, j]))
                    if forth <= limit_m or aback <= limit_m:
                        continue
                pairs[way, i, j] = count
                count += 1
    return pairs, count


@inlined_kernel
def _facing(pose: PoseArrays, faces: Faces) -> NDArray[np.bool_]:
    """Return which faces the sensor sees from outside, shape (T,)."""
    origin = in_target(pose.R, -pose.t[0], -pose.t[1], -pose.t[2])
    facing = np.empty(faces.offsets_m.size, np.bool_)
    for f in range(facing.size):
        n = faces.normals[f]
        facing[f] = n[0] * origin.x + n[1] * origin.y + n[2] * origin.z > faces.offsets_m[f]
    return facing


@inlined_kernel
def _ends(pose: PoseArrays, ends_m: FloatArray) -> tuple[Vector, Vector]:
    """Return the ends of an edge, target axes, shape (2, 3), in sensor axes."""
    t = pose.t
    a = in_sensor(pose.R, ends_m[0, 0], ends_m[0, 1], ends_m[0, 2])
    b = in_sensor(pose.R, ends_m[1, 0], ends_m[1, 1], ends_m[1, 2])
    return Vector(a.x + t[0], a.y + t[1], a.z + t[2]), Vector(b.x + t[0], b.y + t[1], b.z + t[2])


@inlined_kernel
def _block(grid: GridArrays, start: Vector, end: Vector) -> Block:
    """Return the rows and columns of the grid that an edge, sensor axes, may cross."""
    left, right = slopes_ahead(start.x, start.z, end.x, end.z)
    top, bottom = slopes_ahead(start.y, start.z, end.y, end.z)
    return Block(
        _from(grid.row_upper, top, True),
        _from(grid.row_lower, bottom, False),
        _from(grid.column_upper, left, True),
        _from(grid.column_lower, right, False),
    )


@inlined_kernel
def _from(values: FloatArray, value: float, including: bool) -> int:
    """Return the first index whose value is above a given one; NumPy's search takes longer.

    Args:
        values: sorted values, shape (N,).
        value: the given value.
        including: whether an equal value is found too.
    """
    low, high = 0, values.size
    while low < high:
        middle = (low + high) // 2
        if values[middle] < value or (not including and values[middle] == value):
            low = middle + 1
        else:
            high = middle
    return low


@inlined_kernel
def _crossing(directions: FloatArray, edge: Seen, one: int, two: int) -> float:
    """Return where an edge crosses between two rays: 0 is its start, 1 its end; -1 if it does not cross.

    Most edges do not cross. This check alone takes a tenth of the time of ``_compare``.

    Args:
        directions: ``GridArrays.components``.
        edge: the edge.
        one: row-major index of the first ray.
        two: row-major index of the other ray.
    """
    width = directions.shape[2]
    i, j, k, n = one // width, one % width, two // width, two % width
    ax, ay, az = directions[0, i, j], directions[1, i, j], directions[2, i, j]
    bx, by, bz = directions[0, k, n], directions[1, k, n], directions[2, k, n]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    above = x * edge.start.x + y * edge.start.y + z * edge.start.z
    below = x * edge.end.x + y * edge.end.y + z * edge.end.z
    if above * below > 0.0 or above == below:
        return -1.0
    u = above / (above - below)
    px = edge.start.x + u * (edge.end.x - edge.start.x)
    py = edge.start.y + u * (edge.end.y - edge.start.y)
    pz = edge.start.z + u * (edge.end.z - edge.start.z)
    of_a = (py * bz - pz * by) * x + (pz * bx - px * bz) * y + (px * by - py * bx) * z
    of_b = (ay * pz - az * py) * x + (az * px - ax * pz) * y + (ax * py - ay * px) * z
    return -1.0 if of_a < 0.0 or of_b < 0.0 or not of_a + of_b > 0.0 else u


@inlined_kernel
def _compare(  # noqa: PLR0917
    found: Places, off_m: FloatArray, scene: tuple[PoseArrays, Rays], edge: Seen, pair: Pair, u: float
) -> None:
    """Store an edge that crosses between the rays of a pair as its place, if no nearer edge is known.

    Args:
        found: places so far, input and output.
        off_m: distance of each place's edge from the surface that ends there, shape (N,), input and output.
        scene: pose, rays and target.
        edge: the edge.
        pair: the pair.
        u: ``_crossing`` of the edge between the pair's rays.
    """
    pose, rays = scene
    a, b = direction_of(rays, pair.one), direction_of(rays, pair.two)
    p = Vector(
        edge.start.x + u * (edge.end.x - edge.start.x),
        edge.start.y + u * (edge.end.y - edge.start.y),
        edge.start.z + u * (edge.end.z - edge.start.z),
    )
    front, back, outwards = pair.one, pair.two, cross(edge.start, edge.end)
    if edge.turn * (dot(a, outwards) - dot(b, outwards)) > 0.0:
        front, back = back, front
    width, r = rays.face.shape[1], np.sqrt(dot(p, p))
    near_m = np.float64(rays.range_m[front // width, front % width])
    far_m = np.float64(rays.range_m[back // width, back % width])
    off = min(abs(near_m - r), abs(near_m - on_plane(pose, rays, edge.face, front)))
    n = pair.number
    if r >= far_m or off >= off_m[n] or off > NEARER * (far_m - near_m):
        return
    off_m[n], found.range_m[n] = off, r
    found.direction[n, 0], found.direction[n, 1], found.direction[n, 2] = p.x / r, p.y / r, p.z / r
    scale = -edge.turn / np.sqrt(dot(outwards, outwards))
    found.normal[n, 0], found.normal[n, 1] = scale * outwards.x, scale * outwards.y
    found.normal[n, 2] = scale * outwards.z
    found.rays[n, 0], found.rays[n, 1] = front, back
    found.faces[n, 0] = edge.face
    found.faces[n, 1] = int(np.int64(rays.face[back // width, back % width]))


@inner_kernel
def _without_empty(found: Places) -> Places:
    """Return the places without pairs for which no edge was found; the arrays are reused."""
    kept = 0
    for n in range(found.number):
        if found.rays[n, 0] >= 0:
            found.direction[kept], found.normal[kept] = found.direction[n], found.normal[n]
            found.range_m[kept], found.rays[kept] = found.range_m[n], found.rays[n]
            found.faces[kept] = found.faces[n]
            kept += 1
    return Places(kept, found.direction, found.normal, found.range_m, found.rays, found.faces)


@inlined_kernel
def direction_of(rays: Rays, ray: int) -> Vector:
    """Return the unit direction of a ray, by its row-major index, sensor axes."""
    width, components = rays.face.shape[1], rays.grid.components
    i, j = ray // width, ray % width
    return Vector(components[0, i, j], components[1, i, j], components[2, i, j])


@inlined_kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product of two vectors."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@inlined_kernel
def dot(a: Vector, b: Vector) -> float:
    """Return the dot product of two vectors."""
    return a.x * b.x + a.y * b.y + a.z * b.z
