"""Mesh files as other programs write them: encodings, tabs, names of companions, arrays of glTF."""

import json
import struct
from base64 import b64encode
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rpod_target.drafting.draft import DraftOptions, draft
from rpod_target.mesh import files as mesh_files
from rpod_target.mesh.files import MeshFile, companions, read_mesh_file
from rpod_target.mesh.topology import volume_m3

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.uint16)
VOLUME = 1.0 / 6.0
OBJ = """v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
mtllib colours.mtl
usemtl foil
f 1 3 2
f 1 2 4
f 2 3 4
f 1 4 3
"""
MTL = "newmtl foil\nKd 0.9 0.7 0.1\n"


def read(folder: Path, name: str, content: bytes) -> MeshFile:
    """Read a file as a target's parameter file in its folder refers to it."""
    beside = {
        str(other): (folder / other).read_bytes()
        for other in companions(name, content)
        if (folder / other).is_file()
    }
    return read_mesh_file(name, content, beside)


# ---- OBJ


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32"])
def test_a_text_whose_encoding_is_marked_is_read_with_its_library(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "colours.mtl").write_bytes(MTL.encode(encoding))
    mesh = read(tmp_path, "hull.obj", OBJ.encode(encoding))
    assert volume_m3(mesh.triangles) == pytest.approx(VOLUME)
    assert mesh.materials[0].colour == pytest.approx((0.9, 0.7, 0.1), abs=0.01)


@pytest.mark.parametrize(
    "text",
    [OBJ.replace(" ", "\t"), OBJ.replace("\n", "\n  "), OBJ.replace("\n", "\r"), OBJ.replace("\n", "\r\n")],
    ids=["tabs", "indented", "carriage returns", "both line ends"],
)
def test_words_and_lines_of_an_obj_may_be_separated_in_any_way(tmp_path: Path, text: str) -> None:
    (tmp_path / "colours.mtl").write_text(MTL.replace(" ", "\t"))
    mesh = read(tmp_path, "hull.obj", text.encode())
    assert volume_m3(mesh.triangles) == pytest.approx(VOLUME)
    assert [material.name for material in mesh.materials] == ["foil"]
    assert mesh.materials[0].colour == pytest.approx((0.9, 0.7, 0.1), abs=0.01)


@pytest.mark.parametrize(
    "written",
    ["./colours.mtl", ".\\colours.mtl", "C:\\cad\\colours.mtl", '"colours.mtl"', "colours.mtl other.mtl"],
)
def test_a_library_is_found_however_its_name_is_written(tmp_path: Path, cache: Path, written: str) -> None:
    (tmp_path / "colours.mtl").write_text(MTL)
    (tmp_path / "other.mtl").write_text("newmtl other\nKd 0 0 0\n")
    (tmp_path / "hull.obj").write_text(OBJ.replace("colours.mtl", written))
    made = draft(
        tmp_path / "hull.obj", tmp_path / "hull.yaml", DraftOptions(units="m", mass_kg=1.0), cache=cache
    )
    assert [material.looks for material in made.target.materials] == ["mirror"]
    assert not any("not beside" in told for told in made.told)


@pytest.mark.parametrize("empty", ["mtllib", "mtllib ", "usemtl", "usemtl "])
def test_a_line_of_an_obj_without_its_name_takes_no_other_line_away(empty: str) -> None:
    mesh = read_mesh_file("hull.obj", f"{empty}\n{OBJ}".encode(), {})
    assert volume_m3(mesh.triangles) == pytest.approx(VOLUME)
    assert [material.name for material in mesh.materials] == ["foil"]


@pytest.mark.parametrize(
    ("before", "between"), [("", "usemtl foil\n"), ("usemtl foil\n", "usemtl\n")], ids=["before", "after"]
)
def test_an_object_of_which_some_faces_have_no_material_stays_one_object(before: str, between: str) -> None:
    corners, faces = OBJ.split("mtllib colours.mtl\nusemtl foil\n")
    first, second = faces[:16], faces[16:]
    mesh = read_mesh_file("hull.obj", f"{corners}o hull\n{before}{first}{between}{second}".encode(), {})
    assert mesh.objects == ("hull",)
    assert sorted(set(mesh.triangle_material.tolist())) == [-1, 0]
    assert volume_m3(mesh.triangles) == pytest.approx(VOLUME)


