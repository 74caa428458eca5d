"""A STEP file (AP214, millimetres) of an assembly: a bus, a nozzle, and a sub-assembly of one panel twice.

``satellite.step`` was written with cadquery 2.8, which the project does not need::

    body = cq.Workplane("XY").box(1000.0, 800.0, 600.0)
    nozzle = cq.Workplane("XY").circle(150.0).extrude(200.0)
    panel = cq.Workplane("XY").box(500.0, 1200.0, 20.0)
    wings = cq.Assembly(name="wings")
    wings.add(panel, name="panel", loc=cq.Location((0, 1000.0, 0)), color=cq.Color(0.05, 0.05, 0.4))
    wings.add(panel, name="panel-2", loc=cq.Location((0, -1000.0, 0)), color=cq.Color(0.05, 0.05, 0.4))
    satellite = cq.Assembly(name="satellite")
    satellite.add(body, name="bus", color=cq.Color(0.9, 0.6, 0.1))
    satellite.add(nozzle, name="nozzle", loc=cq.Location((0, 0, 300.0)), color=cq.Color(0.5, 0.5, 0.5))
    satellite.add(wings, loc=cq.Location((0, 0, 100.0)))
    satellite.export("satellite.step")
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rpod_target import TargetError
from rpod_target.drafting.draft import DraftOptions, draft
from rpod_target.mesh import step
from rpod_target.mesh.files import MeshFile, read_mesh_file
from rpod_target.mesh.topology import open_edges, volume_m3

FILE = Path(__file__).with_name("satellite.step")
BOXES_M = {
    "bus": ([-0.5, -0.4, -0.3], [0.5, 0.4, 0.3]),
    "nozzle": ([-0.15, -0.15, 0.3], [0.15, 0.15, 0.5]),
    "panel": ([-0.25, 0.4, 0.09], [0.25, 1.6, 0.11]),
    "panel-2": ([-0.25, -1.6, 0.09], [0.25, -0.4, 0.11]),
}


@pytest.fixture(scope="module")
def mesh() -> MeshFile:
    return read_mesh_file(FILE.name, FILE.read_bytes(), {})


def test_without_the_extra_a_step_file_is_refused_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step, "find_spec", lambda _: None)
    with pytest.raises(ValueError, match=r"is STEP, which needs the extra: pip install 'rpod\[step\]'"):
        read_mesh_file(FILE.name, FILE.read_bytes(), {})


def test_each_part_of_the_assembly_is_an_object_at_its_place_in_metres(mesh: MeshFile) -> None:
    assert mesh.objects == tuple(BOXES_M)
    for number, (name, (low_m, high_m)) in enumerate(BOXES_M.items()):
        corners_m = mesh.triangles[mesh.triangle_object == number].reshape(-1, 3)
        np.testing.assert_allclose(corners_m.min(axis=0), low_m, atol=2e-4, err_msg=name)
        np.testing.assert_allclose(corners_m.max(axis=0), high_m, atol=2e-4, err_msg=name)


def test_each_part_is_closed_and_faces_outwards(mesh: MeshFile) -> None:
    volumes_m3 = []
    for number in range(len(mesh.objects)):
        triangles_m = mesh.triangles[mesh.triangle_object == number]
        assert open_edges(triangles_m) == 0
        volumes_m3.append(volume_m3(triangles_m))
    np.testing.assert_allclose(volumes_m3, [0.48, np.pi * 0.15**2 * 0.2, 0.012, 0.012], rtol=0.01)


def test_the_unit_is_that_of_the_file() -> None:
    in_metres = FILE.read_bytes().replace(b"SI_UNIT(.MILLI.,.METRE.)", b"SI_UNIT($,.METRE.)")
    mesh = read_mesh_file(FILE.name, in_metres, {})
    assert np.ptp(mesh.triangles, axis=(0, 1)) == pytest.approx([1000.0, 3200.0, 800.0], rel=1e-4)


def test_colours_are_those_that_were_chosen(mesh: MeshFile) -> None:
    colours = [mesh.materials[mesh.triangle_material[mesh.triangle_object == n][0]].colour for n in range(4)]
    for found, chosen in zip(
        colours, [(0.9, 0.6, 0.1), (0.5,) * 3, (0.05, 0.05, 0.4), (0.05, 0.05, 0.4)], strict=True
    ):
        assert found == pytest.approx(chosen, abs=0.02)  # eight bits of a linear colour


def test_a_target_is_written_from_it_without_a_question(tmp_path: Path, cache: Path) -> None:
    made = draft(FILE, tmp_path / "satellite.yaml", DraftOptions(density_kg_m3=100.0), cache=cache)
    assert made.target.parts == tuple(BOXES_M)
    assert made.told == ("the unit is the one that the file states",)
    assert [material.looks for material in made.target.materials] == ["mirror", "grey", "dark"]
    assert made.target.require_field().values.min() < -0.2


def test_faces_of_one_part_keep_their_colours() -> None:
    style = re.findall(rb"#\d+ = COLOUR_RGB\('',[^;]*;", FILE.read_bytes())
    assert len(set(style)) >= 3
    mesh = read_mesh_file(FILE.name, _with_a_face_of_another_colour(FILE.read_bytes()), {})
    assert mesh.objects == tuple(BOXES_M)
    bus = mesh.triangle_material[mesh.triangle_object == 0]
    assert [int((bus == number).sum()) for number in np.unique(bus)] in ([2, 10], [10, 2])
    assert any(material.colour == pytest.approx((0.0, 1.0, 0.0), abs=0.02) for material in mesh.materials)


def _with_a_face_of_another_colour(content: bytes) -> bytes:
    """Style the first face of the file, which is one of the bus, in green."""
    (face, *_) = re.findall(rb"(#\d+) = ADVANCED_FACE", content)
    (context,) = re.findall(
        rb"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION\(\s*'',[^;]*?,(#\d+)\);", content
    )[:1]
    styled = (
        b"""#90001 = COLOUR_RGB('',0.,1.,0.);
