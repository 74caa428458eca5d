"""Reader of CAD and mesh files: STL, OBJ, PLY, OFF, glTF, GLB, and STEP with the extra ``step``.

Files are read by trimesh, without any cleaning: every triangle of the file is returned, also those of zero
area, which a closed surface needs.
"""

import io
import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_target.mesh import gltf_arrays, obj_text, off_text, step
from rpod_target.mesh.text import as_utf8, file_of, with_line_feeds
from rpod_target.mesh.unusable import LARGEST_FILE_MB, MOST_TRIANGLES, lost_faces, unusable, without_faces

FORMATS = (".stl", ".obj", ".ply", ".gltf", ".glb", ".off", ".step", ".stp")
"""Suffixes of the files that can be read."""
METRIC = (".gltf", ".glb", ".step", ".stp")
"""Suffixes of the formats that are in metres when they are read: glTF by definition, STEP by its own unit."""
STEP = (".step", ".stp")
"""Suffixes of STEP files."""
_TEXTS = (".obj", ".off")
_GLTF = (".gltf", ".glb")


@dataclass(frozen=True)
class FileMaterial:
    """A material of a mesh file, as far as the file describes it."""

    name: str
    colour: tuple[float, float, float] | None
    """Diffuse colour as a screen shows it (sRGB), red, green, blue, 0 to 1; None if the file has none."""
    specular: float | None
    """Mean specular colour, 0 to 1 (OBJ); None if the file has none."""
    metallic: float | None
    """Share of metal, 0 to 1 (glTF); None if the file has none."""


@dataclass(frozen=True, eq=False)
class MeshFile:
    """The triangles of a file, in its own unit."""

    triangles: FloatArray
    """Corners, shape (T, 3, 3), as the file has them."""
    triangle_object: NDArray[np.int64]
    """Index into ``objects``, shape (T,)."""
    objects: tuple[str, ...]
    """Names of the objects: of OBJ the ``o`` or ``g`` lines, of glTF and STEP the nodes."""
    triangle_material: NDArray[np.int64]
    """Index into ``materials``, shape (T,); -1 for a triangle without one."""
    materials: tuple[FileMaterial, ...]
    units: tuple[str, ...] = ()
    """Units of length that the file names and that its reader has converted to metres (STEP)."""


def companions(name: str, content: bytes) -> tuple[str, ...]:
    """Return the names of the files that a mesh file refers to and that are read with it."""
    suffix, content = _suffix(name), as_utf8(content)
    if suffix == ".obj":
        return obj_text.libraries(content)
    if suffix == ".gltf":
        try:
            buffers = json.loads(content)["buffers"]
            names = [str(entry.get("uri", "")) for entry in buffers]
        except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
            return ()  # its reader refuses what is no glTF
        return tuple(file_of(uri) for uri in names if uri and not uri.startswith("data:"))
    return ()


def read_mesh_file(
    name: str, content: bytes, beside: Mapping[str, bytes], *, largest_mb: float = LARGEST_FILE_MB
) -> MeshFile:
    """Return the content of a mesh file.

    Args:
        name: name of the file; its suffix gives the format.
        content: bytes of the file.
        beside: bytes of its companions that exist, by name; other names are ignored.
        largest_mb: largest size of the arrays that the file announces, MB.

    Raises:
        ValueError: the content is wrong; the text continues a sentence that begins with the file's name.
    """
    suffix, folder, content = _suffix(name), PurePosixPath(name).parent, as_utf8(content)
    beside = {
        other: beside[str(folder / other)]
        for other in companions(name, content)
        if str(folder / other) in beside
    }
    if suffix not in FORMATS:
        raise ValueError(f"is of no known format: give one of {', '.join(FORMATS)}")
    if reason := unusable(suffix, content, largest_mb=largest_mb):
        raise ValueError(reason)
    units: tuple[str, ...] = ()
    if suffix in STEP:
        units, content = step.units(content), _as_glb(suffix, content)
        if reason := unusable(".glb", content, largest_mb=largest_mb):
            raise ValueError(reason)
    scene, pieces = _read(suffix, content, beside)
    if not pieces:
        raise ValueError(without_faces(list(scene.geometry.values())))
    if suffix == ".ply" and (reason := lost_faces(content, sum(len(piece.triangles) for piece in pieces))):
        raise ValueError(reason)
    if suffix in _TEXTS:
        pieces.reverse()  # the reader returns them from the last to the first
    materials = list(dict.fromkeys(piece.material for piece in pieces if piece.material))
    objects = tuple(dict.fromkeys(piece.name for piece in pieces))
    counts = [len(piece.triangles) for piece in pieces]
    mesh = MeshFile(
        np.concatenate([piece.triangles for piece in pieces]),
        np.repeat([objects.index(piece.name) for piece in pieces], counts),
        objects,
        np.repeat([materials.index(piece.material) if piece.material else -1 for piece in pieces], counts),
        tuple(_with_names_of_their_own(materials)),
        units,
    )
    wrong = np.flatnonzero(~np.isfinite(mesh.triangles).all(axis=(1, 2)))
    if wrong.size:
        raise ValueError(
            f"has {wrong.size} of {len(mesh.triangles)} triangles with a coordinate that is not finite, the "
            f"first one in object {objects[mesh.triangle_object[wrong[0]]]!r}: export it again"
        )
    return mesh