def test_a_coordinate_with_a_comma_is_refused_with_the_remedy() -> None:
    text = OBJ.replace("v 1 0 0", "v 1,5 0 0").replace("f 1 2 4", "f -4 -3 -1")
    with pytest.raises(ValueError, match="coordinate that is no number: export it again, with points"):
        read_mesh_file("hull.obj", text.encode(), {})


# ---- OFF

OFF = """OFF
# a tetrahedron
4 4 6
0 0 0
1 0 0
0 1 0   # a corner
0 0 1

3 0 2 1  212 175 55
3 0 1 3  0.831 0.686 0.216
3 1 2 3
3 0 3 2
"""


@pytest.mark.parametrize(
    "text",
    [
        OFF,
        OFF.replace("OFF\n# a tetrahedron\n", "OFF "),
        OFF.replace("OFF\n", ""),
        OFF.replace("\n", "\r\n"),
        OFF.replace("OFF", "COFF").replace("0 0 1\n", "0 0 1 255 0 0 255\n"),
    ],
    ids=["plain", "one line", "no header", "both line ends", "colours of corners"],
)
def test_an_off_file_is_read_with_the_colours_of_its_faces(text: str) -> None:
    mesh = read_mesh_file("hull.off", text.encode(), {})
    assert len(mesh.triangles) == 4
    assert volume_m3(mesh.triangles) == pytest.approx(VOLUME)
    assert mesh.materials[0].colour == pytest.approx((0.83, 0.69, 0.22), abs=0.01)
    assert np.bincount(mesh.triangle_material + 1).tolist() == [2, 2]


def test_a_colour_beyond_all_colours_is_the_strongest_one() -> None:
    text = OFF.replace("3 1 2 3\n", "3 1 2 3  inf -inf 0.0\n")
    colours = [each.colour for each in read_mesh_file("hull.off", text.encode(), {}).materials]
    assert (1.0, 0.0, 0.0) in colours


def test_a_concave_polygon_of_an_off_file_keeps_its_area() -> None:
    arrow = "OFF\n4 1 0\n0 0 0\n2 1 0\n0 2 0\n1.5 1 0\n4 0 1 2 3\n"
    corners = read_mesh_file("arrow.off", arrow.encode(), {}).triangles
    spanned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert 0.5 * np.linalg.norm(spanned, axis=1).sum() == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("OFF BINARY\n", "is binary OFF, which is not read: export it as text"),
        ("4OFF\n1 0 0\n0 0 0 1\n", "other than three dimensions"),
        (OFF.replace("3 0 3 2\n", ""), "ends before its 4 corners and 4 faces: copy or export it again"),
        (OFF.replace("3 0 3 2", "3 0 3 9"), "a corner that is not in the file"),
        (OFF.replace("3 0 3 2", "3 0 3 -1"), "is no OFF file"),
        (OFF.replace("4 4 6", "four"), "is no OFF file"),
        ("", "is empty"),
    ],
)
def test_an_off_file_that_cannot_be_used_is_refused_with_a_reason(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_mesh_file("hull.off", text.encode(), {})


# ---- glTF


def document(
    primitive: dict[str, Any], arrays: list[tuple[bytes, dict[str, Any]]], **others: Any
) -> dict[str, Any]:
    """Return a document with one mesh; each array has its bytes and its accessor, which may be empty."""
    begins = np.cumsum([0, *(len(content) for content, _ in arrays)])
    views = [
        {"buffer": 0, "byteOffset": int(begin), "byteLength": len(content)}
        for begin, (content, _) in zip(begins, arrays, strict=False)
    ]
    accessors = [{"bufferView": n, **accessor} for n, (_, accessor) in enumerate(arrays) if accessor]
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": int(begins[-1])}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    } | others


def files(made: dict[str, Any], content: bytes, form: str) -> tuple[str, bytes, dict[str, bytes]]:
    """Return name, bytes and companions of a document in a form: its buffer within, beside it, or as GLB."""
    if form == "glb":
        text = json.dumps(made).encode()
        text += b" " * (-len(text) % 4)
        content += bytes(-len(content) % 4)
        length = 12 + 8 + len(text) + 8 + len(content)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(content), b"BIN\0") + content
        return "hull.glb", b"glTF" + struct.pack("<II", 2, length) + chunks, {}
    if form == "beside":
        made["buffers"][0]["uri"] = "./my%20hull.bin"
        return "hull.gltf", json.dumps(made).encode(), {"my hull.bin": content}
    made["buffers"][0]["uri"] = "data:application/octet-stream;base64," + b64encode(content).decode()
    return "hull.gltf", json.dumps(made).encode(), {}


