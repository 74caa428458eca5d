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
from rpod_geometry.lines import Lines, end_line, first_line, lines_of, slopes_ahead
from rpod_pose.lidar.scan_likelihood import Assumptions, Rays
from rpod_pose.registration.lie_group import PoseArrays, Vector, in_target
from rpod_pose.registration.surface_model import Faces
from rpod_schemas.arrays import FloatArray

JUMP = 4.0
"""Least difference of two ranges at which a surface ends, in standard deviations of a range. Physics: the
noise of a difference is 1.4 times that of a range, so that one in 200 pairs on one surface seems to be a
jump."""
NEARER = 0.5
"""Largest distance of an edge from the surface that ends there, over the distance from this surface to the
one behind it. Hand: an edge that is farther away belongs to a hidden surface."""

MOST_CROSSINGS = 16
"""Number of edges for each pair of rays for which there is memory at first. Numerics: more are searched
again."""


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


class Pairs(NamedTuple):
    """Pairs of neighbouring rays between which a surface may end, row by row, with the numbers of places."""

    number: int
    """Number of pairs, P; the arrays may be longer."""
    first: NDArray[np.int64]
    """Number of each row's first pair, and the number of all pairs, shape (rows + 1,)."""
    column: NDArray[np.int64]
    """Column of each pair's first ray, shape (P,)."""
    way: NDArray[np.int64]
    """0 if the other ray is the next one in the row, 1 if it is in the column, shape (P,)."""


class Crossings(NamedTuple):
    """Edges that cross between the rays of pairs, in the edges' order."""

    pair: NDArray[np.int64]
    """Number of each crossing's pair, shape (N,)."""
    edge: NDArray[np.int64]
    """Number of its edge, shape (N,)."""
    ray: NDArray[np.int64]
    """Row-major index of the pair's first ray, shape (N,)."""
    share: FloatArray
    """Where the edge crosses: 0 is its start, 1 its end, shape (N,)."""


@inlined_kernel
def places(pose: PoseArrays, rays: Rays, assumed: Assumptions) -> Places:
    """Return the places of the outline at a pose.

    Args:
        pose: pose of the target in the sensor.
        rays: rays and target; their buffers hold the target rendered at the pose.
        assumed: statistics of returns.
    """
    pairs, facing = _pairs(pose, rays, JUMP * assumed.sigma_m), _facing(pose, rays.faces)
    return _nearest(pose, rays, pairs, facing, _crossings(pose, rays, pairs, facing))


@inlined_kernel
def along(normal: Vector, offset_m: float, t: Vector, direction: Vector) -> float:
    """Return the range at which a ray meets a face's plane, m; inf if it never does.

    Args:
        normal: the face's normal, target axes.
        offset_m: its plane's offset, n . v0.
        t: position of the target in the sensor, but in target axes, m.
        direction: the ray's unit vector, target axes.
    """
    height_m = offset_m + normal.x * t.x + normal.y * t.y + normal.z * t.z
    found = height_m / dot(normal, direction)
    return found if found > 0.0 else np.inf


@inlined_kernel
def row_of(vectors: FloatArray, n: int) -> Vector:
    """Return one of the vectors, shape (N, 3)."""
    return Vector(vectors[n, 0], vectors[n, 1], vectors[n, 2])


@inlined_kernel
def ray_of(components: FloatArray, i: int, j: int) -> Vector:
    """Return the unit vector of a ray in its row and column, sensor axes, from ``GridArrays.components``."""
    return Vector(components[0, i, j], components[1, i, j], components[2, i, j])


@inner_kernel
def _pairs(pose: PoseArrays, rays: Rays, limit_m: float) -> Pairs:
    """Return the pairs of neighbours between which a surface may end.

    Args:
        pose: pose of the target in the sensor.
        rays: rays and target; their buffers hold the target rendered at the pose.
        limit_m: largest distance of a ray's hit from the other ray's plane at which both meet one surface.
    """
    face, range_m, components = rays.face, rays.range_m, rays.grid.components
    normals, offsets_m, R = rays.faces.normals, rays.faces.offsets_m, pose.R
    height, width = face.shape
    t = in_target(R, pose.t[0], pose.t[1], pose.t[2])
    first, count = np.empty(height + 1, np.int64), 0
    column, ways = np.empty(2 * face.size, np.int64), np.empty(2 * face.size, np.int64)
    for i in range(height):
        first[i] = count
        for n in range(2 * width):
            j, way = n // 2, n % 2
            k, m = i + way, j + 1 - way
            if k == height or m == width:
                continue
            a, b = int(np.int64(face[i, j])), int(np.int64(face[k, m]))
            if a == b:
                continue
            if a >= 0 and b >= 0:
                one, two = ray_of(components, i, j), ray_of(components, k, m)
                one, two = in_target(R, one.x, one.y, one.z), in_target(R, two.x, two.y, two.z)
                forth = abs(along(row_of(normals, a), offsets_m[a], t, two) - np.float64(range_m[k, m]))
                aback = abs(along(row_of(normals, b), offsets_m[b], t, one) - np.float64(range_m[i, j]))
                if forth <= limit_m or aback <= limit_m:
                    continue
            column[count], ways[count] = j, way
            count += 1
    first[height] = count
    return Pairs(count, first, column, ways)


