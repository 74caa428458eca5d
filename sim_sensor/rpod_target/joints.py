"""Joints of a target: parts that turn about an axis, such as a solar array; and the target at given angles.

A jointed target is put together from pieces that are built once: the target without the parts of its joints,
and the parts of each joint alone. At any angles the triangles, edges and model points of the pieces are
turned and joined, and the distance field is the least of those of the pieces, which takes 0.1 to 0.5 s.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_schemas.arrays import FloatArray
from rpod_target.target import DistanceField, Target


def posed(target: Target, angles_rad: Mapping[str, float]) -> Target:
    """Return a jointed target at given angles as a rigid target; a target without joints is unchanged.

    Centre of mass and inertia stay those of the file.

    Args:
        target: the target.
        angles_rad: angle of each joint by its name; 0 for those that are left out.
    """
    if target.fixed is None:
        return target
    pieces = _pieces(target, angles_rad)
    return replace(
        _joined(target, pieces, angles_rad),
        field=_least(pieces),
        reliable=None if target.reliable is None else posed(target.reliable, angles_rad),
    )


def shown(target: Target, angles_rad: Mapping[str, float]) -> Target:
    """Return the surfaces of ``posed`` alone, for emulators, which is faster; its distance field is wrong."""
    return target if target.fixed is None else _joined(target, _pieces(target, angles_rad), angles_rad)


def _pieces(target: Target, angles_rad: Mapping[str, float]) -> list["_Piece"]:
    assert target.fixed is not None  # noqa: S101 - a target with joints
    return [
        _Piece(target.fixed, RigidTransform.identity()),
        *(_Piece(joint.moving, joint.turned(angles_rad.get(joint.name, 0.0))) for joint in target.joints),
    ]


@dataclass(frozen=True, eq=False)
class _Piece:
    """A piece of the target at its place."""

    piece: Target
    motion: RigidTransform

    def distance_m(self, points_m: FloatArray) -> NDArray[np.float32]:
        """Return the distances of points from the piece, target axes, shape (N, 3), m."""
        return sampled(self.piece.require_field(), self.motion.inv().apply(points_m)).astype(np.float32)

    def points(self, points_m: FloatArray) -> FloatArray:
        """Return points of the piece, shape (..., 3), at its place."""
        moved: FloatArray = self.motion.apply(points_m.reshape(-1, 3)).reshape(points_m.shape)
        return moved

    def normals(self, normals: FloatArray) -> FloatArray:
        """Return normals of the piece, shape (..., 3), at its place."""
        turned: FloatArray = self.motion.rotation.apply(normals.reshape(-1, 3)).reshape(normals.shape)
        return turned


def _joined(target: Target, pieces: Sequence[_Piece], angles_rad: Mapping[str, float]) -> Target:
    """Return the target that consists of pieces; edges and model points inside another piece are left out."""
    parts: list[str] = []
    fields: dict[str, list[NDArray[Any]]] = {}
    for each in pieces:
        piece = each.piece
        edges_m, model_points_m = each.points(piece.edges_m), each.points(piece.model_points_m)
        others = [other for other in pieces if other is not each]
        seen = _outside(model_points_m, others)
        shown = _outside(edges_m.mean(axis=1), others)
        found: dict[str, NDArray[Any]] = {
            "triangles_m": each.points(piece.triangles_m),
            "normals": each.normals(piece.normals),
            "triangle_material": piece.triangle_material,
            "triangle_part": piece.triangle_part + len(parts),
            "edges_m": edges_m[shown],
            "edge_normals": each.normals(piece.edge_normals)[shown],
            "model_points_m": model_points_m[seen],
            "model_normals": each.normals(piece.model_normals)[seen],
        }
        for name, array in found.items():
            fields.setdefault(name, []).append(array)
        parts += piece.parts
    arrays: dict[str, Any] = {name: np.concatenate(arrays) for name, arrays in fields.items()}
    arrays["triangle_part"] = arrays["triangle_part"].astype(np.int32)
    radius_m = float(np.linalg.norm(arrays["triangles_m"], axis=-1).max())
    angles = ",".join(f"{joint.name}={angles_rad.get(joint.name, 0.0):.9f}" for joint in target.joints)
    digest = hashlib.sha256(f"{target.digest}/{angles}".encode()).hexdigest()
    return replace(
        target,
        digest=digest,
        content="",  # these arrays are not those of a file
        parts=tuple(parts),
        radius_m=radius_m,
        joints=(),
        fixed=None,
        **arrays,
    )


def _outside(points_m: FloatArray, pieces: Sequence[_Piece]) -> NDArray[np.bool_]:
    """Return which points, (N, 3), lie inside no piece, shape (N,)."""
    outside = np.ones(len(points_m), np.bool_)
    for each in pieces:
        outside &= each.distance_m(points_m) >= 0.0
    return outside


def _least(pieces: Sequence[_Piece]) -> DistanceField:
    """Return the field of the least distances from pieces, on the grid of the first one, which is extended.

    A piece counts within the block around its own grid; elsewhere only the first piece counts.
    """
    field = pieces[0].piece.require_field()
    spacing_m, shape = field.spacing_m, np.array(field.values.shape)
    around = [_cells(each, field) for each in pieces[1:]]
    first = np.min([np.zeros(3, int), *(least for least, _ in around)], axis=0)
    last = np.max([shape, *(end for _, end in around)], axis=0)
    values = _extended(field, first, last)
    for each, (least, end) in zip(pieces[1:], around, strict=True):
        block = tuple(map(slice, least - first, end - first))
        axes_m = [field.origin_m[axis] + spacing_m * np.arange(least[axis], end[axis]) for axis in range(3)]
        places_m = np.stack(np.meshgrid(*axes_m, indexing="ij"), axis=-1)
        distance_m = each.distance_m(places_m.reshape(-1, 3)).reshape(places_m.shape[:3])
        values[block] = np.minimum(values[block], distance_m)
    return DistanceField(field.origin_m + spacing_m * first, spacing_m, values)


def _extended(field: DistanceField, first: NDArray[np.int64], last: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return a field's values from a first node to before a last one; beyond its grid as in ``sampled``."""
    shape = np.array(field.values.shape)
    values = np.pad(field.values, np.column_stack((-first, last - shape)), mode="edge")
    nodes = np.ogrid[*map(slice, first, last)]
    way = [node - node.clip(0, size - 1) for node, size in zip(nodes, shape, strict=True)]
    values += field.spacing_m * np.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
    return values