FLOATS = {"componentType": 5126, "count": 4, "type": "VEC3"}
SHORTS = {"componentType": 5123, "count": 12, "type": "SCALAR"}
TETRAHEDRON = [(CORNERS.tobytes(), FLOATS), (FACES.tobytes(), SHORTS)]
PLAIN = {"attributes": {"POSITION": 0}, "indices": 1}
FORMS = pytest.mark.parametrize("form", ["within", "beside", "glb"])


def joined(arrays: list[tuple[bytes, dict[str, Any]]]) -> bytes:
    return b"".join(content for content, _ in arrays)


@FORMS
def test_a_fan_is_read_beside_other_triangles(form: str) -> None:
    fan = np.array([3, 0, 1, 2, 0], np.uint16)  # the three sides above the base
    arrays = [*TETRAHEDRON, (fan.tobytes(), SHORTS | {"count": 5})]
    made = document(PLAIN | {"indices": 2, "mode": 6}, arrays)
    base = {"componentType": 5123, "count": 3, "type": "SCALAR", "bufferView": 1}
    made["accessors"].append(base)
    made["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "indices": 3})
    mesh = read_mesh_file(*files(made, joined(arrays), form))
    assert len(mesh.triangles) == 4
    assert volume_m3(mesh.triangles) == pytest.approx(VOLUME)


def test_a_fan_without_indices_is_read() -> None:
    made = document({"attributes": {"POSITION": 0}, "mode": 6}, TETRAHEDRON)
    mesh = read_mesh_file(*files(made, joined(TETRAHEDRON), "within"))
    np.testing.assert_array_equal(mesh.triangles, CORNERS[[[0, 1, 2], [0, 2, 3]]])


@FORMS
def test_integers_that_stand_for_shares_of_one_are_read_as_these(form: str) -> None:
    shares = np.zeros((4, 4), np.int16)
    shares[:, :3] = 32767 * CORNERS
    arrays = [(shares.tobytes(), FLOATS | {"componentType": 5122, "normalized": True}), TETRAHEDRON[1]]
    made = document(PLAIN, arrays, extensionsRequired=["KHR_mesh_quantization"])
    made["bufferViews"][0]["byteStride"] = 8
    mesh = read_mesh_file(*files(made, joined(arrays), form))
    assert volume_m3(mesh.triangles) == pytest.approx(VOLUME, rel=1e-4)


@FORMS
def test_positions_that_are_replaced_one_by_one_are_read(form: str) -> None:
    arrays = [
        *TETRAHEDRON,
        (np.array([3], np.uint32).tobytes(), {}),
        (np.array([[0, 0, 4]], np.float32).tobytes(), {}),
    ]
    made = document(PLAIN, arrays)
    places = {"bufferView": 2, "componentType": 5125}
    made["accessors"][0]["sparse"] = {"count": 1, "indices": places, "values": {"bufferView": 3}}
    mesh = read_mesh_file(*files(made, joined(arrays), form))
    assert volume_m3(mesh.triangles) == pytest.approx(4.0 * VOLUME)


def test_a_buffer_that_is_not_there_is_named_as_a_file_is() -> None:
    made = document(PLAIN | {"mode": 6}, TETRAHEDRON)
    name, content, _ = files(made, joined(TETRAHEDRON), "beside")
    with pytest.raises(ValueError, match=r"refers to 'my hull\.bin', which is not beside it: copy that file"):
        read_mesh_file(name, content, {})


def test_values_that_are_announced_and_not_there_take_no_memory() -> None:
    made = document(PLAIN, TETRAHEDRON)
    del made["accessors"][0]["bufferView"]
    made["accessors"][0]["count"] = 10**11
    with pytest.raises(ValueError, match="announces 100000000000 values that are not in it: export it again"):
        read_mesh_file(*files(made, joined(TETRAHEDRON), "glb"))


def test_copies_of_an_object_count_towards_the_most_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    made = document(PLAIN, TETRAHEDRON)
    made["nodes"] = [{"mesh": 0}, {"mesh": 0}]
    made["scenes"] = [{"nodes": [0, 1]}]
    monkeypatch.setattr(mesh_files, "MOST_TRIANGLES", 7)
    with pytest.raises(ValueError, match="contains 8 triangles, at most 7 are read: simplify it first"):
        read_mesh_file(*files(made, joined(TETRAHEDRON), "glb"))


def test_instances_are_refused_since_their_reader_shows_one_of_them() -> None:
    made = document(PLAIN, TETRAHEDRON, extensionsUsed=["EXT_mesh_gpu_instancing"])
    with pytest.raises(ValueError, match=r"instances of meshes \(EXT_mesh_gpu_instancing\).*without this"):
        read_mesh_file(*files(made, joined(TETRAHEDRON), "glb"))


def two_materials(names: tuple[str, str]) -> dict[str, Any]:
    """Return a document with two nodes of one mesh, which has a yellow and a blue primitive."""
    made = document(PLAIN | {"material": 0}, TETRAHEDRON)
    made["accessors"] += [
        SHORTS | {"bufferView": 1, "count": 6},
        SHORTS | {"bufferView": 1, "byteOffset": 12, "count": 6},
    ]
    made["meshes"][0]["primitives"] = [PLAIN | {"indices": 2 + n, "material": n} for n in (0, 1)]
    made["materials"] = [
        {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0]}}
        if name
        else {"pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0]}}
        for name, colour in zip(names, ((1.0, 1.0, 0.0), (0.0, 0.0, 1.0)), strict=True)
    ]
    made["nodes"] = [{"name": "bus", "mesh": 0}, {"name": "copy", "mesh": 0, "translation": [3.0, 0.0, 0.0]}]
    made["scenes"] = [{"nodes": [0, 1]}]
    return made


