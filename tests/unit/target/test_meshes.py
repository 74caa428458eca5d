"""Mesh files as they come: open, doubled, inverted, with cavities and slivers; units and mass."""

import json
from base64 import b64encode
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from rpod_schemas.arrays import FloatArray
from rpod_target import Target, TargetError, load_target
from rpod_target.build.surfaces import box_surface
from rpod_target.mesh.files import companions, read_mesh_file
from rpod_target.mesh.repair import repair, winding_number
from rpod_target.mesh.topology import open_edges, volume_m3
from rpod_target.parameters import BoxParameters

Build = Callable[..., Target]
GRID = {"spacing_m": 0.05, "margin_m": 0.23}


def box(*size_m: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> FloatArray:
    part = BoxParameters(name="part", material="paint", shape="box", size_m=size_m)  # type: ignore[arg-type]
    return box_surface(part).triangles_m + np.array(at)


BRICK = box(2.0, 1.0, 0.5)


def half_turned(triangles: FloatArray) -> FloatArray:
    turned = triangles.copy()
    turned[::2] = turned[::2, ::-1]
    return turned


def with_a_sliver(triangles: FloatArray) -> FloatArray:
    """Split the first triangle at one side, and keep the gap closed by a triangle without area."""
    a, b, c = triangles[0]
    middle = 0.5 * (a + b)
    return np.concatenate([triangles[1:], [[a, middle, c], [middle, b, c], [a, b, middle]]])


def fan_of_slivers(triangles: FloatArray) -> FloatArray:
    """Split one side of the first triangle into four, closed by slivers that are each other's neighbours."""
    a, b, c = triangles[0]
    p, q, r = (a + share * (b - a) for share in (0.2, 0.5, 0.7))
    faces = [[a, p, c], [p, q, c], [q, r, c], [r, b, c]]
    slivers = [[a, b, r], [a, r, q], [a, q, p]]
    return np.concatenate([triangles[1:], faces, slivers])


def apart(triangles: FloatArray) -> FloatArray:
    """Move each triangle by some micrometres, so that none shares a corner with its neighbours."""
    return triangles + 2e-5 * np.random.default_rng(3).normal(size=(len(triangles), 1, 3))


STRANGE = {
    "as it is": BRICK,
    "inverted": BRICK[:, ::-1],
    "doubled": np.concatenate([BRICK, BRICK]),
    "two-sided": np.concatenate([BRICK, BRICK[:, ::-1]]),
    "half turned": half_turned(BRICK),
    "with a cavity": np.concatenate([BRICK, box(1.0, 0.5, 0.2)[:, ::-1]]),
    "inverted with a cavity": np.concatenate([BRICK, box(1.0, 0.5, 0.2)[:, ::-1]])[:, ::-1],
    "sliver": with_a_sliver(BRICK),
    "fan of slivers": fan_of_slivers(BRICK),
    "without its slivers": with_a_sliver(BRICK)[:-1],
    "apart": apart(BRICK),
    "apart and half turned": half_turned(apart(BRICK)),
}


@pytest.fixture
def mesh(build: Build, write_stl: Callable[[str, Any], Path]) -> Build:
    def mesh(triangles: FloatArray, **fields: Any) -> Target:
        write_stl("hull.stl", triangles)
        part = {"shape": "mesh", "file": "hull.stl", "metres_per_unit": 1.0, "name": "hull"}
        return build(part, **{"distance_field": GRID, "model_points": 150} | fields)

    return mesh


@pytest.mark.parametrize("triangles", STRANGE.values(), ids=STRANGE.keys())
def test_every_mesh_that_shows_a_brick_has_the_brick_s_field(mesh: Build, triangles: FloatArray) -> None:
    expected, field = mesh(BRICK).require_field(), mesh(triangles).require_field()
    shape = tuple(map(min, zip(expected.values.shape, field.values.shape, strict=True)))
    block = tuple(slice(0, count) for count in shape)
    np.testing.assert_allclose(field.values[block], expected.values[block], atol=3e-4)


@pytest.mark.parametrize("triangles", STRANGE.values(), ids=STRANGE.keys())
def test_every_mesh_that_shows_a_brick_shows_its_surface_and_no_other(
    mesh: Build, triangles: FloatArray
) -> None:
    target = mesh(triangles)
    beyond = np.abs(target.model_points_m) - [1.0, 0.5, 0.25]
    np.testing.assert_allclose(beyond.max(axis=1), 0.0, atol=3e-4)
    assert (np.einsum("ij,ij->i", target.model_points_m, target.model_normals) > 0.0).all()
    assert np.isfinite(target.normals).all()


def test_what_was_repaired_is_told(mesh: Build) -> None:
    assert mesh(BRICK).repairs == ()
    (told,) = mesh(BRICK[:, ::-1]).repairs
    assert told == "hull.stl: 1 closed surfaces that faced inwards were turned outwards"


@pytest.mark.parametrize("name", ["sliver", "fan of slivers", "doubled", "half turned", "apart"])
def test_the_repair_leaves_a_closed_surface_of_the_same_volume(name: str) -> None:
    mesh = repair(STRANGE[name])
    assert mesh.open_edges.tolist() == [0]
    assert open_edges(mesh.triangles) == 0
    assert volume_m3(mesh.triangles) == pytest.approx(1.0, abs=1e-3)


def test_a_surface_without_faults_stays_as_it_is_bit_for_bit() -> None:
    heap = np.concatenate([BRICK, box(0.3, 0.3, 2.0, at=(0.3, 0.1, 0.0))])
    np.testing.assert_array_equal(repair(heap).triangles, heap)


def test_a_mesh_with_a_hole_has_a_field_that_is_negative_inside(mesh: Build) -> None:
    target = mesh(np.concatenate([BRICK[1:], box(0.1, 0.1, 0.1, at=(0.0, 0.0, 0.4))]))
    field = target.require_field()
    middle = tuple(np.round(([0.9, -0.4, 0.0] - field.origin_m) / field.spacing_m).astype(int))
    assert field.values[middle] < 0.0
    assert any("open edges" in told for told in target.repairs)


def test_both_sides_of_a_sheet_are_surfaces(mesh: Build) -> None:
    sheet = np.array([[[-1.0, -1, 0], [1, -1, 0], [1, 1, 0]], [[-1.0, -1, 0], [1, 1, 0], [-1, 1, 0]]])
    target = mesh(sheet)
    assert target.parts == ("hull", "hull-back")
    assert target.normals[:, 2].tolist() == [1.0, 1.0, -1.0, -1.0]
    assert (target.model_normals[:, 2] > 0.0).mean() == pytest.approx(0.5, abs=0.05)
    assert target.require_field().values.min() >= 0.0
    assert len(target.edges_m) == 4


def test_an_open_cup_is_hollow(mesh: Build) -> None:
    lid = np.isclose(BRICK[:, :, 2], 0.25).all(axis=1)
    target = mesh(BRICK[~lid])
    assert (np.abs(target.model_points_m) - [1.0, 0.5, 0.25] < -0.1).all(axis=1).sum() == 0
    floor = np.isclose(target.model_points_m[:, 2], -0.25)
    assert set(np.sign(target.model_normals[floor, 2])) >= {-1.0, 1.0}
    field = target.require_field()
    middle = tuple(np.round(([0.0, 0.0, 0.1] - field.origin_m) / field.spacing_m).astype(int))
    assert field.values[middle] > 0.0


def test_surfaces_that_cut_through_each_other_at_a_shared_corner_are_one_body(mesh: Build) -> None:
    target = mesh(np.concatenate([BRICK, box(2.0, 1.0, 0.5, at=(1.0, 0.5, 0.25))]))
    field = target.require_field()
    common = tuple(np.round(([0.5, 0.25, 0.125] - field.origin_m) / field.spacing_m).astype(int))
    assert field.values[common] < 0.0
    assert (np.abs(target.model_points_m) - [1.0, 0.5, 0.25] < -1e-3).all(axis=1).sum() == 0


def test_the_winding_number_is_one_inside_and_zero_outside() -> None:
    found = winding_number(BRICK, np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.9, 0.4, 0.2]]))
    np.testing.assert_allclose(found, [1.0, 0.0, 1.0], atol=0.01)


