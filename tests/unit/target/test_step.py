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

from pathlib import Path

import numpy as np
import pytest

from rpod_target.drafting.draft import DraftOptions, draft
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
    assert made.told == ("the format is in metres",)
    assert [material.looks for material in made.target.materials] == ["mirror", "grey", "dark"]
    assert made.target.require_field().values.min() < -0.2


def test_a_damaged_file_is_told() -> None:
    with pytest.raises(ValueError, match="cannot be read as STEP"):
        read_mesh_file("broken.step", FILE.read_bytes()[:20000], {})
