"""Builds a target's arrays from its parameters: the slow part of loading, which needs Open3D."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import Array, FloatArray
from rpod_target.build.interior import Bodies, Body
from rpod_target.build.mass import mass_properties
from rpod_target.build.pieces import NUDGE, Piece, Sides, outward, pieces, varied
from rpod_target.build.sampling import sample_evenly
from rpod_target.errors import TargetError
from rpod_target.mesh.files import MeshFile
from rpod_target.mesh.topology import creases, unit_normals
from rpod_target.parameters import LARGEST_M, SMALLEST_M, MeshParameters, TargetParameters, usual_size
from rpod_target.variation import Variation
from rpod_target.visibility import Sky

_MOST_NODES = 30_000_000
_USUAL_NODES = 4_000_000
"""Largest number of nodes of a grid whose spacing is not given."""
_SPACING, _MARGIN = 0.01, 0.15
"""Spacing and margin of a grid for which they are not given, over the target's longest side."""


def build_arrays(
    parameters: TargetParameters,
    meshes: Mapping[str, bytes],
    *,
    source: str,
    read: Mapping[str, MeshFile] = MappingProxyType({}),
    variation: Variation | None = None,
) -> dict[str, Array]:
    """Return the arrays of a target by the names of ``Target``'s fields, and those of its distance field.

    Args:
        parameters: parameters of the target; all materials that it names exist.
        meshes: the mesh files' contents, and those of the files beside them, by name.
        source: parameter file, for error messages.
        read: mesh files that are read already, by name.
        variation: what differs in a model of the target.

    Raises:
        TargetError: a mesh cannot be read, the target's size is unlikely and not confirmed, or the distance
            field is too large.
    """
    found = pieces(parameters, meshes, read, source=source)
    if variation is not None:
        found = varied(found, variation)
    triangles_m = np.concatenate([piece.triangles_m for piece in found])
    size_m = float(np.ptp(triangles_m, axis=(0, 1)).max())
    _check_size(parameters, size_m, source=source)
    nudge_m = NUDGE * size_m
    sky = Sky(triangles_m) if any(piece.loose.any() for piece in found) else None
    shown = [_shown(piece, sky, nudge_m=nudge_m) for piece in found]
    bodies = Bodies(_bodies([piece for piece, _ in shown], sky))
    surface = _both_sides(shown, parameters)

    def hidden(points_m: FloatArray, normals: FloatArray) -> NDArray[np.bool_]:
        return bodies.depth_m(points_m + nudge_m * normals) > 0.0

    model_points_m, model_normals = sample_evenly(
        surface.triangles_m[surface.seen], parameters.model_points, hidden=hidden
    )
    edges_m, edge_normals = _wireframe(shown, bodies, parameters, nudge_m=nudge_m)
    told = [text for piece, _ in shown for text in piece.told]
    return {
        "triangles_m": surface.triangles_m,
        "normals": unit_normals(surface.triangles_m),
        "triangle_material": surface.material,
        "triangle_part": surface.part,
        "back_parts": surface.back_parts,
        "edges_m": edges_m,
        "edge_normals": edge_normals,
        "model_points_m": model_points_m,
        "model_normals": model_normals,
        "repairs": np.array(told, dtype=np.str_),
        **_mass_arrays(shown, parameters, source=source),
        **_field_arrays(triangles_m, bodies, parameters, source=source),
    }


@dataclass(frozen=True, eq=False)
class _Surface:
    """All sides of all pieces that are surfaces of the target."""

    triangles_m: FloatArray
    """Corners, target axes, shape (T, 3, 3)."""
    part: NDArray[np.int32]
    """Index of each triangle's part, shape (T,)."""
    material: NDArray[np.int32]
    """Index of each triangle's material, shape (T,)."""
    seen: NDArray[np.bool_]
    """Whether each triangle can be seen from outside, shape (T,)."""
    back_parts: NDArray[np.int32]
    """Index of the part whose back it is, for each part beyond those of the parameters, shape (B,)."""


def _check_size(parameters: TargetParameters, size_m: float, *, source: str) -> None:
    if usual_size(size_m) or parameters.confirmed_size:
        return
    scaled = [
        f"parts.{index}.{'longest_side_m' if part.metres_per_unit is None else 'metres_per_unit'}"
        for index, part in enumerate(parameters.parts)
        if isinstance(part, MeshParameters)
    ]
    raise TargetError(
        source,
        scaled[0] if scaled else "parts",
        f"the target's longest side is {size_m:.4g} m, and {SMALLEST_M} m to {LARGEST_M:.0f} m are usual: "
        "correct the unit, or if the size is right add confirmed_size: true to the file (--confirm-size of "
        "rpod target new)",
    )


def _shown(piece: Piece, sky: Sky | None, *, nudge_m: float) -> tuple[Piece, Sides]:
    if sky is None:
        count = len(piece.triangles_m)
        return piece, Sides(np.ones(count, bool), np.zeros(count, bool))
    return outward(piece, sky, nudge_m=nudge_m)


