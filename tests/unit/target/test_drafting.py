"""Parameter files written from CAD files, the symmetries in them, and large meshes."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import trimesh

from rpod_target import Target, TargetError, load_target, symmetry
from rpod_target.build import pieces
from rpod_target.drafting import draft as drafting
from rpod_target.drafting.draft import DraftOptions, draft
from rpod_target.drafting.materials import proposed
from rpod_target.mesh.files import FileMaterial
from rpod_target.mesh.simplification import ENOUGH, simplified
from rpod_target.symmetry import FoundSymmetry, Likeness, find_symmetries

OBJ = """mtllib colours.mtl
o body
{body}
o solar wing
{wing}
"""
MTL = "newmtl grey\nKd 0.5 0.5 0.5\nnewmtl blue stuff\nKd 0.1 0.1 0.7\n"


def obj_box(
    *, sides: tuple[float, float, float], at: tuple[float, float, float], first: int, use: str
) -> str:
    box = trimesh.creation.box(sides)
    corners = [f"v {x} {y} {z}" for x, y, z in box.vertices + np.array(at)]
    faces = [f"f {a + first} {b + first} {c + first}" for a, b, c in box.faces]
    return "\n".join([*corners, f"usemtl {use}", *faces])


@pytest.fixture
def cad(tmp_path: Path) -> Path:
    """A body of 1 x 1 x 2 units with a wing on one side, and its colours."""
    body = obj_box(sides=(1.0, 1.0, 2.0), at=(0.0, 0.0, 0.0), first=1, use="grey")
    wing = obj_box(sides=(0.1, 3.0, 1.0), at=(0.0, 2.0, 0.0), first=9, use="blue stuff")
    (tmp_path / "sat.obj").write_text(OBJ.format(body=body, wing=wing))
    (tmp_path / "colours.mtl").write_text(MTL)
    return tmp_path / "sat.obj"


def test_a_material_may_have_the_name_of_faces_without_one(cad: Path, cache: Path) -> None:
    text = cad.read_text().replace("usemtl grey\n", "").replace("blue stuff", "plain")
    cad.write_text(text)
    (cad.parent / "colours.mtl").write_text(MTL.replace("blue stuff", "plain"))
    made = draft(cad, cad.parent / "out" / "sat.yaml", DraftOptions(units="m", mass_kg=50.0), cache=cache)
    assert {"plain", "plain-2"} <= {
        material.name for material in load_target(made.file, cache=cache).materials
    }


def test_a_target_is_written_from_a_cad_file(cad: Path, cache: Path) -> None:
    said: list[str] = []
    options = DraftOptions(units="m", mass_kg=50.0)
    made = draft(cad, cad.parent / "out" / "sat.yaml", options, cache=cache, say=said.append)
    assert [each.split()[0] for each in said] == ["reading", "building", "looking", "building"]
    target = load_target(made.file, cache=cache)
    assert target.parts == ("body", "solar-wing")
    assert {material.name for material in target.materials} == {"blue-stuff", "grey"}
    assert {material.looks for material in target.materials} == {"dark", "grey"}
    np.testing.assert_allclose(np.ptp(target.triangles_m, axis=(0, 1)), [1.0, 4.0, 2.0], atol=1e-9)
    assert made.told == ()


def test_the_longest_side_decides_over_the_unit_and_that_is_told(cad: Path, cache: Path) -> None:
    made = draft(cad, cad.with_suffix(".yaml"), DraftOptions(units="mm", longest_side_m=2.0), cache=cache)
    assert np.ptp(made.target.triangles_m, axis=(0, 1)).max() == pytest.approx(2.0)
    assert any("scaled to 2 m" in text for text in made.told)
    assert any("kg are assumed" in text for text in made.told)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (DraftOptions(), "--units: is missing, .* longest side is 4 units: it is 4 m with m, 0.4 m with dm"),
        (DraftOptions(units="inch"), "--units: is 'inch'; it must be one of m, dm, cm"),
        (DraftOptions(units="mm"), "longest side 0.004 m.*4 m with m, 0.4 m with dm.*--confirm-size"),
        (
            DraftOptions(units="m", mass_kg=50.0, density_kg_m3=10.0),
            "--density-kg-m3: is 10 beside a mass of 50 kg: give one of the two",
        ),
    ],
)
def test_what_is_not_known_or_contradicts_is_refused_and_no_file_is_left(
    cad: Path, cache: Path, options: DraftOptions, reason: str
) -> None:
    with pytest.raises(TargetError, match=reason):
        draft(cad, cad.with_suffix(".yaml"), options, cache=cache)
    assert not cad.with_suffix(".yaml").exists()


def test_a_parameter_file_with_the_ending_of_a_cad_file_is_refused_and_the_cad_file_is_kept(
    cad: Path, cache: Path
) -> None:
    before = cad.read_bytes()
    with pytest.raises(TargetError, match=r"--out: ends with \.obj, .*give another name, such as sat\.yaml"):
        draft(cad, cad, DraftOptions(units="m"), cache=cache)
    assert cad.read_bytes() == before


def test_a_cad_file_without_area_is_named_in_the_error(tmp_path: Path, cache: Path) -> None:
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(TargetError, match=r"^\S*line\.obj: contains no triangle with an area"):
        draft(tmp_path / "line.obj", tmp_path / "out" / "sat.yaml", DraftOptions(units="m"), cache=cache)


def test_objects_that_become_one_part_are_told(tmp_path: Path, cache: Path) -> None:
    boxes = [
        f"o box {n}\n" + obj_box(sides=(0.4, 0.4, 0.5), at=(0.5 * n, 0.0, 0.0), first=1 + 8 * n, use="grey")
        for n in range(65)
    ]
    (tmp_path / "many.obj").write_text("\n".join(boxes))
    made = draft(
        tmp_path / "many.obj",
        tmp_path / "many.yaml",
        DraftOptions(units="m"),
        cache=cache,
        symmetries=lambda _: [],
    )
    assert made.target.parts == ("many",)
    assert any(text.startswith("its 65 objects become one part, since more than 64") for text in made.told)


def test_names_keep_their_letters_and_a_library_that_is_missing_is_told(cad: Path, cache: Path) -> None:
    cad.with_name("colours.mtl").unlink()
    other = cad.rename(cad.with_name("Größe 1.obj"))
    made = draft(other, cad.with_suffix(".yaml"), DraftOptions(units="m", mass_kg=5.0), cache=cache)
    assert made.target.name == "Grosse-1"
    assert "file: Größe 1.obj" in made.file.read_text(encoding="utf-8")
    assert any("'colours.mtl' is not beside Größe 1.obj" in text for text in made.told)


def test_symmetries_are_found_and_written(cad: Path, cache: Path) -> None:
    made = draft(cad, cad.with_suffix(".yaml"), DraftOptions(units="m", origin="centre"), cache=cache)
    assert [(symmetry.order, symmetry.exact) for symmetry in made.target.symmetries] == [(2, True)]
    np.testing.assert_allclose(np.abs(made.target.symmetries[0].axis), [0.0, 1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(("name", "orders"), [("hexagonal-body", {6: 1, 2: 6}), ("rocket-stage", {8: 1})])
def test_the_symmetries_of_a_shipped_target_are_those_that_its_file_declares(
    name: str, orders: dict[int, int], shipped_by_name: dict[str, Target]
) -> None:
    found = [one for one in find_symmetries(shipped_by_name[name]) if one.exact]
    assert {order: sum(one.order == order for one in found) for order in orders} == orders
    assert len(found) == sum(orders.values())


def test_a_body_that_small_turns_hardly_change_has_the_order_of_its_large_ones(
    tmp_path: Path, cache: Path
) -> None:
    """A can with an oval upper end and a box on one side: after 360/64 deg nearly all of it agrees."""
    can = trimesh.creation.cylinder(radius=0.3, height=1.0, sections=128)
    can.vertices[can.vertices[:, 2] > 0.0] *= [1.0, 0.8, 1.0]
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.apply_translation([0.33, 0.0, 0.0])
    trimesh.util.concatenate([can, box]).export(tmp_path / "can.stl")
    made = draft(tmp_path / "can.stl", tmp_path / "can.yaml", DraftOptions(units="m"), cache=cache)
    along = [one for one in find_symmetries(made.target) if abs(one.axis[2]) > 0.99]
    assert [(one.order, one.exact) for one in along if not one.continuous] == [(2, False)]


def test_a_ball_with_a_boom_is_turned_by_high_orders_about_a_few_axes_only(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    boom = trimesh.creation.box((0.02, 0.02, 0.3))
    boom.apply_translation([0.0, 0.0, 0.6])
    ball = trimesh.util.concatenate([trimesh.creation.icosphere(subdivisions=3, radius=0.5), boom])
    ball.export(tmp_path / "ball.stl")
    turned = set()

    def nearly_alike(
        _: symmetry._Matcher, axis: np.ndarray, order: int, **_limits: float
    ) -> tuple[float, float]:
        if order > 12:
            turned.add(tuple(axis))
        return np.inf, 0.9

    monkeypatch.setattr(symmetry._Matcher, "errors", lambda *_: (np.inf, 0.9))
    monkeypatch.setattr(symmetry._Matcher, "errors_of_order", nearly_alike)
    draft(tmp_path / "ball.stl", tmp_path / "ball.yaml", DraftOptions(units="m"), cache=cache)
    assert 0 < len(turned) <= 12


@pytest.fixture(scope="session")
def shipped_by_name(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Target]:
    import rpod_target  # noqa: PLC0415 - for its folder only

    folder = tmp_path_factory.mktemp("coarse")
    targets = {}
    for name in ("hexagonal-body", "rocket-stage"):
        text = (Path(rpod_target.__file__).parent / "targets" / f"{name}.yaml").read_text()
        (folder / f"{name}.yaml").write_text(text.replace("spacing_m: 0.", "spacing_m: 1."))
        targets[name] = load_target(folder / f"{name}.yaml", cache=cache)
    return targets


@pytest.mark.parametrize(
    ("material", "kind"),
    [
        (FileMaterial("GoldFoil", None, None, None), "foil, by its name"),
        (FileMaterial("m1", (0.9, 0.6, 0.1), None, None), "foil, by its colour"),
        (FileMaterial("m2", (0.1, 0.1, 0.6), None, None), "solar cells, by its colour"),
        (FileMaterial("m3", (0.5, 0.5, 0.5), None, 0.9), "metal, by its metallic share"),
        (FileMaterial("m4", (0.9, 0.9, 0.9), None, None), "paint, by its brightness"),
        (FileMaterial("m5", None, None, None), "unknown: the file gives no colour"),
    ],
)
def test_a_material_is_proposed_from_name_and_colour(material: FileMaterial, kind: str) -> None:
    assert proposed(material).reason == kind


def test_a_large_mesh_is_simplified_within_its_bound() -> None:
    sphere = np.asarray(trimesh.creation.icosphere(subdivisions=6).triangles)
    assert len(sphere) > ENOUGH
    triangles, nearest, told = simplified(sphere, largest_error=0.002)
    assert told is not None
    assert len(triangles) == told[0] <= ENOUGH
    assert told[2] <= 0.002
    np.testing.assert_allclose(np.linalg.norm(triangles, axis=2), 1.0, atol=0.002)
    gap = np.linalg.norm(sphere[nearest].mean(axis=1) - triangles.mean(axis=1), axis=1)
    assert gap.max() < 0.05


def test_a_mesh_that_cannot_be_simplified_within_the_bound_keeps_its_triangles() -> None:
    sphere = np.asarray(trimesh.creation.icosphere(subdivisions=6).triangles)
    triangles, nearest, told = simplified(sphere, largest_error=1e-9)
    assert told is None
    assert triangles is sphere
    assert nearest.tolist() == list(range(len(sphere)))


def test_a_cad_file_is_parsed_once(cad: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed = []
    for module in (drafting, pieces):
        read = module.read_mesh_file
        monkeypatch.setattr(
            module,
            "read_mesh_file",
            lambda name, *rest, read=read, **more: parsed.append(name) or read(name, *rest, **more),
        )
    made = draft(cad, cad.parent / "one" / "sat.yaml", DraftOptions(units="m", mass_kg=7.5), cache=cache)
    assert parsed == ["sat.obj"]
    again = load_target(made.file, cache=cad.parent / "empty")
    assert parsed == ["sat.obj", "../sat.obj"]
    np.testing.assert_array_equal(again.triangles_m, made.target.triangles_m)


@pytest.mark.parametrize("origin", ["auto", "file"])
def test_the_origin_is_moved_to_the_axis_of_a_symmetry_that_sensors_mistake(
    tmp_path: Path, cache: Path, origin: Literal["auto", "file"]
) -> None:
    """Without the symmetry in the file, a first pose half a turn off is accepted."""
    body = trimesh.creation.box((1.0, 0.7, 0.4))
    knob = trimesh.creation.box((0.1, 0.1, 0.1))
    knob.apply_translation([0.4, 0.1, 0.2])
    both = trimesh.util.concatenate([body, knob])
    both.apply_translation([0.3, 0.0, 0.0])
    both.export(tmp_path / "sat.stl")

    def mistaken(target: Target) -> list[FoundSymmetry]:
        return [replace(one, mistaken=True) for one in find_symmetries(target)]

    options = DraftOptions(units="m", origin=origin)
    made = draft(tmp_path / "sat.stl", tmp_path / "sat.yaml", options, cache=cache, symmetries=mistaken)
    about_z = [one for one in made.target.symmetries if abs(one.axis[2]) > 0.99]
    assert [(one.order, one.exact) for one in about_z] == ([(2, False)] if origin == "auto" else [])
    assert any("are not written" in text for text in made.told) == (origin == "file")


def test_the_origin_is_moved_to_where_the_axes_of_symmetry_meet(tmp_path: Path, cache: Path) -> None:
    body = obj_box(sides=(1.0, 1.0, 2.0), at=(0.1, 0.2, 0.3), first=1, use="grey")
    (tmp_path / "sat.obj").write_text(body)
    for origin, orders in (("auto", [2, 2, 4]), ("file", [])):
        options = DraftOptions(units="m", mass_kg=5.0, origin=origin)
        made = draft(tmp_path / "sat.obj", tmp_path / f"{origin}.yaml", options, cache=cache)
        through = sorted(one.order for one in made.target.symmetries if 1.0 in np.abs(one.axis))
        assert through == orders
        assert any("are not written" in text for text in made.told) == (origin == "file")
        for reason in ("the origin is the centre of area", "--origin file keeps the origin"):
            assert any(reason in text for text in made.told) == (origin == "auto")


def test_a_turn_about_nearly_the_axis_of_an_exact_one_is_no_symmetry_of_its_own(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = trimesh.creation.icosphere(3)
    body.vertices = body.vertices * [1.0, 0.8, 0.65]
    body.export(tmp_path / "body.stl")
    target = draft(tmp_path / "body.stl", tmp_path / "body.yaml", DraftOptions(units="m"), cache=cache).target
    beside = np.array([np.cos(0.045), np.sin(0.045), 0.0])  # 2.6 deg, as of a moment's axis
    monkeypatch.setattr(symmetry, "_candidates", lambda _: iter((np.eye(3)[0], beside)))
    (found,) = find_symmetries(target)
    assert found.exact
    assert found.axis == (1.0, 0.0, 0.0)


def test_what_is_left_over_far_away_is_told_and_does_not_count_for_the_assumed_mass(
    tmp_path: Path, cache: Path
) -> None:
    left_over = trimesh.Trimesh([[30, 0, 0], [30.04, 0, 0], [30, 0.04, 0]], [[0, 1, 2]])
    trimesh.util.concatenate([trimesh.creation.box((2.0, 1.0, 1.0)), left_over]).export(tmp_path / "sat.stl")
    made = draft(tmp_path / "sat.stl", tmp_path / "sat.yaml", DraftOptions(units="m"), cache=cache)
    assert any("within 2 x 1 x 1 m, but the whole file is 31" in text for text in made.told)
    assert "no mass is given: 100 kg are assumed (--mass-kg)" in made.told


@pytest.mark.parametrize(("away", "told"), [(3e5, "steps of 0.031 m there"), (300.0, "")])
def test_coordinates_that_are_coarse_since_the_body_is_far_away_are_told(
    tmp_path: Path, cache: Path, away: float, told: str
) -> None:
    body = trimesh.creation.box((2.0, 1.0, 1.0)).apply_translation((away, 0.2, 0.3))
    body.export(tmp_path / "sat.stl")
    made = draft(
        tmp_path / "sat.stl",
        tmp_path / "sat.yaml",
        DraftOptions(units="m", mass_kg=5.0),
        cache=cache,
        symmetries=lambda _: [],
    )
    coarse = [text for text in made.told if "numbers of 32 bits" in text]
    assert len(coarse) == bool(told)
    assert all(told in text for text in coarse)


def test_a_turn_that_some_sides_do_not_tell_is_written_with_the_remedy(cad: Path, cache: Path) -> None:
    seen = Likeness("lidar", "30 returns", 46.7, 4, 1, 5.0)
    around = FoundSymmetry(
        (0.0, 0.0, 1.0), 12, False, 0.9, 0.0, (0.0, 0.0, 0.0), True, likeness=(seen,), mistaken=True
    )
    made = draft(
        cad, cad.with_suffix(".yaml"), DraftOptions(units="m"), cache=cache, symmetries=lambda _: [around]
    )
    assert "# any turn: lidar mistakes it at 46.7 m from some sides" in made.file.read_text()
    assert any("write exact: true to this symmetry" in text for text in made.told)


def test_a_cube_has_all_its_thirteen_axes(tmp_path: Path, cache: Path) -> None:
    cube = obj_box(sides=(1.0, 1.0, 1.0), at=(0.0, 0.0, 0.0), first=1, use="grey")
    (tmp_path / "cube.obj").write_text(cube)
    made = draft(tmp_path / "cube.obj", tmp_path / "cube.yaml", DraftOptions(units="m"), cache=cache)
    assert sorted(one.order for one in made.target.symmetries) == [2] * 6 + [3] * 4 + [4] * 3
    assert len(made.target.turns(exact=True)) == 23


def test_a_file_that_another_text_replaces_is_kept_beside_it(cad: Path, cache: Path) -> None:
    out = cad.with_suffix(".yaml")
    first = draft(cad, out, DraftOptions(units="m", mass_kg=50.0), cache=cache)
    again = draft(cad, out, DraftOptions(units="m", mass_kg=50.0), cache=cache)
    assert not any("kept as" in text for text in (*first.told, *again.told))
    by_hand = out.read_text() + "# corrected by hand\n"
    out.write_text(by_hand)
    made = draft(cad, out, DraftOptions(units="m", mass_kg=50.0), cache=cache)
    assert any("sat.yaml.bak" in text for text in made.told)
    assert out.with_name("sat.yaml.bak").read_text() == by_hand
