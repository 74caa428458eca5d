"""Builds a target's arrays from its parameters: the slow part of loading, which needs Open3D."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import Array, FloatArray
from rpod_target.errors import TargetError
from rpod_target.interior import Bodies
from rpod_target.parameters import (
    BoxParameters,
    CylinderParameters,
    FrustumParameters,
    MeshParameters,
    PartParameters,
    PrismParameters,
    TargetParameters,
)
from rpod_target.sampling import sample_evenly
from rpod_target.stl import read_stl
from rpod_target.surfaces import Surface, box_surface, cylinder_surface, frustum_surface, prism_surface
from rpod_target.topology import creases, open_edges, separate_surfaces, unit_normals, volume_m3

_MOST_NODES = 30_000_000
_NUDGE = 1e-4
"""Distance, over the target's size, by which a point is moved off its surface for the inside test."""


@dataclass(frozen=True, eq=False)
class _Part:
    name: str
    surface: Surface
    open_edges: int


def build_arrays(
    parameters: TargetParameters, meshes: Mapping[str, bytes], *, source: str
) -> dict[str, Array]:
    """Return the arrays of a target by the names of ``Target``'s fields, and those of its distance field.

    Args:
        parameters: parameters of the target; all materials that it names exist.
        meshes: the mesh files' contents, by the name that the parameters give them.
        source: parameter file, for error messages.

    Raises:
        TargetError: a mesh cannot be read, has no size or faces inwards, or the distance field is too large.
    """
    parts = [
        _placed(part, meshes, source=source, field=f"parts.{index}")
        for index, part in enumerate(parameters.parts)
    ]
    triangles_m = np.concatenate([part.surface.triangles_m for part in parts])
    bodies = Bodies([body for part in parts if not part.open_edges for body in _bodies(part)])
    nudge_m = _NUDGE * float(np.ptp(triangles_m, axis=(0, 1)).max())

    def hidden(points_m: FloatArray, normals: FloatArray) -> NDArray[np.bool_]:
        return bodies.depth_m(points_m + nudge_m * normals) > 0.0

    model_points_m, model_normals = sample_evenly(triangles_m, parameters.model_points, hidden=hidden)
    edges_m, edge_normals = _wireframe(parts, bodies, parameters, nudge_m=nudge_m)
    return {
        "triangles_m": triangles_m,
        "normals": unit_normals(triangles_m),
        "triangle_material": _material_indices(parts, parameters),
        "triangle_part": np.repeat(
            np.arange(len(parts), dtype=np.int32), [len(part.surface.triangles_m) for part in parts]
        ),
        "edges_m": edges_m,
        "edge_normals": edge_normals,
        "model_points_m": model_points_m,
        "model_normals": model_normals,
        **_field_arrays(parts, bodies, parameters, source=source),
    }


def _placed(part: PartParameters, meshes: Mapping[str, bytes], *, source: str, field: str) -> _Part:
    surface = _surface(part, meshes, source=source, field=field)
    corners_m = part.T_target_part.apply(surface.triangles_m.reshape(-1, 3)).reshape(-1, 3, 3)
    placed = _Part(part.name, Surface(corners_m, surface.materials), open_edges(corners_m))
    if not placed.open_edges and min(volume_m3(body) for body in _bodies(placed)) <= 0.0:
        raise TargetError(
            source,
            f"{field}.file",
            "a closed surface has no volume, or its triangles run clockwise seen from outside; correct the "
            "mesh, or reverse the order of its corners",
        )
    return placed


def _bodies(part: _Part) -> list[FloatArray]:
    return separate_surfaces(part.surface.triangles_m)


def _surface(part: PartParameters, meshes: Mapping[str, bytes], *, source: str, field: str) -> Surface:
    match part:
        case BoxParameters():
            return box_surface(part)
        case PrismParameters():
            return prism_surface(part)
        case FrustumParameters():
            return frustum_surface(part)
        case CylinderParameters():
            return cylinder_surface(part)
        case MeshParameters():
            try:
                return _mesh_surface(part, meshes[part.file])
            except ValueError as error:
                raise TargetError(source, f"{field}.file", f"{part.file} {error}") from error


def _mesh_surface(part: MeshParameters, content: bytes) -> Surface:
    corners = read_stl(content)
    longest = float(np.ptp(corners, axis=(0, 1)).max())
    scale = part.metres_per_unit or (part.longest_side_m or 0.0) / longest
    return Surface(scale * corners, (part.material,) * len(corners))


def _material_indices(parts: list[_Part], parameters: TargetParameters) -> NDArray[np.int32]:
    index = {name: number for number, name in enumerate(parameters.materials)}
    return np.array([index[name] for part in parts for name in part.surface.materials], np.int32)


def _wireframe(
    parts: list[_Part], bodies: Bodies, parameters: TargetParameters, *, nudge_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return creases of all parts without those inside a body; a rim on another part's face is kept."""
    angle_rad = np.deg2rad(parameters.edge_crease_deg)
    found = [creases(part.surface.triangles_m, angle_rad=angle_rad) for part in parts]
    segments_m = np.concatenate([segments for segments, _ in found])
    normals = np.concatenate([normals for _, normals in found])
    buried = np.ones(len(segments_m), bool)
    for share in (0.05, 0.5, 0.95):
        points_m = (1.0 - share) * segments_m[:, 0] + share * segments_m[:, 1]
        buried &= bodies.depth_m(points_m) > nudge_m
    return segments_m[~buried], normals[~buried]


def _field_arrays(
    parts: list[_Part], bodies: Bodies, parameters: TargetParameters, *, source: str
) -> dict[str, Array]:
    gaps = [
        f"part {part.name!r} has a hole: {part.open_edges} open edges" for part in parts if part.open_edges
    ]
    if gaps:
        return {"not_closed": np.array("; ".join(gaps))}
    margin_m, spacing_m = parameters.distance_field.margin_m, parameters.distance_field.spacing_m
    corners_m = np.concatenate([part.surface.triangles_m for part in parts]).reshape(-1, 3)
    origin_m = corners_m.min(axis=0) - margin_m
    shape = np.ceil((np.ptp(corners_m, axis=0) + 2.0 * margin_m) / spacing_m) + 1.0
    if shape.prod() > _MOST_NODES:
        raise TargetError(
            source,
            "distance_field.spacing_m",
            f"{spacing_m} m gives a grid of {shape.prod():.2g} nodes, at most {_MOST_NODES:.2g} are allowed; "
            "increase it",
        )
    field = bodies.distance_field(origin_m=origin_m, spacing_m=spacing_m, shape=shape.astype(int).tolist())
    return {"field_origin_m": field.origin_m, "field_values": field.values}