# ---- formats


def written(name: str, folder: Path) -> Path:
    """Write two boxes of two colours in a format, and return the file."""
    body = trimesh.Trimesh(*_indexed(BRICK), process=False)
    array = trimesh.Trimesh(*_indexed(box(0.1, 2.0, 1.0, at=(1.5, 0.0, 0.0))), process=False)
    for one, label, colour in ((body, "gold-foil", (212, 175, 55)), (array, "cells", (10, 20, 120))):
        material = trimesh.visual.material.PBRMaterial(name=label, baseColorFactor=[*colour, 255])
        one.visual = trimesh.visual.TextureVisuals(material=material)
    scene = trimesh.Scene({"body": body, "array": array})
    file = folder / name
    if name.endswith(".ply"):
        trimesh.util.concatenate([body, array]).export(file)
    elif name.endswith(".gltf"):
        for part, content in scene.export(file_type="gltf").items():
            (folder / (name if part == "model.gltf" else part)).write_bytes(content)
    else:
        scene.export(file)
    return file


def _indexed(triangles: FloatArray) -> tuple[FloatArray, Any]:
    return triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def read(file: Path) -> Any:
    content = file.read_bytes()
    beside = {
        str(file.parent / name): (file.parent / name).read_bytes() for name in companions(file.name, content)
    }
    return read_mesh_file(str(file), content, beside)


