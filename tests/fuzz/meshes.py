"""Hostile CAD files of each format that is read in this process: bytes, words and glTF's documents changed.

STEP is left out, since a process of its own reads it, which takes a second.
"""

import base64
import json
import struct
from collections.abc import Iterator
from functools import cache, partial
from random import Random

import trimesh
from fuzz.mutation import json_of, mutate_bytes, mutate_document

from rpod_target.mesh.files import read_mesh_file

_WORDS = (b"nan", b"inf", b"1e308", b"-1", b"0", b"4294967295", b"99999999999", b"1e-320", b"", b"\n", b"x")
_OBJ = b"o a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nusemtl m\nf 1 2 3 4\nf -1 -2 -3\nf 1/1 2/2 5/3/3\n"


@cache
def _seeds() -> dict[str, bytes]:
    """Return valid files by name."""
    box = trimesh.creation.box((1.0, 0.5, 0.3))
    box.visual.face_colors = [255, 0, 0, 255]
    scene = trimesh.Scene([box, trimesh.creation.cylinder(0.2, 1.0, sections=6)])
    document = scene.export(file_type="gltf")
    gltf = json.loads(document["model.gltf"])
    for buffer in gltf["buffers"]:
        buffer["uri"] = "data:;base64," + base64.b64encode(document[buffer["uri"]]).decode()
    files = {
        "binary.stl": box.export(file_type="stl"),
        "text.stl": box.export(file_type="stl_ascii"),
        "text.obj": _OBJ,
        "text.off": box.export(file_type="off"),
        "binary.ply": box.export(file_type="ply"),
        "text.ply": box.export(file_type="ply", encoding="ascii"),
        "binary.glb": scene.export(file_type="glb"),
        "text.gltf": json.dumps(gltf),
    }
    return {name: file if isinstance(file, bytes) else file.encode() for name, file in files.items()}


def mesh_subjects() -> Iterator[tuple[str, partial[bytes], partial[bool]]]:
    """Yield the name of each subject, what makes its inputs, and what reads them."""
    for name in _seeds():
        yield f"mesh {name}", partial(_make, name), partial(_read, name)


def _make(name: str, rnd: Random) -> bytes:
    seed = _seeds()[name]
    if rnd.randrange(3) == 0:
        return mutate_bytes(rnd, seed)
    if name.endswith(".gltf"):
        return json_of(rnd, mutate_document(rnd, json.loads(seed)))
    if name.endswith(".glb"):
        return _glb(rnd, seed)
    if not name.startswith("text"):
        return mutate_bytes(rnd, seed)
    words = seed.split(b" ")
    for _ in range(rnd.randint(1, 3)):
        words[rnd.randrange(len(words))] = rnd.choice(_WORDS)
    return b" ".join(words)


def _glb(rnd: Random, seed: bytes) -> bytes:
    """Return a GLB file with another document before its binary chunk."""
    length = struct.unpack_from("<I", seed, 12)[0]
    document, rest = json.loads(seed[20 : 20 + length]), seed[20 + length :]
    text = json_of(rnd, mutate_document(rnd, document))
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


def _read(name: str, content: bytes) -> bool:
    try:
        read_mesh_file(name, content, {})
    except ValueError:
        return False
    return True
