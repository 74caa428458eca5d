"""Openings of a target's surfaces, with their places."""

from dataclasses import dataclass

import numpy as np

from rpod_schemas.arrays import Array, FloatArray
from rpod_target import Target
from rpod_target.mesh.topology import Indices, components, directed_edges, welded


@dataclass(frozen=True)
class Opening:
    """A connected rim of edges with one face: of a hole, or of a sheet."""

    parts: tuple[str, ...]
    """Parts whose surfaces have the rim."""
    centre_m: tuple[float, float, float]
    """Mean of the rim's corners, target axes."""
    edges: int
    length_m: float
    """Length of the rim."""
    extent_m: float
    """Longest side of the rim's bounding box."""


def openings(target: Target) -> list[Opening]:
    """Return the openings of a target's surfaces, the longest first."""
    backs = [name.endswith("-back") and name.removesuffix("-back") in target.parts for name in target.parts]
    front = ~np.array(backs)[target.triangle_part]
    triangles_m, part = target.triangles_m[front], target.triangle_part[front]
    index = welded(triangles_m)
    edges = directed_edges(index)
    nodes = int(index.max()) + 1
    key = edges.min(axis=1) * nodes + edges.max(axis=1)
    _, number = np.unique(key, return_inverse=True)
    balance = np.bincount(number.reshape(-1), weights=np.where(edges[:, 0] < edges[:, 1], 1.0, -1.0))
    rim = np.flatnonzero(balance[number.reshape(-1)] != 0.0)
    if not len(rim):
        return []
    place = np.empty((nodes, 3))
    place[index.ravel()] = triangles_m.reshape(-1, 3)
    loop = components(edges[rim], size=nodes)[edges[rim, 0]]
    order = np.argsort(loop, kind="stable")
    groups = np.split(rim[order], np.flatnonzero(np.diff(loop[order])) + 1)
    found = [_opening(target, edges[group], place, part[group // 3]) for group in groups]
    return sorted(found, key=lambda opening: -opening.length_m)


def _opening(target: Target, edges: Indices, place: FloatArray, part: Array) -> Opening:
    ends_m = place[edges]
    x, y, z = (float(value) for value in ends_m.mean(axis=(0, 1)))
    return Opening(
        tuple(target.parts[number] for number in np.unique(part)),
        (x, y, z),
        len(edges),
        float(np.linalg.norm(ends_m[:, 1] - ends_m[:, 0], axis=1).sum()),
        float(np.ptp(ends_m, axis=(0, 1)).max()),
    )