#90002 = FILL_AREA_STYLE_COLOUR('',#90001);
#90003 = FILL_AREA_STYLE('',(#90002));
#90004 = SURFACE_STYLE_FILL_AREA(#90003);
#90005 = SURFACE_SIDE_STYLE('',(#90004));
#90006 = SURFACE_STYLE_USAGE(.BOTH.,#90005);
#90007 = PRESENTATION_STYLE_ASSIGNMENT((#90006));
#90008 = STYLED_ITEM('color',(#90007),"""
        + face
        + b""");
#90009 = MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',(#90008),"""
        + context
        + b""");
"""
    )
    end = content.rindex(b"ENDSEC;")
    return content[:end] + styled + content[end:]


@pytest.mark.parametrize("units", ["mm", "m", None])
def test_the_unit_that_the_file_states_may_be_given_too(
    tmp_path: Path, cache: Path, units: str | None
) -> None:
    options = DraftOptions(units=units, mass_kg=100.0)
    made = draft(FILE, tmp_path / "satellite.yaml", options, cache=cache)
    assert np.ptp(made.target.triangles_m, axis=(0, 1)).max() == pytest.approx(3.2, rel=1e-4)


def test_another_unit_than_the_stated_one_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TargetError, match=r"states its own unit \(mm\), .* is 3\.2 m; leave --units out"):
        draft(FILE, tmp_path / "satellite.yaml", DraftOptions(units="cm"))


def test_a_size_by_the_stated_unit_that_is_not_usual_is_refused_without_another_unit(tmp_path: Path) -> None:
    large = tmp_path / "large.step"
    large.write_bytes(FILE.read_bytes().replace(b"SI_UNIT(.MILLI.,.METRE.)", b"SI_UNIT($,.METRE.)"))
    reason = (
        r"the unit that the file states makes its longest side 3200 m, .* usual: give --longest-side-m; if"
    )
    with pytest.raises(TargetError, match=reason):
        draft(large, tmp_path / "large.yaml", DraftOptions())


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (FILE.read_bytes()[:20000], r"Line 519: .*unexpected end of file"),
        (FILE.read_bytes().replace(b"CARTESIAN_POINT", b"CARTESIAN_PINT", 3), r"\S"),
    ],
    ids=["cut off", "a name that is wrong"],
)
def test_a_damaged_file_is_told_and_ends_no_process_of_ours(content: bytes, reason: str, capfd: Any) -> None:
    with pytest.raises(ValueError, match=rf"cannot be read as STEP \(.*{reason}.*\): export it again"):
        read_mesh_file("broken.step", content, {})
    assert capfd.readouterr() == ("", "")
