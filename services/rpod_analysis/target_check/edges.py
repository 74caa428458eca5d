"""Straight edges of a target, and the range up to which each sensor resolves them."""

from dataclasses import dataclass

import numpy as np

from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.config.lidar import LidarConfig
from rpod_schemas.config.pmd import PmdConfig
from rpod_target import Target

_SAMPLES = 5
"""Least length, in pixels or steps of a scan, of an edge that is seen."""
_ROUND = 1e3
"""Places and directions of lines are equal within a thousandth, over the target's size."""


@dataclass(frozen=True)
class Edge:
    """A straight edge, put together from the wireframe's segments on one line."""

    middle_m: tuple[float, float, float]
    """Middle, target axes."""
    length_m: float
    angle_deg: float
    """Angle between the normals of its two faces; 180 at an open rim."""
    seen_up_to_m: dict[str, float]
    """Range up to which the edge, seen at a right angle, is as long as five pixels, by sensor."""


def resolution_rad() -> dict[str, float]:
    """Return the angle between neighbouring pixels or rays of each sensor in its default configuration."""
    return {"lidar": float(np.radians(LidarConfig().pattern.step_deg)), "pmd": 1.0 / PmdConfig().camera.fx}


def straight_edges(target: Target) -> list[Edge]:
    """Return the straight edges of a target, the longest first."""
    if not len(target.edges_m):
        return []
    start_m, end_m = target.edges_m[:, 0], target.edges_m[:, 1]
    length_m = np.linalg.norm(end_m - start_m, axis=1)
    used = length_m > 0.0
    start_m, end_m, length_m = start_m[used], end_m[used], length_m[used]
    along = (end_m - start_m) / length_m[:, None]
    along *= np.where(along[np.arange(len(along)), np.argmax(np.abs(along), axis=1)] < 0.0, -1.0, 1.0)[
        :, None
    ]
    foot_m = start_m - np.einsum("ij,ij->i", start_m, along)[:, None] * along
    key = np.round(_ROUND * np.hstack([along, foot_m / target.radius_m])).astype(np.int64)
    _, line = np.unique(key, axis=0, return_inverse=True)
    normals = target.edge_normals[used]
    cosine = np.clip(np.einsum("ij,ij->i", normals[:, 0], normals[:, 1]), -1.0, 1.0)
    angle_deg = np.degrees(np.arccos(cosine))
    edges = []
    order = np.argsort(line.reshape(-1), kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(line.reshape(-1)[order])) + 1):
        at_m = np.stack([start_m[group], end_m[group]]) @ along[group[0]]
        edges += _merged_segments(group, np.sort(at_m, axis=0), along[group[0]], foot_m[group[0]], angle_deg)
    return sorted(edges, key=lambda edge: -edge.length_m)


def _merged_segments(
    group: Array, at_m: FloatArray, along: FloatArray, foot_m: FloatArray, angle_deg: FloatArray
) -> list[Edge]:
    """Return the edges on one line: segments that touch are one edge."""
    order = np.argsort(at_m[0])
    low, high, angle = at_m[0][order], at_m[1][order], angle_deg[group][order]
    reach = np.maximum.accumulate(high)
    first = np.append(0, np.flatnonzero(low[1:] > reach[:-1] + 1e-6) + 1)
    edges = []
    for begin, stop in zip(first, np.append(first[1:], len(low)), strict=True):
        length_m = float(reach[stop - 1] - low[begin])
        x, y, z = (float(value) for value in foot_m + 0.5 * (low[begin] + reach[stop - 1]) * along)
        seen = {name: length_m / (_SAMPLES * angle_rad) for name, angle_rad in resolution_rad().items()}
        edges.append(Edge((x, y, z), length_m, float(np.median(angle[begin:stop])), seen))
    return edges