def _read(suffix: str, content: bytes, beside: Mapping[str, bytes]) -> tuple[Any, "list[_Piece]"]:
    """Return a file as its reader gives it, and the triangles. Raises ``ValueError``."""
    try:
        scene = _scene(*_prepared(suffix, content, beside))
        return scene, list(_pieces(scene))
    except ValueError as error:
        line = obj_text.wrong_line(content) if suffix == ".obj" else ""
        if not line:
            raise
        known = str(error) in {obj_text.NO_CORNER, obj_text.NO_NUMBER}
        raise ValueError(f"{error if known else obj_text.NO_NUMBER}{line}") from error


def _with_names_of_their_own(materials: Sequence[FileMaterial]) -> Iterator[FileMaterial]:
    """Yield materials of which no two have the same name, since a target's file refers to them by name."""
    known: set[str] = set()
    for material in materials:
        name, number = material.name, 2
        while name in known:
            name, number = f"{material.name}-{number}", number + 1
        known.add(name)
        yield replace(material, name=name)


def _prepared(
    suffix: str, content: bytes, beside: Mapping[str, bytes]
) -> tuple[str, bytes, Mapping[str, bytes]]:
    """Return the format, content and companions of a file in the way that its reader needs them.

    Raises:
        ValueError: as for ``read_mesh_file``.
    """
    if suffix == ".off":
        content, library = off_text.as_obj(with_line_feeds(content))
        return ".obj", *obj_text.prepared(content, {"": library})
    if suffix == ".obj":
        return suffix, *obj_text.prepared(content, beside)
    return suffix, content, beside


@dataclass(frozen=True, eq=False)
class _Piece:
    """A piece of a file's mesh, of one material."""

    name: str
    triangles: FloatArray
    """Corners, in the file's unit and axes, shape (T, 3, 3)."""
    material: FileMaterial | None


class _Beside:
    """Gives trimesh the companions of a file, and nothing else of the disk or of the network."""

    def __init__(self, files: Mapping[str, bytes]) -> None:
        self._files = files
        self.missing = ""
        """Name of a file that was asked for and is not among them."""

    def get(self, name: str) -> bytes:
        """Return the bytes of a companion. Raises ``OSError``."""
        found = self._files.get(file_of(str(name)))
        if found is None:
            self.missing = file_of(str(name))
            raise FileNotFoundError(name)
        return found

    __getitem__ = get


def _scene(suffix: str, content: bytes, beside: Mapping[str, bytes]) -> Any:
    import trimesh  # noqa: PLC0415 - only a build reads meshes

    options: dict[str, Any] = {}
    if suffix == ".obj":
        options["split_objects"] = obj_text.has_objects(content)
        options["split_groups"] = not options["split_objects"]
    others, kind = _Beside(beside), "glb" if suffix in STEP else suffix[1:]
    try:
        if suffix in _GLTF:
            content, others = _whole(content, others)
            kind = "glb" if content.startswith(b"glTF") else "gltf"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return trimesh.load_scene(
                io.BytesIO(content),
                file_type=kind,
                resolver=others,  # type: ignore[arg-type]
                process=False,
                maintain_order=True,
                **options,
            )
    except FileNotFoundError as error:
        if not others.missing:
            raise ValueError(_unread(suffix, error)) from error
        reason = f"refers to {others.missing!r}, which is not beside it: copy that file too"
        raise ValueError(reason) from error
    except IndexError as error:
        raise ValueError(obj_text.NO_CORNER if suffix == ".obj" else _unread(suffix, error)) from error
    except Exception as error:  # a parser of foreign files raises anything
        raise ValueError(_unread(suffix, error)) from error


def _as_glb(suffix: str, content: bytes) -> bytes:
    """Return a STEP file as GLB. Raises ``ValueError``."""
    step.require_reader()
    try:
        return step.as_glb(content)
    except Exception as error:  # a parser of foreign files raises anything
        raise ValueError(_unread(suffix, error)) from error


def _whole(content: bytes, others: _Beside) -> tuple[bytes, _Beside]:
    """Return a glTF document with all its triangles, and the files that it refers to."""
    content, files = gltf_arrays.prepared(content, others.get)
    return content, others if files is None else _Beside(files)