def _cells(each: _Piece, field: DistanceField) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the nodes of a field around a piece's own field: the first along each axis, and the ends."""
    corners = (each.points(_corners_m(each.piece.require_field())) - field.origin_m) / field.spacing_m
    return np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int) + 1


def _corners_m(field: DistanceField) -> FloatArray:
    """Return the corners of a field's grid, shape (8, 3)."""
    ends = field.spacing_m * (np.array(field.values.shape) - 1.0)
    corners: FloatArray = field.origin_m + ends * np.array(list(product((0.0, 1.0), repeat=3)))
    return corners


def sampled(field: DistanceField, points_m: FloatArray) -> FloatArray:
    """Return the distances in a field at points, (N, 3), shape (N,), m.

    They are trilinear inside the grid. Outside they are the distance at the grid's border plus the way there,
    which is at least the distance from the surface.
    """
    from scipy.ndimage import map_coordinates  # noqa: PLC0415 - few of all processes sample a field

    cells = (points_m - field.origin_m) / field.spacing_m
    inside = np.clip(cells, 0.0, np.array(field.values.shape) - 1.0)
    way_m = field.spacing_m * np.linalg.norm(cells - inside, axis=1)
    found = map_coordinates(field.values, inside.T, order=1, mode="nearest")
    distance_m: FloatArray = found + way_m
    return distance_m
