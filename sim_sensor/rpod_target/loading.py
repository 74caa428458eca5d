"""Loading of a target by name or from a parameter file: it is checked, then cached or built."""

import contextlib
import hashlib
import json
import re
import reprlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rpod_schemas.arrays import Array
from rpod_schemas.caches.folder import cache_folder
from rpod_schemas.config.base import check, read_document
from rpod_schemas.errors import ConfigurationError
from rpod_target import cache as store
from rpod_target.equivalence import Equivalence, Symmetry
from rpod_target.errors import TargetError
from rpod_target.mesh.files import FORMATS, MeshFile
from rpod_target.mesh.folder import read_files
from rpod_target.mesh.unusable import LARGEST_FILE_MB
from rpod_target.parameters import MeshParameters, PartParameters, PrismParameters, TargetParameters
from rpod_target.target import DistanceField, Joint, Material, Target
from rpod_target.variation import Variation, split

RANDOM = "random-"
"""Beginning of the names of the random satellites."""
_SHIPPED = Path(__file__).parent / "targets"
_BUILDER_VERSION, _MESH_BUILDER_VERSION, _VARIATION_VERSION = 4, 7, 1
"""Versions of the builder without and with mesh files, and of the variations. Increase one when the same
parameters give other arrays."""
_MOST_TOLERANCE = 0.1
"""Largest error of coordinates that a file may declare, over the longest side."""


def shipped_targets() -> tuple[str, ...]:
    """Return the names of the shipped targets, sorted."""
    return tuple(sorted(file.stem for file in _SHIPPED.glob("*.yaml")))


def is_shipped(target: Target) -> bool:
    """Return whether a target is one that is shipped with the package."""
    return Path(target.source).parent == _SHIPPED


def load_target(
    name_or_path: str | Path, *, cache: Path | None = None, read: Mapping[str, MeshFile] | None = None
) -> Target:
    """Return a target, which is built if the cache has none with its digest.

    Args:
        name_or_path: name of a shipped target or of a random satellite (``rpod_target.population``), or
            path of a parameter file (YAML, JSON or TOML); behind it, the terms of a variation
            (``rpod_target.variation``).
        cache: directory of the built targets; by default $RPOD_CACHE, $XDG_CACHE_HOME/rpod or ~/.cache/rpod.
        read: mesh files that are read already, by their names in the parameter file.

    Raises:
        TargetError: names the file, the field and the reason.
    """
    base, terms = _base(name_or_path)
    suffix = str(name_or_path).removeprefix(base)
    path, parameters, meshes = _read(base)
    variation = check(Variation, terms, source=name_or_path) if terms else None
    source = path.with_name(path.name + suffix)

    def loaded(without: tuple[str, ...]) -> Target:
        chosen = _without(parameters, without, source=source)
        digest = _digest(chosen, meshes, variation)
        bare = _bare(chosen)
        file = (cache or cache_folder()) / f"sealed-{_digest(bare, meshes, variation)}.npz"
        arrays = store.read(file)
        if arrays is None:
            arrays = store.with_digest(_build(chosen, meshes, source, read or {}, variation))
            with contextlib.suppress(OSError):  # with a full or read-only disk only the next start is slower
                store.write(file, arrays)
        target = _assemble(chosen, arrays, source=source, digest=digest)
        return replace(target, name=target.name + suffix)

    def with_joints(without: tuple[str, ...]) -> Target:
        return _with_joints(parameters, loaded, without, source=source)

    left_out = () if variation is None else variation.without
    unreliable = tuple(part.name for part in parameters.parts if part.unreliable)
    if parameters.joints and variation is not None and (variation.bent or variation.missing):
        raise TargetError(source, "joints", "a target with joints takes neither @bent nor @missing; omit it")
    target = with_joints(left_out)
    _check_tolerance(target, source=source)
    return replace(target, reliable=with_joints(left_out + unreliable)) if unreliable else target


def _check_tolerance(target: Target, *, source: Path) -> None:
    most_m = _MOST_TOLERANCE * float(np.ptp(target.triangles_m, axis=(0, 1)).max())
    if target.tolerance_m > most_m:
        reason = (
            f"is {target.tolerance_m:g} m; it must be less than {most_m:.3g} m, {_MOST_TOLERANCE:.0%} of the "
            "longest side: it is in metres, not in millimetres"
        )
        raise TargetError(source, "tolerance_m", reason)


def _bare(parameters: TargetParameters) -> TargetParameters:
    """Return parameters without the fields that change no array."""
    parts = tuple(
        part.model_copy(
            update={"joint": None}
            | ({"largest_file_mb": LARGEST_FILE_MB} if isinstance(part, MeshParameters) else {})
        )
        for part in parameters.parts
    )
    others: dict[str, Any] = {"symmetries": (), "frames": {}, "joints": {}, "camera_errors": None}
    others |= {"tolerance_m": 0.0, "scale_tolerance": 0.0}
    return parameters.model_copy(update={"parts": parts, **others})


