"""Casting of single rays at a mesh through a tree of boxes, in a time that hardly depends on the mesh's size.

``rays`` tests all triangles for each image. This is fastest for cameras, which have more rays than a target
has triangles. A scanning LIDAR has a few hundred rays on the target. For these, and for rays between those of
a grid, a binary tree of axis-aligned boxes is faster. It is split by the surface area heuristic (I. Wald, On
fast Construction of SAH-based Bounding Volume Hierarchies, IEEE Symposium on Interactive Ray Tracing, 2007).
Triangles are intersected by the method of T. Moeller and B. Trumbore (Fast, Minimum Storage Ray-Triangle
Intersection, Journal of Graphics Tools 2(1), 1997).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_geometry.rays import GridArrays
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

BINS = 16
"""Number of places along an axis at which a node may be split."""
LEAF = 4
"""Number of triangles below which a node is not split further."""
DEPTH = 96
"""Length of the stack of nodes that a ray has yet to visit."""
BESIDE = 1e-7
"""Tolerance of the barycentric coordinates, so that no ray passes between two neighbouring triangles."""


class RayTree(NamedTuple):
    """A mesh in a tree of boxes, in the form that the kernels take."""

    boxes_m: Float32Array
    """Least and greatest corner of each node's box, target axes, shape (nodes, 6)."""
    first: NDArray[np.int32]
    """Left child of an inner node, whose right child follows it; first triangle of a leaf, shape (nodes,)."""
    held: NDArray[np.int32]
    """Number of triangles of a leaf, 0 for an inner node, shape (nodes,)."""
    sides_m: FloatArray
    """First corner and two sides from it of the triangles in the leaves' order, shape (T, 3, 3)."""
    triangle: NDArray[np.int32]
    """Index of each of these triangles in the mesh, shape (T,)."""


class Ray(NamedTuple):
    """A ray in target axes, created by ``ray``. Its numbers stay in the registers of a processor."""

    from_x: float
    from_y: float
    from_z: float
    """Components of its start, m."""
    x: float
    y: float
    z: float
    """Components of its unit direction."""
    per_x: float
    per_y: float
    per_z: float
    """Inverse components of its unit direction."""


class Waiting(NamedTuple):
    """Memory for the nodes that a ray has yet to visit."""

    node: NDArray[np.int32]
    """Index of each node, shape (DEPTH + 1,)."""
    entry_m: FloatArray
    """Range at which the ray enters its box, shape (DEPTH + 1,)."""


class Hit(NamedTuple):
    """First intersection of a ray."""

    range_m: float
    """Distance along the ray; inf if it meets nothing."""
    triangle: int
    """Index of the triangle in the mesh; -1 if it meets nothing."""


