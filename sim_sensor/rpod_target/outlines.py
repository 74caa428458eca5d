"""Plane faces of a target and their outlines, which a camera shows as straight lines, corners and circles.

Klionovska et al., Robotics 7(1), 2018, section 3.1, Fig. 4d, compare the amplitude image with a wireframe:
the lines of the front hexagon and the extreme point of the nose. Here the wireframe is computed from the
triangles of any target: coplanar neighbours form a face, and edges that belong to one of them only form its
outline.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh.topology import Indices, areas_m2, components, directed_edges, unit_normals, welded
from rpod_target.target import Target

ROUND_CORNERS = 12
"""Least number of corners, equally far from their mean, of an outline that is a circle."""
_FLAT_RAD = np.deg2rad(1.0)
"""Largest angle between the normals of neighbouring triangles of one face."""
_CREASE_RAD = np.deg2rad(30.0)
"""Least angle between a face and its neighbours: a facet of a curved surface has no visible outline."""
_STRAIGHT = 1e-6
"""Least sine of the turn of an outline at a corner."""
_OUT_OF_ROUND = 1e-3
"""Largest difference in the distances of a circle's corners from its centre, as a share."""


@dataclass(frozen=True, eq=False)
class Face:
    """A plane face with a convex outline."""

    corners_m: FloatArray
    """Corners in order, counter-clockwise seen from outside, target axes, shape (N, 3)."""
    normal: FloatArray
    """Outward unit normal, target axes, shape (3,)."""
    area_m2: float


@dataclass(frozen=True, eq=False)
class Disc:
    """A plane face with a circular outline."""

    centre_m: FloatArray
    """Centre, target axes, shape (3,)."""
    normal: FloatArray
    """Outward unit normal, target axes, shape (3,)."""
    radius_m: float
    """Radius of the circle with the same area as the outline."""


def plane_faces(target: Target, *, min_area_m2: float) -> tuple[list[Face], list[Disc]]:
    """Return a target's plane faces with convex outlines and with circular ones, the largest first.

    Args:
        target: target of any kind; faces are searched within each part.
        min_area_m2: least area of a face, without its holes.
    """
    faces: list[Face] = []
    discs: list[Disc] = []
    for number in range(len(target.parts)):
        triangles_m = target.triangles_m[target.triangle_part == number]
        for corners_m in _outlines(triangles_m, min_area_m2):
            face = _face(corners_m)
            disc = _disc(face)
            if disc is not None:
                discs.append(disc)
            elif _convex(face):
                faces.append(face)
    faces.sort(key=lambda face: -face.area_m2)
    discs.sort(key=lambda disc: -disc.radius_m)
    return faces, discs


def _outlines(triangles_m: FloatArray, min_area_m2: float) -> list[FloatArray]:
    """Return the corners of the longest closed outline of each face, in order."""
    index = welded(triangles_m)
    edges = directed_edges(index)
    twin = _twins(edges)
    cosine = _cosines(triangles_m, twin)
    triangle = np.arange(len(edges)) // 3
    flat = cosine > np.cos(_FLAT_RAD)
    face = components(np.stack([triangle, twin // 3], axis=1)[flat], size=len(triangles_m))
    outer = face[triangle] != np.where(twin < 0, -1, face[twin // 3])
    area_m2 = np.bincount(face, weights=areas_m2(triangles_m))
    area_m2[face[triangle[outer & (cosine > np.cos(_CREASE_RAD))]]] = -1.0
    position = np.zeros((int(index.max()) + 1, 3))
    position[index.ravel()] = triangles_m.reshape(-1, 3)
    loops = [
        _longest_loop(edges[outer & (face[triangle] == number)], position)
        for number in np.flatnonzero(area_m2 >= min_area_m2)
    ]
    return [corners_m for corners_m in map(_without_straight_corners, loops) if len(corners_m) >= 3]


def _twins(edges: Indices) -> Indices:
    """Return the opposite edge of each directed edge, -1 unless there is exactly one."""
    nodes = int(edges.max()) + 1
    key, back = edges @ (nodes, 1), edges @ (1, nodes)
    order = np.argsort(key, kind="stable")
    first = np.searchsorted(key[order], back)
    single = np.searchsorted(key[order], back, side="right") == first + 1
    return np.where(single, order[np.minimum(first, len(order) - 1)], -1)


def _cosines(triangles_m: FloatArray, twin: Indices) -> FloatArray:
    """Return the cosine of the angle between the triangles beside each edge; -1 at a boundary."""
    normals = unit_normals(triangles_m)
    cosine = np.einsum("ij,ij->i", np.repeat(normals, 3, axis=0), normals[twin // 3])
    return np.where(twin < 0, -1.0, cosine)


def _longest_loop(edges: Indices, position_m: FloatArray) -> FloatArray:
    """Return the corners of the longest closed chain of directed edges, shape (N, 3); empty if it forks."""
    follows = dict(edges.tolist())
    if len(follows) < len(edges):
        return np.empty((0, 3))
    loops: list[list[int]] = []
    while follows:
        start, node = follows.popitem()
        loop = [start]
        while node != start and node in follows:
            loop.append(node)
            node = follows.pop(node)
        if node == start:
            loops.append(loop)
    closed = [position_m[loop] for loop in loops]
    return max(closed, key=_length_m, default=np.empty((0, 3)))


def _length_m(corners_m: FloatArray) -> float:
    return float(np.linalg.norm(np.roll(corners_m, -1, axis=0) - corners_m, axis=1).sum())


def _without_straight_corners(corners_m: FloatArray) -> FloatArray:
    if len(corners_m) < 3:
        return corners_m
    turns: NDArray[np.bool_] = np.linalg.norm(_turns(corners_m), axis=1) > _STRAIGHT
    return corners_m[turns]


def _turns(corners_m: FloatArray) -> FloatArray:
    """Return the cross products of the directions into and out of each corner, shape (N, 3)."""
    along = np.roll(corners_m, -1, axis=0) - corners_m
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.asarray(np.cross(np.roll(along, 1, axis=0), along), np.float64)


def _face(corners_m: FloatArray) -> Face:
    spanned = 0.5 * np.cross(corners_m, np.roll(corners_m, -1, axis=0)).sum(axis=0)
    area_m2 = float(np.linalg.norm(spanned))
    return Face(corners_m, spanned / area_m2, area_m2)


def _disc(face: Face) -> Disc | None:
    centre_m = face.corners_m.mean(axis=0)
    distance_m = np.linalg.norm(face.corners_m - centre_m, axis=1)
    if len(distance_m) < ROUND_CORNERS or np.ptp(distance_m) > _OUT_OF_ROUND * distance_m.mean():
        return None
    return Disc(centre_m, face.normal, float(np.sqrt(face.area_m2 / np.pi)))


def _convex(face: Face) -> bool:
    return bool((_turns(face.corners_m) @ face.normal > 0.0).all())