def _with_joints(
    parameters: TargetParameters,
    loaded: Callable[[tuple[str, ...]], Target],
    without: tuple[str, ...],
    *,
    source: Path,
) -> Target:
    """Return the target without parts, and with the pieces of its joints.

    Args:
        parameters: parameters of the whole target.
        loaded: function that returns the target without parts, by their names.
        without: names of the parts that are left out.
        source: parameter file, for error messages.
    """
    joint_of = {part.name: part.joint for part in parameters.parts if part.name not in without}
    names = [name for name in parameters.joints if name in joint_of.values()]
    target = loaded(without)
    if not names:
        return target

    def alone(joint: str | None) -> Target:
        return loaded(without + tuple(name for name, other in joint_of.items() if other != joint))

    if None not in joint_of.values():
        raise TargetError(source, "parts", "only parts that turn about joints are left; keep one fixed part")
    joints = []
    for name in names:
        joint = parameters.joints[name]
        least_rad, greatest_rad = np.deg2rad(joint.limits_deg)
        axis = joint.axis / np.linalg.norm(joint.axis)
        rate_rad_s = float(np.deg2rad(joint.most_rate_deg_s))
        limits_rad = float(least_rad), float(greatest_rad)
        joints.append(Joint(name, axis, joint.origin_m, limits_rad, rate_rad_s, alone(name)))
    return replace(target, joints=tuple(joints), fixed=alone(None))


def _base(name_or_path: str | Path) -> tuple[str, dict[str, Any]]:
    """Return a target's name or file without the terms of a variation, and the terms."""
    try:
        exists = Path(name_or_path).exists()
    except OSError as error:  # for example because it is too long
        name = reprlib.repr(str(name_or_path))
        raise TargetError(f"target {name}", "", f"is no name of a target ({error.strerror})") from error
    return (str(name_or_path), {}) if exists else split(str(name_or_path))


def _without(parameters: TargetParameters, names: tuple[str, ...], *, source: Path) -> TargetParameters:
    """Return the parameters without parts, which a variation leaves out or which are unreliable."""
    known = [part.name for part in parameters.parts]
    for name in names:
        if name not in known:
            raise TargetError(source, "without", f"part {name!r} is unknown; known are {', '.join(known)}")
    parts = tuple(part for part in parameters.parts if part.name not in names)
    if not parts:
        raise TargetError(source, "parts", f"no part is left without {', '.join(names)}; keep at least one")
    return parameters.model_copy(update={"parts": parts})


def load_equivalence(name_or_path: str | Path) -> Equivalence:
    """Return which attitudes of a target are equivalent, from its parameter file alone; nothing is built.

    Raises:
        TargetError: as for ``load_target``.
    """
    return Equivalence.of(_symmetries(_read(_base(name_or_path)[0])[1]))


def _symmetries(parameters: TargetParameters) -> tuple[Symmetry, ...]:
    return tuple(
        Symmetry(tuple(symmetry.axis.tolist()), symmetry.order, symmetry.exact, symmetry.continuous)
        for symmetry in parameters.symmetries
    )


def _read(name_or_path: str | Path) -> tuple[Path, TargetParameters, dict[str, bytes]]:
    """Return source, parameters and mesh files of a target."""
    if str(name_or_path).startswith(RANDOM):
        from rpod_target.population import satellite_of  # noqa: PLC0415 - the shipped targets need no trimesh

        satellite = satellite_of(str(name_or_path))
        if satellite is not None:
            source = Path(satellite.name)
            document = yaml.safe_load(satellite.parameters)
            return source, check(TargetParameters, document, source=source), dict(satellite.meshes)
    path = _parameter_file(name_or_path)
    parameters = _read_parameters(path)
    return path, parameters, _read_meshes(parameters, path)


def _parameter_file(name_or_path: str | Path) -> Path:
    path = Path(name_or_path)
    if path.suffix or len(path.parts) > 1:
        if path.exists() and not path.is_file():  # a log may name a device or a pipe, which has no end
            raise TargetError(path, "", "is no file; give the path of a target's YAML file")
        if path.suffix.lower() in FORMATS:
            remedy = f"'rpod target new {path}' writes one, whose path you give"
            raise TargetError(path, "", f"is a CAD file, needs a target's parameter file; {remedy}")
        return path
    if str(name_or_path) not in shipped_targets():
        meant = get_close_matches(str(name_or_path), shipped_targets(), n=1)
        guess = f" (did you mean {meant[0]}?)" if meant else ""
        reason = f"is unknown{guess}; known are {', '.join(shipped_targets())}, or the path of a file"
        raise TargetError(f"target {str(name_or_path)!r}", "", reason)
    return _SHIPPED / f"{name_or_path}.yaml"


def _read_parameters(path: Path) -> TargetParameters:
    try:
        parameters = check(TargetParameters, read_document(path), source=path)
    except ConfigurationError as error:
        # pydantic puts a union's tag into the location, which is no field of the file
        field = re.sub(r"^(parts\.\d+)\.(box|prism|frustum|cylinder|mesh)\b", r"\1", error.field)
        raise TargetError(error.source, field, error.reason) from error
    _check_mass(parameters, path)
    for index, part in enumerate(parameters.parts):
        for field, material in _named_materials(part):
            if material not in parameters.materials:
                known = ", ".join(parameters.materials)
                raise TargetError(
                    path, f"parts.{index}.{field}", f"material {material!r} is unknown; known are {known}"
                )
    return parameters


