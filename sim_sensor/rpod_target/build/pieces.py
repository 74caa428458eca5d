"""The surfaces of a target: analytic parts, and mesh files after their repair, placed in target axes.

A piece is what is repaired together: one analytic part, or all parts that one mesh file gives at one pose, so
that a shell whose objects or materials share its edges stays one shell.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_target.build.interior import Body
from rpod_target.build.surfaces import Surface, box_surface, cylinder_surface, frustum_surface, prism_surface
from rpod_target.errors import TargetError
from rpod_target.mesh.files import MeshFile, read_mesh_file
from rpod_target.mesh.repair import RepairedMesh, repair
from rpod_target.mesh.simplification import coarser, simplified
from rpod_target.mesh.topology import Indices, areas_m2, separate_surfaces
from rpod_target.mesh.unusable import NO_AREA
from rpod_target.parameters import (
    BoxParameters,
    CylinderParameters,
    FrustumParameters,
    MeshParameters,
    PartParameters,
    PrismParameters,
    TargetParameters,
)
from rpod_target.variation import Variation
from rpod_target.visibility import Sky

NUDGE = 1e-4
"""Distance, over the target's size, by which a point is moved off its surface for the inside test."""
_MOST_BODIES = 100
"""Number of closed surfaces of a file that are bodies of their own, the largest; the others are one body."""
_SEEN = 0.5 / 128
"""Share of the directions that see a side above which the side is a surface of the target: one direction."""
_CLEARLY = 1.2
"""Ratio of the visibility of a patch's back to that of its front above which the patch faces the wrong
way."""

_ERROR = 1e-3
"""Largest error of the simplification, over the longest side of the file's bounding box."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Surfaces in target axes."""

    triangles_m: FloatArray
    """Corners, shape (T, 3, 3), counter-clockwise seen from outside."""
    part: Indices
    """Index of each triangle's part among the target's parts, shape (T,)."""
    materials: tuple[str, ...]
    """Name of each triangle's material, length T."""
    closed_m: tuple[FloatArray, ...]
    """Triangles of each closed surface, those of cavities included."""
    bodies: tuple[Body, ...]
    """Closed surfaces, ready for the inside test."""
    loose: NDArray[np.bool_]
    """Whether each triangle belongs to a surface that is not closed, shape (T,)."""
    patch: Indices
    """Number of the patch of each triangle, shape (T,): within one, all triangles face the same side."""
    told: tuple[str, ...] = ()
    """Description of the repair."""


@dataclass(frozen=True, eq=False)
class Sides:
    """Sides of a piece's triangles that are surfaces of the target."""

    front: NDArray[np.bool_]
    """Whether the front may be seen, shape (T,)."""
    back: NDArray[np.bool_]
    """Whether the back may be seen, shape (T,)."""


def pieces(
    parameters: TargetParameters, meshes: Mapping[str, bytes], read: Mapping[str, MeshFile], *, source: str
) -> list[Piece]:
    """Return the surfaces of all parts, in the order of the parts.

    Args:
        parameters: parameters of the target.
        meshes: the mesh files' contents, and those of the files beside them, by name.
        read: mesh files that are read already, by name.
        source: parameter file, for error messages.

    Raises:
        TargetError: a mesh file cannot be read or has no object of a name.
    """
    files = dict(read)
    done: set[int] = set()
    found = []
    for index, part in enumerate(parameters.parts):
        if not isinstance(part, MeshParameters):
            found.append(_analytic(part, index))
        elif index not in done:
            together = _parts_of_one_mesh_file(parameters, index)
            done |= set(together)
            try:
                if part.file not in files:
                    files[part.file] = read_mesh_file(
                        part.file, meshes[part.file], meshes, largest_mb=part.largest_file_mb
                    )
                found.append(_of_file(files[part.file], together, source=source))
            except ValueError as error:
                raise TargetError(source, f"parts.{index}.file", f"{part.file} {error}") from error
    return found


def _analytic(part: PartParameters, index: int) -> Piece:
    surface = _surface(part)
    corners_m = _placed(part, surface.triangles_m)
    closed = separate_surfaces(corners_m)
    count = len(corners_m)
    return Piece(
        corners_m,
        np.full(count, index),
        surface.materials,
        tuple(closed),
        tuple(Body(one) for one in closed),
        loose=np.zeros(count, bool),
        patch=np.zeros(count, np.int64),
    )


def _surface(part: PartParameters) -> Surface:
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
            raise AssertionError("a mesh is no analytic part")


def _placed(part: PartParameters, triangles_m: FloatArray) -> FloatArray:
    corners_m: FloatArray = part.T_target_part.apply(triangles_m.reshape(-1, 3)).reshape(-1, 3, 3)
    return corners_m


def _parts_of_one_mesh_file(parameters: TargetParameters, index: int) -> dict[int, MeshParameters]:
    """Return the parts, from an index on, that are different objects of one file at one scale and pose."""
    found: dict[int, MeshParameters] = {}
    objects: set[str] = set()
    place = None
    for number, part in enumerate(parameters.parts[index:], index):
        if not isinstance(part, MeshParameters):
            continue
        here = (
            part.file,
            part.longest_side_m,
            part.metres_per_unit,
            part.T_target_part.as_matrix().tobytes(),
        )
        place = place or here
        if number == index or (here == place and part.object is not None and part.object not in objects):
            found[number] = part
            if part.object is None:
                break
            objects.add(part.object)
    return found


def _of_file(file: MeshFile, parts: Mapping[int, MeshParameters], *, source: str) -> Piece:
    """Return the objects of a file that the parts name, repaired together and placed."""
    first = next(iter(parts.values()))
    longest = float(np.ptp(file.triangles, axis=(0, 1)).max())
    if not longest > 0.0:
        raise ValueError(NO_AREA)
    scale = first.metres_per_unit or (first.longest_side_m or 0.0) / longest
    part = np.full(len(file.triangles), -1)
    for number, one in parts.items():
        if one.object is not None and one.object not in file.objects:
            known = ", ".join(repr(name) for name in file.objects)
            reason = f"{one.file} has no object {one.object!r}: name one of {known}"
            raise TargetError(source, f"parts.{number}.object", reason)
        _check_materials(file, number, one, source=source)
        chosen = True if one.object is None else file.triangle_object == file.objects.index(one.object)
        part[chosen] = number
    used = np.flatnonzero(part >= 0)
    error = (first.largest_error_m or _ERROR * scale * longest) / scale
    triangles, nearest, fewer = simplified(file.triangles[used], largest_error=error)
    mesh = repair(triangles)
    origin = used[nearest[mesh.origin]]
    told = list(mesh.told)
    if fewer is not None:
        told.insert(
            0, f"{fewer[1]} triangles were reduced to {fewer[0]}, at most {1e3 * scale * fewer[2]:.2g} mm off"
        )
    return _piece(
        replace(mesh, triangles=_placed(first, scale * mesh.triangles)),
        part[origin],
        tuple(_material_names(file, origin, part, parts)),
        told=tuple(f"{PurePath(first.file).name}: {text}" for text in told),
    )


def _check_materials(file: MeshFile, number: int, part: MeshParameters, *, source: str) -> None:
    """Raise a TargetError if a part names a material that the mesh file does not have."""
    known = [material.name for material in file.materials]
    unknown = next((name for name in part.file_materials if name not in known), None)
    if unknown is not None:
        listed = ", ".join(map(repr, known)) or "none"
        reason = f"{part.file} has no material {unknown!r}: name one of {listed}, or leave it out"
        raise TargetError(source, f"parts.{number}.file_materials", reason)


def _piece(mesh: RepairedMesh, part: Indices, materials: tuple[str, ...], *, told: tuple[str, ...]) -> Piece:
    """Return the surfaces of a mesh in target axes."""
    closed_m, bodies = _closed(mesh)
    return Piece(
        mesh.triangles, part, materials, closed_m, bodies, loose=mesh.loose, patch=mesh.patch, told=told
    )