@inner_kernel
def _crossings(pose: PoseArrays, rays: Rays, pairs: Pairs, facing: NDArray[np.bool_]) -> Crossings:
    """Return the edges at which a visible surface ends and that cross between the rays of pairs.

    Args:
        pose: pose of the target in the sensor.
        rays: rays and target.
        pairs: pairs of neighbouring rays between which a surface may end.
        facing: which faces the sensor sees from outside, shape (T,).
    """
    most, found, number = MOST_CROSSINGS * pairs.number, _room(0), 1
    while number > found.share.size:  # memory that grows within the loop over edges would take longer
        found = _room(max(most, number))
        number = _fill_crossings(found, pose, rays, pairs, facing)
    return Crossings(found.pair[:number], found.edge[:number], found.ray[:number], found.share[:number])


@inner_kernel
def _fill_crossings(
    found: Crossings, pose: PoseArrays, rays: Rays, pairs: Pairs, facing: NDArray[np.bool_]
) -> int:
    """Fill crossings as far as there is memory, and return their number; arguments as for ``_crossings``."""
    beside, ends_m, components = rays.faces.edges.faces, rays.faces.edges.ends_m, rays.grid.components
    rows = lines_of(rays.grid.row_lower, rays.grid.row_upper)
    columns = lines_of(rays.grid.column_lower, rays.grid.column_upper)
    width, first, column, ways = rays.face.shape[1], pairs.first, pairs.column, pairs.way
    of_pair, of_edge, of_ray, shares, number = found.pair, found.edge, found.ray, found.share, 0
    for n in range(beside.shape[0]):
        one, two = beside[n, 0], beside[n, 1]
        if facing[one] == facing[two] and not (one == two and facing[one]):
            continue
        start, end = _end(pose, ends_m, n, 0), _end(pose, ends_m, n, 1)
        block = _block(rows, columns, start, end)
        if block.top == block.bottom and block.left == block.right:  # the edge lies between the rays
            continue
        for i in range(max(block.top - 1, 0), block.bottom):
            for pair in range(first[i], first[i + 1]):
                j, way = column[pair], ways[pair]
                if j >= block.right or j + 1 < block.left or (i < block.top if way == 0 else j < block.left):
                    continue
                a, b = ray_of(components, i, j), ray_of(components, i + way, j + 1 - way)
                share = _crossing(start, end, a, b)
                if share < 0.0:
                    continue
                if number < shares.size:
                    of_pair[number], of_edge[number], of_ray[number] = pair, n, i * width + j
                    shares[number] = share
                number += 1
    return number


@inner_kernel
def _room(most: int) -> Crossings:
    """Return memory for a number of crossings."""
    numbers = np.empty((3, most), np.int64)
    return Crossings(numbers[0], numbers[1], numbers[2], np.empty(most))


@inlined_kernel
def _facing(pose: PoseArrays, faces: Faces) -> NDArray[np.bool_]:
    """Return which faces the sensor sees from outside, shape (T,)."""
    origin = in_target(pose.R, -pose.t[0], -pose.t[1], -pose.t[2])
    facing, n, offsets_m = np.empty(faces.offsets_m.size, np.bool_), faces.normals, faces.offsets_m
    for f in range(facing.size):
        facing[f] = n[f, 0] * origin.x + n[f, 1] * origin.y + n[f, 2] * origin.z > offsets_m[f]
    return facing


@inlined_kernel
def _end(pose: PoseArrays, ends_m: FloatArray, edge: int, end: int) -> Vector:
    """Return one end, 0 or 1, of an edge, sensor axes, m, from the ends of all edges, (E, 2, 3), target axes.

    The index is given, and not the edge's part of the array: each part counts a reference, which takes
    longer than the product.
    """
    R, t = pose.R, pose.t
    x, y, z = ends_m[edge, end, 0], ends_m[edge, end, 1], ends_m[edge, end, 2]
    return Vector(
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0],
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1],
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2],
    )