def ray_tree(triangles_m: FloatArray) -> RayTree:
    """Return the tree of a mesh.

    Args:
        triangles_m: corners, target axes, shape (T, 3, 3), counter-clockwise from outside.
    """
    boxes, first, count, order = _built(np.ascontiguousarray(triangles_m, np.float64))
    corners = triangles_m[order].astype(np.float64)
    sides = np.stack((corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return RayTree(boxes, first, count, np.ascontiguousarray(sides), order)


class _Nodes(NamedTuple):
    """A tree of boxes without its triangles; the first three fields are those of ``RayTree``."""

    boxes_m: Float32Array
    first: NDArray[np.int32]
    held: NDArray[np.int32]
    order: NDArray[np.int32]
    """Indices of the triangles in the order of the tree, shape (T,)."""


class _Split(NamedTuple):
    """A plane that splits a node's triangles by their centres."""

    axis: int
    """Axis, -1 if no split is better than none."""
    place_m: float


@kernel
def _built(triangles: FloatArray) -> _Nodes:
    """Return the nodes over triangles, shape (T, 3, 3), m."""
    total = triangles.shape[0]
    low, high = np.empty((total, 3)), np.empty((total, 3))
    for n in range(total):
        for k in range(3):
            low[n, k] = min(triangles[n, 0, k], triangles[n, 1, k], triangles[n, 2, k])
            high[n, k] = max(triangles[n, 0, k], triangles[n, 1, k], triangles[n, 2, k])
    order = np.arange(total).astype(np.int32)
    boxes = np.empty((max(2 * total, 1), 6), np.float32)
    first, count = np.zeros(max(2 * total, 1), np.int32), np.zeros(max(2 * total, 1), np.int32)
    count[0], nodes = total, 1
    stack, waiting = np.zeros((DEPTH, 2), np.int32), 1  # node and depth
    while waiting > 0:
        waiting -= 1
        node, depth = stack[waiting, 0], stack[waiting, 1]
        begin, end = first[node], first[node] + count[node]
        _fill_box(boxes[node], low, high, order[begin:end])
        if count[node] <= LEAF or depth >= DEPTH - 2:
            continue
        axis, place = _split(low, high, order[begin:end])
        if axis < 0:
            continue
        middle = begin
        for n in range(begin, end):
            if 0.5 * (low[order[n], axis] + high[order[n], axis]) < place:
                order[n], order[middle] = order[middle], order[n]
                middle += 1
        if (middle - begin) * (end - middle) == 0:
            continue
        for child in range(2):
            first[nodes + child] = middle if child else begin
            count[nodes + child] = end - middle if child else middle - begin
            stack[waiting, 0], stack[waiting, 1] = nodes + child, depth + 1
            waiting += 1
        first[node], count[node] = nodes, 0
        nodes += 2
    return _Nodes(boxes[:nodes].copy(), first[:nodes].copy(), count[:nodes].copy(), order)


@inner_kernel
def _fill_box(box: Float32Array, low: FloatArray, high: FloatArray, chosen: NDArray[np.int32]) -> None:
    """Fill a box, shape (6,), with the bounds of the chosen triangles, rounded outwards.

    Args:
        box: output, m.
        low: least coordinates of the triangles, shape (T, 3), m.
        high: largest coordinates, shape (T, 3), m.
        chosen: indices of triangles, shape (N,).
    """
    for k in range(3):
        least, most = np.inf, -np.inf
        for n in chosen:
            least, most = min(least, low[n, k]), max(most, high[n, k])
        margin = 1e-6 * max(abs(least), abs(most), most - least)
        box[k], box[3 + k] = least - margin, most + margin


@inner_kernel
def _split(low: FloatArray, high: FloatArray, chosen: NDArray[np.int32]) -> _Split:
    """Return the plane with the least cost for a ray; arguments as for ``_fill_box``."""
    best, axis, place = np.inf, -1, 0.0
    counts, bounds = np.zeros(BINS, np.int64), np.zeros((BINS, 6))
    for k in range(3):
        least, most = np.inf, -np.inf
        for n in chosen:
            centre = 0.5 * (low[n, k] + high[n, k])
            least, most = min(least, centre), max(most, centre)
        width = (most - least) / BINS
        if not width > 0.0:
            continue
        counts[:] = 0
        bounds[:, :3], bounds[:, 3:] = np.inf, -np.inf
        for n in chosen:
            b = min(int((0.5 * (low[n, k] + high[n, k]) - least) / width), BINS - 1)
            counts[b] += 1
            for i in range(3):
                bounds[b, i] = min(bounds[b, i], low[n, i])
                bounds[b, 3 + i] = max(bounds[b, 3 + i], high[n, i])
        for cut in range(1, BINS):
            cost = _cost(counts[:cut], bounds[:cut]) + _cost(counts[cut:], bounds[cut:])
            if cost < best:
                best, axis, place = cost, k, least + cut * width
    return _Split(axis, place)


@inner_kernel
def _cost(counts: NDArray[np.int64], bounds: FloatArray) -> float:
    """Return the number of triangles in bins, shape (B,), times half the area of their box, m2.

    Args:
        counts: number of triangles in each bin.
        bounds: bounds of each bin's triangles, shape (B, 6), m.
    """
    total, side = 0, np.zeros(3)
    for b in range(counts.size):
        total += counts[b]
    if total == 0:
        return 0.0
    for k in range(3):
        side[k] = bounds[:, 3 + k].max() - bounds[:, k].min()
    return float(total * (side[0] * side[1] + side[1] * side[2] + side[2] * side[0]))


@kernel
def no_nodes() -> Waiting:
    """Return memory for the nodes of one ray after the other."""
    return Waiting(np.empty(DEPTH + 1, np.int32), np.empty(DEPTH + 1))


@inlined_kernel
def ray(origin: FloatArray, x: float, y: float, z: float) -> Ray:
    """Return a ray.

    Args:
        origin: its start, target axes, shape (3,), m.
        x: first component of its unit direction, target axes.
        y: second component.
        z: third component.
    """
    return Ray(origin[0], origin[1], origin[2], x, y, z, 1.0 / x, 1.0 / y, 1.0 / z)


@inlined_kernel
def first_hit(tree: RayTree, ray: Ray, waiting: Waiting) -> Hit:
    """Return the first triangle that a ray meets from its outer side.

    Args:
        tree: the target's mesh.
        ray: the ray.
        waiting: memory.
    """
    boxes, first, held = tree.boxes_m, tree.first, tree.held
    nearest, found = np.inf, -1
    waiting.node[0], waiting.entry_m[0], number = 0, _entry(boxes, 0, ray, nearest), 1
    while number > 0:
        number -= 1
        if waiting.entry_m[number] >= nearest:
            continue
        node = waiting.node[number]
        while node >= 0 and held[node] == 0:  # down to the leaf that the ray enters first
            near_child, far_child = first[node], first[node] + 1
            near, far = _entry(boxes, near_child, ray, nearest), _entry(boxes, far_child, ray, nearest)
            if far < near:
                near, far, near_child, far_child = far, near, far_child, near_child
            if far < nearest:
                waiting.node[number], waiting.entry_m[number] = far_child, far
                number += 1
            node = near_child if near < nearest else -1
        if node < 0:
            continue
        for n in range(first[node], first[node] + held[node]):
            along = met(tree.sides_m, n, ray)
            if along < nearest:
                nearest, found = along, n
    if found < 0:
        return Hit(np.inf, -1)
    return Hit(nearest, int(np.int64(tree.triangle[found])))


@inlined_kernel
def met(sides: FloatArray, n: int, ray: Ray) -> float:
    """Return the range at which a ray meets a triangle from its outer side, m; inf if it does not.

    Args:
        sides: ``RayTree.sides_m``.
        n: index of the triangle there.
        ray: the ray.
    """
    ax, ay, az = sides[n, 1, 0], sides[n, 1, 1], sides[n, 1, 2]
    bx, by, bz = sides[n, 2, 0], sides[n, 2, 1], sides[n, 2, 2]
    px, py, pz = ray.y * bz - ray.z * by, ray.z * bx - ray.x * bz, ray.x * by - ray.y * bx
    det = ax * px + ay * py + az * pz
    if not det > 0.0:  # seen from behind, or edge-on
        return np.inf
    sx, sy, sz = ray.from_x - sides[n, 0, 0], ray.from_y - sides[n, 0, 1], ray.from_z - sides[n, 0, 2]
    u = sx * px + sy * py + sz * pz
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    v = ray.x * qx + ray.y * qy + ray.z * qz
    if min(u, v) < -BESIDE * det or u + v > (1.0 + BESIDE) * det:
        return np.inf
    along = (bx * qx + by * qy + bz * qz) / det
    return along if along > 0.0 else np.inf


@inlined_kernel
def _entry(boxes: Float32Array, node: int, ray: Ray, nearest: float) -> float:
    """Return the range at which a ray enters a node's box, m; inf if it does not before ``nearest``.

    Args:
        boxes: ``RayTree.boxes_m``.
        node: index of the node.
        ray: the ray.
        nearest: range of the nearest triangle so far, m.
    """
    ax, bx = (boxes[node, 0] - ray.from_x) * ray.per_x, (boxes[node, 3] - ray.from_x) * ray.per_x
    ay, by = (boxes[node, 1] - ray.from_y) * ray.per_y, (boxes[node, 4] - ray.from_y) * ray.per_y
    az, bz = (boxes[node, 2] - ray.from_z) * ray.per_z, (boxes[node, 5] - ray.from_z) * ray.per_z
    begin = max(min(ax, bx), min(ay, by), min(az, bz), 0.0)
    end = min(max(ax, bx), max(ay, by), max(az, bz), nearest)
    return begin if begin <= end else np.inf


@kernel
def silhouette_m2(tree: RayTree, lines: FloatArray) -> float:
    """Return the mean area of a mesh's silhouette over all directions, m2.

    It is the share of random lines through a sphere around the mesh that meet the mesh, times the area of
    the sphere's own silhouette (A. Cauchy and M. W. Crofton; L. A. Santalo, Integral Geometry and Geometric
    Probability, 2004, section III.14).

    Args:
        tree: the mesh.
        lines: even samples in [0, 1) that give a direction and a place each, shape (N, 4).
    """
    box, waiting, met = tree.boxes_m[0].astype(np.float64), no_nodes(), 0
    centre, radius_m = 0.5 * (box[:3] + box[3:]), 0.5 * np.sqrt(((box[3:] - box[:3]) ** 2).sum())
    for n in range(lines.shape[0]):
        z, turn, place = 2.0 * lines[n, 0] - 1.0, 2.0 * np.pi * lines[n, 1], 2.0 * np.pi * lines[n, 2]
        flat, beside_m = np.sqrt(1.0 - z * z), radius_m * np.sqrt(lines[n, 3])
        along = np.array((flat * np.cos(turn), flat * np.sin(turn), z))
        across = np.array((-np.sin(turn), np.cos(turn), 0.0))
        up = np.array((-z * np.cos(turn), -z * np.sin(turn), flat))
        origin = centre - radius_m * along + beside_m * (np.cos(place) * across + np.sin(place) * up)
        met += first_hit(tree, ray(origin, along[0], along[1], along[2]), waiting).triangle >= 0
    return float(np.pi * radius_m**2 * met / lines.shape[0])


@kernel
def cast_tree(  # noqa: PLR0917
    grid: GridArrays,
    tree: RayTree,
    R: FloatArray,
    t: FloatArray,
    range_m: Float32Array,
    triangle: NDArray[np.int32],
) -> None:
    """Fill ``range_m`` and ``triangle`` like ``rays.cast_pose`` with back faces culled.

    Args:
        grid: ``RayGrid.arrays``.
        tree: the target's mesh.
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        range_m: output, shape (rows, columns), m.
        triangle: output, shape (rows, columns).
    """
    rays, box = grid.components, tree.boxes_m[0]
    origin, centre, radius2, waiting = np.empty(3), t.copy(), 0.0, no_nodes()
    for k in range(3):
        origin[k] = -(R[0, k] * t[0] + R[1, k] * t[1] + R[2, k] * t[2])
        middle, half = 0.5 * (box[k] + box[3 + k]), 0.5 * (box[3 + k] - box[k])
        radius2 += half * half
        for i in range(3):
            centre[i] += R[i, k] * middle
    beyond = centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2 - radius2
    for i in range(triangle.shape[0]):
        for j in range(triangle.shape[1]):
            x, y, z = rays[0, i, j], rays[1, i, j], rays[2, i, j]
            along = x * centre[0] + y * centre[1] + z * centre[2]
            range_m[i, j], triangle[i, j] = np.inf, -1
            if beyond > 0.0 and (along <= 0.0 or along * along < beyond):
                continue
            hit = first_hit(tree, in_target(R, origin, x, y, z), waiting)
            range_m[i, j], triangle[i, j] = hit.range_m, hit.triangle


@inlined_kernel
def in_target(R: FloatArray, origin: FloatArray, x: float, y: float, z: float) -> Ray:
    """Return a ray, from its unit components in sensor axes.

    Args:
        R: R_sensor_target, shape (3, 3).
        origin: position of the sensor, target axes, shape (3,), m.
        x: first component.
        y: second component.
        z: third component.
    """
    return ray(
        origin,
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )
