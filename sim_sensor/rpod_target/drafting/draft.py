"""Writes the parameter file of a target from a CAD file: parts, materials, scale, mass and symmetries."""

import os
import re
import unicodedata
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import yaml

from rpod_schemas.arrays import FloatArray
from rpod_target.drafting.materials import proposed
from rpod_target.drafting.units import left_over, metres_per_unit, most_sides, rounded
from rpod_target.errors import TargetError
from rpod_target.loading import load_target
from rpod_target.mesh.files import FORMATS, MeshFile, companions, read_mesh_file
from rpod_target.mesh.folder import read_files
from rpod_target.mesh.unusable import LARGEST_FILE_MB
from rpod_target.parameters import MaterialParameters
from rpod_target.target import Target

if TYPE_CHECKING:  # needs Open3D
    from rpod_target.symmetry import FoundSymmetry

_MOST_PARTS = 64
"""Number of objects of a file up to which each is a part; more are one part."""
_ASSUMED_KG_M3 = 50.0
"""Mass over the volume of the bounding box, where no mass is given."""


@dataclass(frozen=True)
class Draft:
    """A parameter file that was written."""

    file: Path
    target: Target
    told: tuple[str, ...]
    """Assumptions, choices and repairs, one sentence each."""


@dataclass(frozen=True)
class DraftOptions:
    """Questions that the CAD file leaves open."""

    units: str | None = None
    """Unit of the file's coordinates, one of ``METRES``."""
    longest_side_m: float | None = None
    """Length of the longest side of the bounding box; it takes precedence over a unit."""
    name: str | None = None
    """Name of the target; by default that of the file."""
    mass_kg: float | None = None
    """Mass."""
    density_kg_m3: float | None = None
    """Density of the parts' volume, instead of the mass."""
    origin: Literal["auto", "file", "centre"] = "auto"
    """Origin of target axes: the file's, the centre of area, or the file's if it lies within the bounding box
    and on the axes of the symmetries, which a target file can only state through its origin."""
    confirmed_size: bool = False
    """Whether a size below 0.05 m or above 500 m is meant."""
    largest_file_mb: float = LARGEST_FILE_MB
    """Largest size of the CAD file with its companions, MB."""


def draft(
    cad: Path,
    out: Path,
    options: DraftOptions,
    *,
    cache: Path | None = None,
    symmetries: "Callable[[Target], Sequence[FoundSymmetry]] | None" = None,
    say: Callable[[str], object] = lambda _: None,
) -> Draft:
    """Write a target's parameter file from a CAD file, build the target, and find its symmetries.

    Args:
        cad: the CAD file.
        out: file to write.
        options: what the CAD file does not say.
        cache: directory of the built targets.
        symmetries: returns the symmetries of a target; by default the exact ones, by its shape alone.
        say: function that is called with a description of each step as it begins.

    Raises:
        TargetError: the CAD file cannot be read, its unit is not known, or the target cannot be built.
    """
    told: list[str] = []
    _refuse_contradictions(cad, out, options)
    say(f"reading {cad.name or cad}")
    mesh = _read(cad, options.largest_file_mb, told)
    scale = metres_per_unit(cad, mesh, options, told)
    told += [*left_over(mesh, scale), *rounded(mesh, scale)]
    out.parent.mkdir(parents=True, exist_ok=True)
    kept = out.read_bytes() if out.exists() else None

    def written(options: DraftOptions) -> "tuple[_Sections, list[FoundSymmetry]]":
        sections = _Sections(cad, out, mesh, options, scale)
        out.write_text(sections.text(()), encoding="utf-8")
        say(f"building the target of {len(mesh.triangles):,} triangles: edges, model points, distance field")
        target = load_target(out, cache=cache, read={sections.file: mesh})
        say("looking for symmetries, and for those that a LIDAR or a camera cannot distinguish")
        return sections, [one for one in (symmetries or _by_shape)(target) if one.mistaken]

    try:
        sections, found = written(options)
        beside_m = max((one.beside_origin_m for one in found), default=0.0)
        if options.origin == "auto" and beside_m > 0.0:
            sections, found = written(replace(options, origin="centre"))
            told.append(
                f"an axis of symmetry passes {beside_m:.3g} m beside the file's origin, which a target file "
                "cannot state: --origin file keeps the origin and leaves the symmetry out"
            )
        told += sections.told
        out.write_text(sections.text(_symmetries(found, told)), encoding="utf-8")
        say("building the target with its symmetries")
        target = load_target(out, cache=cache)
        told += _keep(kept, out)
    except BaseException:
        if kept is None:
            out.unlink(missing_ok=True)
        else:
            out.write_bytes(kept)
        raise
    return Draft(out, target, (*told, *target.repairs))


def _refuse_contradictions(cad: Path, out: Path, options: DraftOptions) -> None:
    """Refuse options of which one would be ignored, and a file that would be taken for a CAD file."""
    if options.mass_kg is not None and options.density_kg_m3 is not None:
        reason = f"is {options.density_kg_m3:g} beside a mass of {options.mass_kg:g} kg: give one of the two"
        raise TargetError(cad, "--density-kg-m3", reason)
    if out.suffix.lower() in FORMATS:
        reason = f"ends with {out.suffix}, as a CAD file does: give another name, such as {cad.stem}.yaml"
        raise TargetError(out, "--out", reason)


def _keep(before: bytes | None, out: Path) -> list[str]:
    """Keep the file that the new text replaces, since it may have been corrected by hand; say where."""
    if before is None or before == out.read_bytes():
        return []
    kept = out.with_name(f"{out.name}.bak")
    kept.write_bytes(before)
    return [f"the file that was there before is kept as {kept}"]


def _read(cad: Path, largest_mb: float, told: list[str]) -> MeshFile:
    try:
        content, beside = read_files(cad, largest_mb=largest_mb, raised_by="--largest-file-mb ")
        told += [
            f"the colours of its materials are not known: {name!r} is not beside {cad.name}; if you "
            "have it, copy it there and write the target again"
            for name in companions(cad.name, content)
            if name not in beside and cad.suffix.lower() == ".obj"
        ]
        return read_mesh_file(cad.name, content, beside, largest_mb=largest_mb)
    except (OSError, ValueError) as error:
        reason = f"cannot be read ({error.strerror})" if isinstance(error, OSError) else str(error)
        raise TargetError(cad, "", reason) from error


class _Sections:
    """The parts of the file's text."""

    def __init__(self, cad: Path, out: Path, mesh: MeshFile, options: DraftOptions, scale: float) -> None:
        self._cad, self._mesh, self._options, self._scale = cad, mesh, options, scale
        self.file = os.path.relpath(cad.resolve(), out.parent.resolve())
        self.told: list[str] = []
        bare = frozenset({_PLAIN} if (mesh.triangle_material < 0).any() else ())
        self._labels = _labels([material.name for material in mesh.materials], taken=bare)
        self._translation_m = self._origin()
        self._mass_line = self._mass()
        if len(mesh.objects) > _MOST_PARTS:
            self.told.append(
                f"its {len(mesh.objects)} objects become one part, since more than {_MOST_PARTS} are no "
                "parts of their own: to name, turn or ignore some of them, join the others in the CAD file"
            )

    def text(self, symmetries: Sequence[str]) -> str:
        """Return the file's text with the lines of the symmetries."""
        lines = [
            f"# Written by rpod target new from {self._cad.name}; all of it may be corrected by hand.",
            f"name: {_scalar(_label(self._options.name or self._cad.stem))}",
            "",
            self._mass_line,
            "# Centre of mass and inertia follow from an even spread, unless given:",
            "# centre_of_mass_m, inertia_kg_m2; mass_spread: surface for a skin.",
            *(["confirmed_size: true"] if self._options.confirmed_size else []),
            "",
            "# For the emulated sensors only, proposed from names and colours.",
            "materials:",
            *self._materials(),
            "",
            "parts:",
            *self._parts(),
            "",
            "distance_field: {}  # spacing and margin follow from the size",
            "",
            *symmetries,
        ]
        return "\n".join(lines).rstrip() + "\n"

    def _origin(self) -> FloatArray:
        low_m, high_m = (self._scale * side(self._mesh.triangles, axis=(0, 1)) for side in (np.min, np.max))
        wanted = self._options.origin
        outside = bool(((low_m > 0.0) | (high_m < 0.0)).any())
        if wanted == "file" or (wanted == "auto" and not outside):
            return np.zeros(3)
        corners = self._mesh.triangles
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        centre_m = self._scale * (area @ corners.mean(axis=1)) / area.sum()
        self.told.append("the origin is the centre of area, not that of the file")
        return np.asarray(np.round(-centre_m, 9))

    def _mass(self) -> str:
        options = self._options
        if options.density_kg_m3 is not None:
            return f"density_kg_m3: {options.density_kg_m3!r}"
        if options.mass_kg is not None:
            return f"mass_kg: {options.mass_kg!r}"
        sides_m = self._scale * most_sides(self._mesh)
        mass_kg = max(_ASSUMED_KG_M3 * float(np.prod(sides_m)), float(sides_m.max()) ** 3)
        self.told.append(f"no mass is given: {mass_kg:.3g} kg are assumed (--mass-kg)")
        return (
            f"mass_kg: {float(f'{mass_kg:.3g}')!r}  # assumed: {_ASSUMED_KG_M3:g} kg/m3 of the bounding box"
        )

    def _materials(self) -> Iterator[str]:
        for material in self._mesh.materials:
            parameters, reason = proposed(material)
            yield f"  {_scalar(self._labels[material.name])}: {_flow(parameters)}  # {reason}"
        if (self._mesh.triangle_material < 0).any():
            grey = MaterialParameters(reflectivity=0.35, diffuse=0.35, f0=0.02, roughness=0.3)
            yield f"  {_PLAIN}: {_flow(grey)}  # the file gives no material"

    def _parts(self) -> Iterator[str]:
        objects = self._mesh.objects
        several = 1 < len(objects) <= _MOST_PARTS
        labels = _labels(objects)
        for number, name in enumerate(objects if several else objects[:1]):
            chosen = self._mesh.triangle_object == number if several else slice(None)
            used, counts = np.unique(self._mesh.triangle_material[chosen], return_counts=True)
            label = labels[name] if several else _label(self._options.name or self._cad.stem)
            yield f"  - name: {_scalar(label)}"
            yield "    shape: mesh"
            yield f"    file: {_scalar(self.file)}"
            if self._options.largest_file_mb != LARGEST_FILE_MB:
                yield f"    largest_file_mb: {self._options.largest_file_mb!r}"
            if several:
                yield f"    object: {_scalar(name)}"
            yield f"    metres_per_unit: {self._scale!r}"
            yield f"    material: {_scalar(self._material(int(used[np.argmax(counts)])))}"
            known = [int(index) for index in used if index >= 0]
            if len(used) > 1:
                pairs = {self._mesh.materials[index].name: self._material(index) for index in known}
                yield (
                    "    file_materials: "
                    + yaml.safe_dump(
                        pairs, default_flow_style=True, width=1 << 20, allow_unicode=True
                    ).strip()
                )
            if self._translation_m.any():
                yield f"    T_target_part: {{translation_m: {self._translation_m.tolist()}}}"

    def _material(self, index: int) -> str:
        return _PLAIN if index < 0 else self._labels[self._mesh.materials[index].name]


_PLAIN = "plain"


def _by_shape(target: Target) -> "Sequence[FoundSymmetry]":
    from rpod_target.symmetry import find_symmetries  # noqa: PLC0415 - needs Open3D

    return find_symmetries(target)


def _symmetries(found: "Sequence[FoundSymmetry]", told: list[str]) -> list[str]:
    """Return the lines of the symmetries whose axes pass through the origin."""
    aside = [one for one in found if one.beside_origin_m > 0.0]
    if aside:
        told.append(
            "symmetries that are not written, since their axes pass beside the origin, so that poses will be "
            f"mistaken for each other: {len(aside)}; use --origin centre to have them"
        )
    lines = []
    if any(one.continuous and not one.exact for one in found):
        told.append(
            "from some sides nothing tells the turn about an axis of this target, and no track begins there: "
            "if the turn does not matter to you, write exact: true to this symmetry; it is then called free"
        )
    for one in found:
        if one.beside_origin_m > 0.0:
            continue
        flags = ", exact: true" * one.exact + ", continuous: true" * one.continuous
        axis = [round(value, 9) for value in one.axis]
        lines.append(f"  - {{axis: {axis}, order: {one.order}{flags}}}  # {_note(one)}")
    return (
        ["# Found by comparing the surface, and what sensors see of it.", "symmetries:", *lines]
        if lines
        else []
    )


def _note(one: "FoundSymmetry") -> str:
    """Return what distinguishes the poses of a symmetry, in which sensor at which range."""
    if one.exact:
        return "any turn: no sensor measures the angle" if one.continuous else "surfaces and materials agree"
    parts = []
    for sensor in dict.fromkeys(each.sensor for each in one.likeness):
        mine = [each for each in one.likeness if each.sensor == sensor]
        mistaken = [
            f"{each.range_m:.3g} m" + ("" if 2 * each.alike >= each.views else " from some sides")
            for each in mine
            if 2 * each.alike >= each.views or (one.continuous and each.alike)
        ]
        parts.append(
            f"{sensor} mistakes it at {', '.join(mistaken)}" if mistaken else f"{sensor} distinguishes it"
        )
    return ("any turn: " if one.continuous else "") + "; ".join(parts)


def _labels(names: Sequence[str], *, taken: Set[str] = frozenset()) -> dict[str, str]:
    """Return names that a target file allows, each different and not taken, by those of the mesh file."""
    labels: dict[str, str] = {}
    for name in names:
        label = base = _label(name)
        number = 2
        while label in taken or label in labels.values():
            label, number = f"{base}-{number}", number + 1
        labels[name] = label
    return labels


def _label(name: str) -> str:
    plain = unicodedata.normalize("NFKD", name.replace("\u00df", "ss"))
    plain = "".join(
        letter for letter in plain if not unicodedata.combining(letter)
    )  # letters without accents
    label = re.sub(r"[^A-Za-z0-9_-]+", "-", plain).strip("-_")
    return label if label[:1].isalpha() else f"n-{label}".rstrip("-")


def _flow(parameters: MaterialParameters) -> str:
    fields = parameters.model_dump(exclude_defaults=True)
    return "{" + ", ".join(f"{name}: {value:g}" for name, value in fields.items()) + "}"


def _scalar(text: str) -> str:
    return (
        yaml.safe_dump(text, default_flow_style=True, width=1 << 20, allow_unicode=True)
        .removesuffix("...\n")
        .strip()
    )