def test_a_node_of_a_mesh_with_several_materials_is_one_object_of_its_own_name() -> None:
    """Blender writes a primitive for each material; a target's file refers to the object by its name."""
    file = files(two_materials(("foil", "cells")), joined(TETRAHEDRON), "glb")
    for _ in range(2):  # a reading after another one
        mesh = read_mesh_file(*file)
        assert set(mesh.objects) == {"bus", "copy"}
        assert np.bincount(mesh.triangle_object).tolist() == [4, 4]
        assert np.bincount(mesh.triangle_material).tolist() == [4, 4]


@pytest.mark.parametrize("names", [("", ""), ("paint", "paint")])
def test_materials_without_a_name_or_of_one_name_keep_their_colours(names: tuple[str, str]) -> None:
    mesh = read_mesh_file(*files(two_materials(names), joined(TETRAHEDRON), "glb"))
    assert len({material.name for material in mesh.materials}) == 2
    colours = {tuple(np.round(material.colour, 6)) for material in mesh.materials if material.colour}
    assert colours == {(1.0, 1.0, 0.0), (0.0, 0.0, 1.0)}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "hull.stl",
            "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0,5 1\nendloop\nendfacet\nendsolid s\n",
        ),
        ("hull.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n-0,5\n"),
        ("hull.off", "OFF\n3 1 0\n0,5 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
    ],
)
def test_a_text_with_commas_as_decimal_marks_is_refused_with_the_remedy(
    tmp_path: Path, name: str, text: str
) -> None:
    with pytest.raises(ValueError, match="commas as decimal marks: export it again with points"):
        read(tmp_path, name, text.encode())


def test_a_comma_in_an_obj_of_triangles_is_told_with_its_line(tmp_path: Path) -> None:
    text = "# 1,234 corners\nv 0 0 0,5\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    with pytest.raises(ValueError, match="with points before the decimals; line 2 is 'v 0 0 0,5'"):
        read(tmp_path, "hull.obj", text.encode())


def test_an_obj_whose_corners_are_counted_from_zero_is_refused(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 2 1 0\n"
    with pytest.raises(
        ValueError, match=r"has a face with a corner that is not in the file.*; line 6 is 'f 2 1 0'"
    ):
        read(tmp_path, "hull.obj", text.encode())


def test_coordinates_that_are_not_finite_are_counted_and_the_first_one_is_named(tmp_path: Path) -> None:
    text = "o hull\n" + OBJ + "v nan 0 0\no antenna\nf 1 2 5\n"
    with pytest.raises(ValueError, match=r"1 of 5 triangles .* not finite, .* object 'antenna'"):
        read(tmp_path, "hull.obj", text.encode())