@inlined_kernel
def _block(rows: Lines, columns: Lines, start: Vector, end: Vector) -> Block:
    """Return the rows and columns of the grid that an edge, sensor axes, may cross."""
    left, right = slopes_ahead(start.x, start.z, end.x, end.z)
    top, bottom = slopes_ahead(start.y, start.z, end.y, end.z)
    return Block(
        first_line(rows, top), end_line(rows, bottom), first_line(columns, left), end_line(columns, right)
    )


@inlined_kernel
def _crossing(start: Vector, end: Vector, a: Vector, b: Vector) -> float:
    """Return where an edge crosses between two rays: 0 is its start, 1 its end; -1 if it does not cross.

    Args:
        start: start of the edge, sensor axes, m.
        end: its end.
        a: unit vector of the first ray.
        b: unit vector of the other ray.
    """
    plane = cross(a, b)
    above, below = dot(plane, start), dot(plane, end)
    if above * below > 0.0 or above == below:
        return -1.0
    u = above / (above - below)
    p = between(start, end, u)
    of_a, of_b = dot(cross(p, b), plane), dot(cross(a, p), plane)
    return -1.0 if of_a < 0.0 or of_b < 0.0 or not of_a + of_b > 0.0 else u


@inner_kernel
def _nearest(
    pose: PoseArrays, rays: Rays, pairs: Pairs, facing: NDArray[np.bool_], crossings: Crossings
) -> Places:
    """Return the place of each pair at the crossing edge that is nearest to the surface that ends there.

    Args:
        pose: pose of the target in the sensor.
        rays: rays and target; their buffers hold the target rendered at the pose.
        pairs: pairs of neighbouring rays between which a surface may end.
        facing: which faces the sensor sees from outside, shape (T,).
        crossings: edges that cross between the pairs' rays.
    """
    beside, ends_m, components = rays.faces.edges.faces, rays.faces.edges.ends_m, rays.grid.components
    face, range_m, width, R = rays.face, rays.range_m, rays.face.shape[1], pose.R
    normals, offsets_m = rays.faces.normals, rays.faces.offsets_m
    t, off_m = in_target(R, pose.t[0], pose.t[1], pose.t[2]), np.full(pairs.number, np.inf)
    direction, normal, r_m = np.empty((off_m.size, 3)), np.empty((off_m.size, 3)), np.empty(off_m.size)
    of_rays, of_faces = np.full((off_m.size, 2), -1), np.empty((off_m.size, 2), np.int64)
    for c in range(crossings.share.size):
        n, edge, ray = crossings.pair[c], crossings.edge[c], crossings.ray[c]
        start, end = _end(pose, ends_m, edge, 0), _end(pose, ends_m, edge, 1)
        sees_first = facing[beside[edge, 0]]
        ends, turn = int(np.int64(beside[edge, 0 if sees_first else 1])), 1.0 if sees_first else -1.0
        front, back = ray, ray + (1 if pairs.way[n] == 0 else width)
        a, b = (
            ray_of(components, front // width, front % width),
            ray_of(components, back // width, back % width),
        )
        p, outwards = between(start, end, crossings.share[c]), cross(start, end)
        if turn * (dot(a, outwards) - dot(b, outwards)) > 0.0:
            front, back, a = back, front, b
        r, d = np.sqrt(dot(p, p)), in_target(R, a.x, a.y, a.z)
        near_m = np.float64(range_m[front // width, front % width])
        far_m = np.float64(range_m[back // width, back % width])
        off = min(abs(near_m - r), abs(near_m - along(row_of(normals, ends), offsets_m[ends], t, d)))
        if r >= far_m or off >= off_m[n] or off > NEARER * (far_m - near_m):
            continue
        scale = -turn / np.sqrt(dot(outwards, outwards))
        off_m[n], r_m[n] = off, r
        direction[n, 0], direction[n, 1], direction[n, 2] = p.x / r, p.y / r, p.z / r
        normal[n, 0], normal[n, 1], normal[n, 2] = scale * outwards.x, scale * outwards.y, scale * outwards.z
        of_rays[n, 0], of_rays[n, 1], of_faces[n, 0] = front, back, ends
        of_faces[n, 1] = int(np.int64(face[back // width, back % width]))
    return _without_empty(Places(off_m.size, direction, normal, r_m, of_rays, of_faces))


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
def between(start: Vector, end: Vector, share: float) -> Vector:
    """Return the point of a line at a share of the way from its start to its end."""
    return Vector(
        start.x + share * (end.x - start.x),
        start.y + share * (end.y - start.y),
        start.z + share * (end.z - start.z),
    )


@inlined_kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product of two vectors."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@inlined_kernel
def dot(a: Vector, b: Vector) -> float:
    """Return the dot product of two vectors."""
    return a.x * b.x + a.y * b.y + a.z * b.z