def _check_mass(parameters: TargetParameters, path: Path) -> None:
    masses = [name for name in ("mass_kg", "density_kg_m3") if getattr(parameters, name) is not None]
    missing = [name for name in ("centre_of_mass_m", "inertia_kg_m2") if getattr(parameters, name) is None]
    if missing and not masses:
        reason = "is missing: give it, or mass_kg or density_kg_m3, from which it is computed"
        raise TargetError(path, missing[0], reason)
    if len(masses) == 2:
        raise TargetError(path, "density_kg_m3", "give either it or mass_kg")


def _named_materials(part: PartParameters) -> Iterator[tuple[str, str]]:
    yield "material", part.material
    if isinstance(part, PrismParameters):
        for field in ("top_materials", "base_materials", "side_materials"):
            for index, material in enumerate(getattr(part, field)):
                yield f"{field}.{index}", material
    if isinstance(part, MeshParameters):
        for name, material in part.file_materials.items():
            yield f"file_materials.{name}", material


def _read_meshes(parameters: TargetParameters, path: Path) -> dict[str, bytes]:
    """Return the bytes of all mesh files, and of the files beside them that they refer to and that exist."""
    meshes: dict[str, bytes] = {}
    for index, part in enumerate(parameters.parts):
        if isinstance(part, MeshParameters) and part.file not in meshes:
            file, field = path.parent / part.file, f"parts.{index}.file"
            try:
                meshes[part.file], beside = read_files(
                    file, largest_mb=part.largest_file_mb, raised_by="largest_file_mb: "
                )
            except OSError as error:
                raise TargetError(path, field, f"mesh {file} cannot be read ({error.strerror})") from error
            except ValueError as error:
                raise TargetError(path, field, f"{part.file} {error}") from error
            folder = Path(part.file).parent
            meshes |= {str(folder / name): content for name, content in beside.items()}
    return meshes


def _digest(parameters: TargetParameters, meshes: Mapping[str, bytes], variation: Variation | None) -> str:
    content: dict[str, Any] = {
        "builder": _MESH_BUILDER_VERSION if meshes else _BUILDER_VERSION,
        "parameters": parameters.model_dump(mode="json"),
        "materials": list(parameters.materials),  # their order numbers the triangles' materials
        "meshes": {name: hashlib.sha256(mesh).hexdigest() for name, mesh in meshes.items()},
    }
    if variation is not None:
        content["variation"] = {"version": _VARIATION_VERSION, **variation.model_dump(mode="json")}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _build(
    parameters: TargetParameters,
    meshes: Mapping[str, bytes],
    path: Path,
    read: Mapping[str, MeshFile],
    variation: Variation | None,
) -> dict[str, Array]:
    try:
        from rpod_target.build.arrays import build_arrays  # noqa: PLC0415 - a warm start must not pay for Open3D
    except ImportError as error:
        reason = f"is not in the cache yet, and building it needs Open3D: install rpod[target] ({error})"
        raise TargetError(path, "", reason) from error
    return build_arrays(parameters, meshes, source=str(path), read=read, variation=variation)


def _assemble(parameters: TargetParameters, arrays: dict[str, Array], *, source: Path, digest: str) -> Target:
    content = str(arrays.pop(store.DIGEST))
    spacing_m = parameters.distance_field.spacing_m or float(arrays["field_spacing_m"])
    field = DistanceField(arrays.pop("field_origin_m"), spacing_m, arrays.pop("field_values"))
    arrays.pop("field_spacing_m", None)  # an older cache may lack it
    parts = tuple(part.name for part in parameters.parts)
    backs = tuple(f"{parts[number]}-back" for number in arrays.pop("back_parts", ()))
    repairs = tuple(str(text) for text in arrays.pop("repairs", ()))
    centre_m, inertia = parameters.centre_of_mass_m, parameters.inertia_kg_m2
    return Target(
        name=parameters.name,
        source=str(source),
        digest=digest,
        content=content,
        materials=tuple(
            Material(name=name, **material.model_dump()) for name, material in parameters.materials.items()
        ),
        parts=parts + backs,
        field=field,
        repairs=repairs,
        centre_of_mass_m=arrays.pop("centre_of_mass_m") if centre_m is None else centre_m,
        inertia_kg_m2=arrays.pop("inertia_kg_m2") if inertia is None else inertia,
        radius_m=float(np.linalg.norm(arrays["triangles_m"], axis=-1).max()),
        symmetries=_symmetries(parameters),
        frames=parameters.frames,
        reliable=None,
        tolerance_m=parameters.tolerance_m,
        scale_tolerance=parameters.scale_tolerance,
        camera_errors=None if parameters.camera_errors is None else parameters.camera_errors.factor,
        joints=(),
        fixed=None,
        **arrays,
    )