def varied(found: Sequence[Piece], variation: Variation) -> list[Piece]:
    """Return the surfaces of a model that differs from the target; those that are missing are left out."""
    size_m = float(np.ptp(np.concatenate([piece.triangles_m for piece in found]), axis=(0, 1)).max())
    surfaces_m = variation.moved([piece.triangles_m for piece in found])
    result = []
    for piece, moved_m in zip(found, surfaces_m, strict=True):
        if not np.ptp(moved_m, axis=(0, 1)).max() > NUDGE * size_m:
            continue
        coarse_m, origin = moved_m, np.arange(len(moved_m))
        if variation.coarse:
            coarse_m, origin = coarser(moved_m, error=variation.coarse * size_m)
        mesh = repair(coarse_m)
        origin = origin[mesh.origin]
        materials = tuple(piece.materials[index] for index in origin)
        result.append(_piece(mesh, piece.part[origin], materials, told=piece.told))
    return result


def _material_names(
    file: MeshFile, origin: Indices, part: Indices, parts: Mapping[int, MeshParameters]
) -> Iterator[str]:
    names = [material.name for material in file.materials] + [""]  # the last for -1, without a material
    for number, material in zip(part[origin].tolist(), file.triangle_material[origin].tolist(), strict=True):
        yield parts[number].file_materials.get(names[material], parts[number].material)


def _closed(mesh: RepairedMesh) -> tuple[tuple[FloatArray, ...], tuple[Body, ...]]:
    """Return the triangles of each closed surface, and the bodies: the largest, and the others as one."""
    order = np.argsort(mesh.surface, kind="stable")
    bounds = np.searchsorted(mesh.surface[order], np.arange(len(mesh.open_edges) + 1))
    closed = np.flatnonzero((mesh.open_edges == 0) & ~mesh.no_inside)
    surfaces = [mesh.triangles[order[bounds[number] : bounds[number + 1]]] for number in closed]
    solid = [surface for surface, number in zip(surfaces, closed, strict=True) if not mesh.cavity[number]]
    if len(solid) > _MOST_BODIES:
        solid.sort(key=lambda surface: -float(np.ptp(surface, axis=(0, 1)).max()))
        solid[_MOST_BODIES:] = [np.concatenate(solid[_MOST_BODIES:])]
    return tuple(surfaces), tuple(Body.of_mesh(surface) for surface in solid)


def outward(piece: Piece, sky: Sky, *, nudge_m: float) -> tuple[Piece, Sides]:
    """Return a piece whose open patches show their more visible side, and which sides may be seen.

    Both sides of an open surface may be surfaces of the target; of a closed one, only the front.
    """
    count = len(piece.triangles_m)
    seen, back = np.ones(count, bool), np.zeros(count, bool)
    loose = np.flatnonzero(piece.loose)
    if not len(loose):
        return piece, Sides(seen, back)
    front_share, back_share = sky.sides(piece.triangles_m[loose], nudge_m=nudge_m)
    area_m2 = areas_m2(piece.triangles_m[loose])
    patch = piece.patch[loose]
    wrong = np.bincount(patch, area_m2 * back_share) > _CLEARLY * np.bincount(patch, area_m2 * front_share)
    turn = wrong[patch]
    triangles_m = piece.triangles_m.copy()
    triangles_m[loose[turn]] = triangles_m[loose[turn]][:, ::-1]
    seen[loose] = np.where(turn, back_share, front_share) > _SEEN
    back[loose] = np.where(turn, front_share, back_share) > _SEEN
    told = piece.told
    if turn.any():
        told = (
            *told,
            f"{np.count_nonzero(turn)} triangles of open surfaces were turned to their visible side",
        )
    if back.any():
        told = (
            *told,
            f"{np.count_nonzero(back)} triangles of open surfaces are seen from both sides: the second sides "
            "are parts whose names end with -back",
        )
    return replace(piece, triangles_m=triangles_m, told=told), Sides(seen, back)