@pytest.mark.parametrize("name", ["two.stl", "two.ply", "two.glb", "two.gltf"])
def test_each_format_is_read_with_all_its_triangles(name: str, tmp_path: Path) -> None:
    mesh = read(written(name, tmp_path))
    assert len(mesh.triangles) == 24
    assert sum(volume_m3(one) for one in (mesh.triangles[:12], mesh.triangles[12:])) == pytest.approx(1.2)
    if "gl" in name:
        assert set(mesh.objects) == {"body", "array"}
        found = {material.name: material for material in mesh.materials}
        assert set(found) == {"gold-foil", "cells"}
        assert found["cells"].colour == pytest.approx((0.22, 0.31, 0.72), abs=0.01)  # as shown


OBJ = """mtllib colours.mtl
o body
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
vt 0 0
vn 0 0 1
usemtl foil
f 4/1/1 3/1/1 2/1/1 1/1/1
f 1 2 5
usemtl unknown to the library
f 2 3 5
o antenna
f 3 4 5
f 4 1 5
"""


def test_an_obj_has_objects_and_materials_also_without_its_library(tmp_path: Path) -> None:
    (tmp_path / "two.obj").write_text(OBJ)
    (tmp_path / "colours.mtl").write_text("newmtl foil\nKd 0.9 0.7 0.1\nKs 1 1 1\nmap_Kd missing.png\n")
    mesh = read(tmp_path / "two.obj")
    assert len(mesh.triangles) == 6
    assert set(mesh.objects) == {"body", "antenna"}
    found = {material.name: material for material in mesh.materials}
    assert found["foil"].colour == pytest.approx((0.9, 0.7, 0.1), abs=0.01)
    assert found["foil"].specular == 1.0
    assert found["unknown to the library"].colour is None
    assert read_mesh_file("two.obj", OBJ.encode(), {}).materials[0].colour is None
    assert open_edges(mesh.triangles) == 0


def test_groups_of_an_obj_without_objects_are_its_objects() -> None:
    mesh = read_mesh_file("two.obj", OBJ.replace("\no ", "\ng ").encode(), {})
    assert set(mesh.objects) == {"body", "antenna"}
    assert sorted(np.bincount(mesh.triangle_object)) == [2, 4]


def test_objects_of_one_file_are_parts_with_materials_by_name(build: Build, tmp_path: Path) -> None:
    (tmp_path / "two.obj").write_text(OBJ)
    part = {"shape": "mesh", "file": "two.obj", "metres_per_unit": 1.0}
    target = build(
        part | {"name": "body", "object": "body", "file_materials": {"foil": "foil"}},
        part | {"name": "antenna", "object": "antenna"},
    )
    assert target.parts == ("body", "antenna")
    assert np.bincount(target.triangle_part).tolist() == [4, 2]
    assert np.bincount(target.triangle_material).tolist() == [3, 3]
    assert target.repairs == ()  # together they are closed