def _pieces(scene: Any) -> Iterator[_Piece]:
    """Yield the triangles of each node of a scene, placed by the node's transform."""
    order = {name: number for number, name in enumerate(scene.geometry)}
    nodes = [(*scene.graph[node], node) for node in scene.graph.nodes_geometry]  # in no order
    labelled = [
        (order[name], _object_of(scene, node), transform, scene.geometry[name])
        for transform, name, node in nodes
    ]
    count = sum(len(getattr(geometry, "faces", ())) for *_, geometry in labelled)
    if count > MOST_TRIANGLES:
        raise ValueError(f"contains {count} triangles, at most {MOST_TRIANGLES} are read: simplify it first")
    for _, node, transform, geometry in sorted(labelled, key=lambda entry: entry[:2]):
        faces = getattr(geometry, "faces", None)
        if faces is None or not len(faces):
            continue
        corners, faces = np.asarray(geometry.vertices, np.float64), np.asarray(faces, np.int64)
        if not 0 <= faces.min() <= faces.max() < len(corners):
            raise ValueError(obj_text.NO_CORNER)
        triangles = corners[faces]
        if not np.array_equal(transform, np.eye(4)):
            with np.errstate(invalid="ignore"):  # a coordinate that is not finite is refused afterwards
                triangles = triangles @ transform[:3, :3].T + transform[:3, 3]
            if np.linalg.det(transform[:3, :3]) < 0.0:  # a mirrored copy
                triangles = triangles[:, ::-1]
        yield from _by_material(node, triangles, geometry)


def _object_of(scene: Any, node: Any) -> str:
    """Return the name of the object that a node of a scene belongs to.

    Where a glTF mesh has several primitives, the reader gives each a node of a random name below the node of
    the file.
    """
    metadata = getattr(scene.geometry[scene.graph[node][1]], "metadata", None) or {}
    parent = str(scene.graph.transforms.parents.get(node, ""))
    if metadata.get("from_gltf_primitive") and str(node).startswith(f"{parent}_"):
        return parent
    return str(node)


def _by_material(name: str, triangles: FloatArray, geometry: Any) -> Iterator[_Piece]:
    """Yield a node's triangles, split by the face colours that PLY files have."""
    visual = geometry.visual
    if getattr(visual, "kind", None) in {"face", "vertex"}:
        colours, of_face = np.unique(np.asarray(visual.face_colors)[:, :3], axis=0, return_inverse=True)
        if len(colours) <= off_text.MOST_COLOURS and len(of_face) == len(triangles):
            for number, colour in enumerate(colours):
                red, green, blue = (float(value) / 255.0 for value in colour)
                painted = FileMaterial(_colour_name((red, green, blue)), (red, green, blue), None, None)
                yield _Piece(name, triangles[of_face.ravel() == number], painted)
            return
    material = getattr(visual, "material", None)
    found = None if material is None else _material(material)
    if found is not None and not found.name:
        found = None if found.colour is None else replace(found, name=_colour_name(found.colour))
    if found is not None:
        name = _without_material(name, found.name)
        found = None if found.name == obj_text.NO_MATERIAL else found
    yield _Piece(name, triangles, found)


def _colour_name(colour: tuple[float, float, float]) -> str:
    return "colour-" + "".join(f"{round(255.0 * value):02x}" for value in colour)


def _without_material(name: str, material: str) -> str:
    """Return an object's name without that of the material, which the OBJ reader appends."""
    if name == material:
        return _NAMELESS
    while name.endswith(f"_{material}"):
        name = name.removesuffix(f"_{material}")
    return name


_NAMELESS = "mesh"
"""Name of the object of a file that names none."""


def _material(material: Any) -> FileMaterial:
    factor = getattr(material, "baseColorFactor", None)
    if hasattr(material, "baseColorFactor"):
        metallic = getattr(material, "metallicFactor", None)
        colour = _as_shown(_colour(factor))
        return FileMaterial(
            str(material.name or ""), colour, None, None if metallic is None else float(metallic)
        )
    known = getattr(material, "kwargs", {}) or {}
    described = "kd" in known
    specular = getattr(material, "specular", None)
    return FileMaterial(
        str(material.name or ""),
        _colour(getattr(material, "diffuse", None)) if described else None,
        float(np.mean(np.asarray(specular)[:3]) / 255.0) if "ks" in known and specular is not None else None,
        None,
    )


def _colour(values: Any) -> tuple[float, float, float] | None:
    if values is None:
        return None
    array = np.asarray(values, np.float64)[:3]
    if np.asarray(values).dtype.kind in "iu":
        array /= 255.0
    red, green, blue = (float(value) for value in np.clip(array, 0.0, 1.0))
    return red, green, blue


def _as_shown(linear: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
    """Return a linear colour, which glTF has, as sRGB (IEC 61966-2-1), which people choose colours in."""
    if linear is None:
        return None
    red, green, blue = (
        12.92 * value if value <= 0.0031308 else 1.055 * value ** (1.0 / 2.4) - 0.055 for value in linear
    )
    return red, green, blue


def _suffix(name: str) -> str:
    return PurePosixPath(name).suffix.lower()


def _unread(suffix: str, error: BaseException) -> str:
    others = ", ".join(other for other in FORMATS[:4] if other != suffix)
    name = suffix[1:].upper()
    return f"cannot be read as {name} ({_one_line(error)}): export it again, or in another format ({others})"


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