def _bodies(found: Sequence[Piece], sky: Sky | None) -> list[Body]:
    bodies: list[Body] = []
    for piece in found:
        bodies += piece.bodies
        if sky is not None and piece.loose.any():
            bodies.append(Body.of_open_surface(piece.triangles_m[piece.loose], sky))
    return bodies


def _both_sides(shown: Sequence[tuple[Piece, Sides]], parameters: TargetParameters) -> _Surface:
    """Return all fronts, then the backs that may be seen, as parts of their own."""
    index = {name: number for number, name in enumerate(parameters.materials)}
    triangles_m = np.concatenate([piece.triangles_m for piece, _ in shown])
    part = np.concatenate([piece.part for piece, _ in shown])
    material = np.array([index[name] for piece, _ in shown for name in piece.materials], np.int32)
    seen = np.concatenate([sides.front for _, sides in shown])
    back = np.concatenate([sides.back for _, sides in shown])
    back_parts, back_part = np.unique(part[back], return_inverse=True)
    part = np.concatenate([part, len(parameters.parts) + back_part.reshape(-1)])
    order = np.argsort(part, kind="stable")
    every_side = np.concatenate([triangles_m, triangles_m[back][:, ::-1]])
    seen = np.concatenate([seen, np.ones(np.count_nonzero(back), bool)])
    return _Surface(
        every_side[order],
        part[order].astype(np.int32),
        np.concatenate([material, material[back]])[order],
        seen[order] if seen.any() else np.ones(len(seen), bool),
        back_parts.astype(np.int32),
    )


def _wireframe(
    shown: Sequence[tuple[Piece, Sides]], bodies: Bodies, parameters: TargetParameters, *, nudge_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return the creases of all pieces that are not inside a body; a rim on another part's face is kept."""
    angle_rad = np.deg2rad(parameters.edge_crease_deg)
    found = []
    for piece, sides in shown:
        found.append(creases(piece.triangles_m[sides.front | ~piece.loose], angle_rad=angle_rad))
        if sides.back.any():
            segments_m, normals = creases(piece.triangles_m[sides.back][:, ::-1], angle_rad=angle_rad)
            rim = (normals[:, 0] == -normals[:, 1]).all(axis=1)  # the front's creases have it
            found.append((segments_m[~rim], normals[~rim]))
    segments_m = np.concatenate([segments for segments, _ in found])
    normals = np.concatenate([normals for _, normals in found])
    buried = np.ones(len(segments_m), bool)
    for share in (0.05, 0.5, 0.95):
        points_m = (1.0 - share) * segments_m[:, 0] + share * segments_m[:, 1]
        buried[buried] &= bodies.depth_m(points_m[buried]) > nudge_m
    return segments_m[~buried], normals[~buried]


def _mass_arrays(
    shown: Sequence[tuple[Piece, Sides]], parameters: TargetParameters, *, source: str
) -> dict[str, Array]:
    """Return the mass properties that the parameters do not give."""
    if parameters.centre_of_mass_m is not None and parameters.inertia_kg_m2 is not None:
        return {}
    closed = [surface for piece, _ in shown for surface in piece.closed_m]
    try:
        found = mass_properties(
            np.concatenate(closed) if closed else np.zeros((0, 3, 3)),
            np.concatenate([piece.triangles_m for piece, _ in shown]),
            mass_kg=parameters.mass_kg,
            density_kg_m3=parameters.density_kg_m3,
            spread=parameters.mass_spread,
        )
    except ValueError as error:
        raise TargetError(source, "density_kg_m3", str(error)) from error
    arrays: dict[str, Array] = {}
    if parameters.centre_of_mass_m is None:
        arrays["centre_of_mass_m"] = found.centre_m
    if parameters.inertia_kg_m2 is None:
        arrays["inertia_kg_m2"] = found.inertia_kg_m2
    return arrays


def _field_arrays(
    triangles_m: FloatArray, bodies: Bodies, parameters: TargetParameters, *, source: str
) -> dict[str, Array]:
    corners_m = triangles_m.reshape(-1, 3)
    extent_m = np.ptp(corners_m, axis=0)
    margin_m, spacing_m = parameters.distance_field.margin_m, parameters.distance_field.spacing_m
    if margin_m is None:
        margin_m = _MARGIN * float(extent_m.max())
    if spacing_m is None:
        volume_m3 = float((extent_m + 2.0 * margin_m).prod())
        spacing_m = max(_SPACING * float(extent_m.max()), (volume_m3 / _USUAL_NODES) ** (1.0 / 3.0))
    origin_m = corners_m.min(axis=0) - margin_m
    shape = np.ceil((extent_m + 2.0 * margin_m) / spacing_m) + 1.0
    if shape.prod() > _MOST_NODES:
        raise TargetError(
            source,
            "distance_field.spacing_m",
            f"{spacing_m} m gives a grid of {shape.prod():.2g} nodes, at most {_MOST_NODES:.2g} are allowed; "
            "increase it",
        )
    field = bodies.distance_field(origin_m=origin_m, spacing_m=spacing_m, shape=shape.astype(int).tolist())
    return {
        "field_origin_m": field.origin_m,
        "field_spacing_m": np.array(spacing_m),
        "field_values": field.values,
    }
