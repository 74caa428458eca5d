"""Triangles of the polygons of a mesh file, concave ones too; no corner of a polygon is lost."""

import numpy as np

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh.topology import Indices

_FLAT = 1e-9
"""Doubled area of a corner, over the square of the polygon's size, below which the corner is straight."""
_SAME_AREA = 1e-6
"""Largest relative difference between the area of the triangles and that of the polygon."""


def concave(corners: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which polygons, corners (P, N, 3), turn back at a corner, so that a fan may overlap; (P,)."""
    corners = corners - corners[:, :1]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, corners - np.roll(corners, 1, axis=1)
    normal = np.cross(corners, np.roll(corners, -1, axis=1)).sum(axis=1)  # Newell
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    turn = np.einsum("pni,pi->pn", np.cross(behind, ahead), normal / np.where(length > 0.0, length, 1.0))
    size = np.ptp(corners, axis=1).max(axis=1, keepdims=True)
    back: np.ndarray[tuple[int], np.dtype[np.bool_]] = (turn < -_FLAT * size**2).any(axis=1)
    return back


def triangulated(corners: FloatArray) -> Indices:
    """Return the triangles of a polygon, corners (N, 3), as numbers of its corners, shape (N - 2, 3).

    They face as the polygon does. Corners on a straight side are in triangles without area, so that
    neighbours keep their shared edges. A polygon that cuts through itself is split as a fan.
    """
    import mapbox_earcut  # noqa: PLC0415 - only files with concave polygons need it

    count, corners = len(corners), corners - corners[0]
    normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    drop = int(np.argmax(np.abs(normal)))
    flat = np.ascontiguousarray(corners[:, [(drop + 1) % 3, (drop + 2) % 3]], np.float64)
    area = 0.5 * _cross(flat, np.roll(flat, -1, axis=0)).sum()
    found = mapbox_earcut.triangulate_float64(flat, np.array([count], np.uint32))
    triangles = np.asarray(found, np.int64).reshape(-1, 3)
    signed = 0.5 * _cross(
        flat[triangles[:, 1]] - flat[triangles[:, 0]], flat[triangles[:, 2]] - flat[triangles[:, 0]]
    )
    if not len(triangles) or abs(np.abs(signed).sum() - abs(area)) > _SAME_AREA * abs(area):
        return _fan(np.arange(count))
    turned = signed * area < 0.0
    triangles[turned] = triangles[turned][:, ::-1]
    return np.concatenate([triangles, *_straight_sides(triangles, count)])


def _straight_sides(triangles: Indices, count: int) -> list[Indices]:
    """Return triangles without area for the corners that the triangles leave out."""
    used = np.unique(triangles)
    ends = np.append(used[1:], used[0] + count)
    return [
        _fan(np.arange(begin, end + 1) % count)
        for begin, end in zip(used, ends, strict=True)
        if end > begin + 1
    ]


def _fan(places: Indices) -> Indices:
    """Return the triangles between the first corner and each side, shape (N - 2, 3)."""
    return np.stack([np.full(len(places) - 2, places[0]), places[1:-1], places[2:]], axis=1)


def _cross(one: FloatArray, other: FloatArray) -> FloatArray:
    crossed: FloatArray = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return crossed