def test_an_unknown_object_is_refused_with_the_known_ones(build: Build, tmp_path: Path) -> None:
    (tmp_path / "two.obj").write_text(OBJ)
    part = {"shape": "mesh", "file": "two.obj", "metres_per_unit": 1.0, "object": "wing"}
    with pytest.raises(
        TargetError, match=r"parts\.0\.object: two\.obj has no object 'wing': name one of .*'body'"
    ):
        build(part)


def test_an_unknown_material_of_the_file_is_refused_with_the_known_ones(build: Build, tmp_path: Path) -> None:
    (tmp_path / "two.obj").write_text(OBJ)
    part = {"shape": "mesh", "file": "two.obj", "metres_per_unit": 1.0, "file_materials": {"foils": "foil"}}
    with pytest.raises(
        TargetError, match=r"parts\.0\.file_materials: two\.obj has no material 'foils': name one of .*'foil'"
    ):
        build(part)


STL = b"solid made by a CAD program".ljust(80) + (4).to_bytes(4, "little") + bytes(4 * 50)
CLOUD = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"end_header\n0 0 0\n1 0 0\n0 1 0\n"
)
DAMAGED = CLOUD.replace(b"end_header", b"element face 3\nproperty list uchar int vertex_indices\nend_header")
DAMAGED += b"3 0 1 2\n3 0 2\n3 0 2 1\n"
CORNERS = bytes(36) + b"\0\0\1\0\xff\xff"  # three corners, and a triangle of the corners 0, 1 and 65535
AMISS = {
    "asset": {"version": "2.0"},
    "buffers": [{"byteLength": 42, "uri": "data:;base64," + b64encode(CORNERS).decode()}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
    ],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "nodes": [{"mesh": 0}],
    "scenes": [{"nodes": [0]}],
}
DRACO = {"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]}


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("hull.stl", b"", r"is empty \(0 bytes\): copy or export it again"),
        ("hull.stl", b"hello\n", "is no STL, neither binary nor text: export it again"),
        ("hull.obj", b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n", "with git lfs pull"),
        ("hull.glb", b"\n<!DOCTYPE html><html>Sign in</html>", "is a web page.*: download the file itself"),
        ("hull.stl", b"ISO-10303-21; a STEP file", "content is STEP: give it the suffix .step"),
        ("hull.stl", STL[:-60], "ends after 2 of 4 triangles: copy or export it again"),
        ("hull.stl", STL[:80] + bytes(4) + STL[84:], "announces 0 triangles, but 4 follow"),
        ("hull.obj", STL, "is named .obj, but its content is STL: give it the suffix .stl"),
        ("hull.obj", b"v 0 0 0\nv 1 0 0\nl 1 2\n", "2 points and no face.*make a mesh of it"),
        ("hull.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", r"not in the file.*; line 4 is 'f 1 2 9'"),
        ("hull.obj", b"v 0 0 0\n# a corner\nv 1 0,5 0\nv 0 1 0\nf 1 -1 -2 3\n", r"; line 3 is 'v 1 0,5 0'"),
        ("hull.obj", b"v 0 0 0\nv 1 0 0\nf -1 -2 -3\nv 0 1 0\nf 1 2 3\n", r"; line 3 is 'f -1 -2 -3'"),
        ("hull.gltf", json.dumps(AMISS).encode(), "face with a corner that is not in the file"),
        ("hull.gltf", json.dumps(AMISS).replace("5126", "[5126]").encode(), "cannot be read as GLTF"),
        ("hull.ply", CLOUD, "3 points and no face, so it is a point cloud"),
        (
            "hull.gltf",
            json.dumps(DRACO).encode(),
            "KHR_draco_mesh_compression.*export it without compression",
        ),
        ("hull.gltf", b"[" * 100_000, "is no glTF, whose text is one JSON object"),
        ("hull.ply", b"ply\nnonsense", "cannot be read as PLY"),
        ("hull.ply", DAMAGED, "announces 3 faces, of which 2 triangles could be read: export it again"),
        ("hull.glb", b"glTF but short", "cannot be read as GLB"),
        ("hull.gltf", json.dumps({"buffers": [{"uri": "gone.bin"}]}).encode(), "GLTF|gone"),
        ("hull.dae", b"<xml>", r"no known format: give one of \.stl"),
    ],
)
def test_what_is_no_usable_file_is_refused_with_a_reason(name: str, content: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_mesh_file(name, content, {})


TRIANGLE = (
    b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
)


def test_a_text_in_capitals_is_read_as_stl() -> None:
    (triangle,) = read_mesh_file("hull.stl", (TRIANGLE + b"endsolid a\n").upper(), {}).triangles
    assert np.ptp(triangle, axis=0).tolist() == [1.0, 1.0, 0.0]


def test_a_text_with_a_zero_byte_at_its_end_is_read_as_the_text_that_it_is() -> None:
    corners = b"".join(b"vertex %d %d 0\n" % corner for corner in ((0, 0), (1, 0), (0, 1)))
    text = b"solid a\nfacet normal 0 0 1\nouter loop\n" + corners + b"endloop\nendfacet\nendsolid a\n"
    assert len(read_mesh_file("hull.stl", text + b"\0", {}).triangles) == 1


# ---- units and mass


@pytest.mark.parametrize(("scale", "size"), [(1e-3, r"0\.002 m"), (1e3, "2000 m")])
def test_a_size_that_is_likely_a_wrong_unit_needs_to_be_confirmed(
    build: Build, write_stl: Callable[[str, Any], Path], scale: float, size: str
) -> None:
    write_stl("hull.stl", BRICK)
    part = {"shape": "mesh", "file": "hull.stl", "metres_per_unit": scale}
    fields = {"distance_field": {}, "model_points": 50}
    with pytest.raises(TargetError, match=rf"parts\.0\.metres_per_unit: .*{size}.*confirmed_size: true"):
        build(part, **fields)
    assert build(part, confirmed_size=True, **fields).radius_m == pytest.approx(1.1456 * scale, rel=1e-3)


def without(document: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in document.items() if name not in names}


@pytest.mark.parametrize("fields", [{"mass_kg": 12.0}, {"density_kg_m3": 12.0}])
def test_mass_properties_come_from_the_mesh(
    document: dict[str, Any],
    write: Callable[[dict[str, Any]], Path],
    write_stl: Callable[[str, Any], Path],
    cache: Path,
    fields: dict[str, Any],
) -> None:
    write_stl("hull.stl", BRICK + np.array([0.1, 0.2, 0.3]))
    part = {"name": "hull", "material": "paint", "shape": "mesh", "file": "hull.stl", "metres_per_unit": 1.0}
    bare = without(document, "centre_of_mass_m", "inertia_kg_m2")
    target = load_target(write(bare | {"parts": [part]} | fields), cache=cache)
    np.testing.assert_allclose(target.centre_of_mass_m, [0.1, 0.2, 0.3], atol=1e-6)
    np.testing.assert_allclose(target.inertia_kg_m2, np.diag([1.25, 4.25, 5.0]), atol=1e-5)
    skin = load_target(write(bare | {"parts": [part], "mass_spread": "surface"} | fields), cache=cache)
    np.testing.assert_allclose(skin.centre_of_mass_m, [0.1, 0.2, 0.3], atol=1e-6)
    assert (np.diag(skin.inertia_kg_m2) > np.diag(target.inertia_kg_m2)).all()


def test_a_density_needs_a_closed_surface(
    document: dict[str, Any],
    write: Callable[[dict[str, Any]], Path],
    write_stl: Callable[[str, Any], Path],
    cache: Path,
) -> None:
    write_stl("sheet.stl", BRICK[:2])
    part = {"name": "s", "material": "paint", "shape": "mesh", "file": "sheet.stl", "longest_side_m": 1.0}
    bare = without(document, "centre_of_mass_m", "inertia_kg_m2") | {"parts": [part], "density_kg_m3": 3.0}
    with pytest.raises(TargetError, match=r"density_kg_m3: needs a closed surface.*give mass_kg"):
        load_target(write(bare), cache=cache)
