"""Topology of triangles by shared corners and edges: closedness, separate surfaces and creases."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from rpod_schemas.arrays import FloatArray

_WELD = 1e-6
"""Largest distance of two equal corners, as a share of the surface's extent."""

Indices = NDArray[np.int64]


def unit_normals(triangles_m: FloatArray) -> FloatArray:
    """Return the outward unit normals of triangles, shape (T, 3)."""
    spanned = _spanned(triangles_m)
    unit: FloatArray = spanned / np.linalg.norm(spanned, axis=1, keepdims=True)
    return unit


def areas_m2(triangles_m: FloatArray) -> FloatArray:
    """Return the areas of triangles, shape (T,), m2."""
    areas: FloatArray = 0.5 * np.linalg.norm(_spanned(triangles_m), axis=1)
    return areas


def volume_m3(triangles_m: FloatArray) -> float:
    """Return the volume, m3, inside closed triangles, (N, 3, 3), m; negative if they face inwards.

    By the divergence theorem.
    """
    a, b, c = np.moveaxis(triangles_m - triangles_m.mean(axis=(0, 1)), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def welded(triangles_m: FloatArray) -> Indices:
    """Return corner indices, shape (T, 3): equal corners have equal indices, numbered as they first occur."""
    corners = triangles_m.reshape(-1, 3)
    if not len(corners):  # a part whose triangles all occur in another part too
        return np.zeros((0, 3), np.int64)
    tolerance_m = _WELD * np.ptp(corners, axis=0).max()
    single, number = _unique_corners(corners)  # most corners occur several times, identical to the bit
    pairs = cKDTree(single).query_pairs(tolerance_m, output_type="ndarray")
    return components(pairs, size=len(single))[number].reshape(-1, 3)


def _unique_corners(corners: FloatArray) -> tuple[FloatArray, Indices]:
    """Return different corners in the order in which they first occur, and the number of each corner."""
    order = np.lexsort(corners.T)
    begins = np.append(True, (np.diff(corners[order], axis=0) != 0.0).any(axis=1))
    sorted_number = np.cumsum(begins) - 1
    first = np.full(int(begins.sum()), len(corners))
    np.minimum.at(first, sorted_number, order)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    number = np.empty(len(corners), np.int64)
    number[order] = rank[sorted_number]
    return corners[np.sort(first)], number


def open_edges(triangles_m: FloatArray) -> int:
    """Return the number of directed edges of triangles, (N, 3, 3), without an opposite one; 0 if closed."""
    edges = directed_edges(welded(triangles_m))
    edges = edges[edges[:, 0] != edges[:, 1]]  # leaves out edges of slivers whose corners coincide
    low_first = edges[:, 0] < edges[:, 1]
    _, inverse = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    balance = np.bincount(inverse.reshape(-1), weights=np.where(low_first, 1.0, -1.0))
    return int(np.abs(balance).sum())


def separate_surfaces(triangles_m: FloatArray) -> list[FloatArray]:
    """Return triangles, (N, 3, 3), split into surfaces that share no corner."""
    index = welded(triangles_m)
    edges = directed_edges(index)
    surface = components(edges, size=int(index.max()) + 1)[index[:, 0]]
    return [triangles_m[surface == number] for number in range(int(surface.max()) + 1)]


def edges(triangles_m: FloatArray) -> tuple[FloatArray, Indices]:
    """Return each edge once, shape (E, 2, 3), and the triangles beside it, shape (E, 2).

    An edge with one triangle has this triangle twice; an edge with more than two triangles has two of them.
    """
    directed = directed_edges(welded(triangles_m))
    unique, first, inverse = np.unique(
        np.sort(directed, axis=1), axis=0, return_index=True, return_inverse=True
    )
    last = np.empty(len(unique), np.int64)
    last[inverse.reshape(-1)] = np.arange(len(directed))  # the last assignment counts
    triangle, corner = first // 3, first % 3
    segments = np.stack([triangles_m[triangle, corner], triangles_m[triangle, (corner + 1) % 3]], axis=1)
    return segments, np.stack([triangle, last // 3], axis=1)


def beyond_sides(triangles_m: FloatArray) -> NDArray[np.int32]:
    """Return the triangle beyond each side of each triangle, shape (T, 3); -1 where the surface ends.

    Side c goes from corner c to the next one. Where more than two triangles meet, one of them is returned.
    """
    directed = directed_edges(welded(triangles_m))
    corners = int(directed.max()) + 1
    forward, back = directed @ (corners, 1), directed @ (1, corners)
    order = np.argsort(forward)
    at = np.minimum(np.searchsorted(forward, back, sorter=order), len(order) - 1)
    found = order[at]
    beyond: NDArray[np.int32] = np.where(forward[found] == back, found // 3, -1).astype(np.int32)
    return beyond.reshape(-1, 3)


def creases(triangles_m: FloatArray, *, angle_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return the edges at which faces meet at more than an angle, and those with one face only.

    Returns:
        Segments, shape (E, 2, 3), and the normals of the two faces, shape (E, 2, 3); with one face n and -n.
    """
    segments, faces = edges(triangles_m)
    normals = unit_normals(triangles_m)[faces]
    normals[faces[:, 0] == faces[:, 1], 1] *= -1.0
    is_crease = np.einsum("ij,ij->i", normals[:, 0], normals[:, 1]) < np.cos(angle_rad)
    return segments[is_crease], normals[is_crease]


def components(pairs: Indices, *, size: int) -> Indices:
    """Return the number of each node's component, shape (size,), in a graph of pairs, shape (P, 2)."""
    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    _, component = connected_components(graph, directed=False)
    return np.asarray(component, np.int64)


def _spanned(triangles_m: FloatArray) -> FloatArray:
    return np.cross(triangles_m[:, 1] - triangles_m[:, 0], triangles_m[:, 2] - triangles_m[:, 0])


def directed_edges(index: Indices) -> Indices:
    """Return the directed edges, shape (3 T, 2): row 3 t + c goes from corner c of triangle t to the next."""
    return np.stack([index, np.roll(index, -1, axis=1)], axis=2).reshape(-1, 2)
