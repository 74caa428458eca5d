"""The targets that ship."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import rpod_target
from rpod_schemas.config.base import load
from rpod_target import Target, load_target, shipped_targets
from rpod_target.mesh.topology import open_edges, volume_m3
from rpod_target.parameters import TargetParameters

PACKAGE = Path(rpod_target.__file__).parent


@pytest.fixture(scope="session")
def shipped(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Target]:
    """Every shipped target, on a distance field of ten times the spacing: building is quick then."""
    folder = tmp_path_factory.mktemp("shipped")
    for meshes in ("envisat_mesh", "meshes"):
        (folder / meshes).symlink_to(PACKAGE / "targets" / meshes)
    targets = {}
    for name in shipped_targets():
        text = (PACKAGE / "targets" / f"{name}.yaml").read_text()
        coarse, changes = re.subn(r"spacing_m: ([\d.]+)", lambda found: f"spacing_m: {found[1]}e1", text)
        assert changes == 1
        (folder / f"{name}.yaml").write_text(coarse)
        targets[name] = load_target(folder / f"{name}.yaml", cache=cache)
    return targets


def extent_m(target: Target, *parts: str) -> tuple[list[float], list[float]]:
    chosen = np.isin(target.triangle_part, [target.parts.index(part) for part in parts or target.parts])
    corners_m = target.triangles_m[chosen]
    return corners_m.min(axis=(0, 1)).tolist(), corners_m.max(axis=(0, 1)).tolist()


def test_these_ship() -> None:
    assert shipped_targets() == (
        "envisat-bulky",
        "envisat-detailed",
        "envisat-mesh",
        "envisat-slim",
        "hexagonal-body",
        "mockup",
        "rocket-stage",
        "telecom-satellite",
        "upper-stage",
    )


@pytest.mark.parametrize("name", shipped_targets())
def test_a_shipped_target_is_closed_and_complete(name: str, shipped: dict[str, Target]) -> None:
    target = shipped[name]
    assert target.name == name
    for part in range(len(target.parts)):
        triangles_m = target.triangles_m[target.triangle_part == part]
        assert open_edges(triangles_m) == 0
        assert volume_m3(triangles_m) > 0.0
    assert target.require_field().values.min() < 0.0
    assert len(target.model_points_m) == pytest.approx(1200, rel=0.01)
    assert np.linalg.norm(target.triangles_m, axis=2).max() == pytest.approx(target.radius_m)
    np.testing.assert_allclose(np.linalg.norm(target.model_normals, axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(target.edge_normals, axis=2), 1.0)


def test_a_shipped_target_loads_by_name(cache: Path, shipped: dict[str, Target]) -> None:
    target = load_target("envisat-slim", cache=cache)
    np.testing.assert_array_equal(target.triangles_m, shipped["envisat-slim"].triangles_m)
    assert target.require_field().spacing_m == 0.1


def test_the_mockup_is_that_of_the_study(shipped: dict[str, Target]) -> None:
    mockup = shipped["mockup"]
    assert len(mockup.triangles_m) == 560
    np.testing.assert_allclose(extent_m(mockup, "body"), [[-0.8, -0.5, -0.4330127], [0.0, 0.5, 0.4330127]])
    np.testing.assert_allclose(extent_m(mockup, "nose"), [[0.25, -0.1, -0.1], [0.4, 0.1, 0.1]])
    np.testing.assert_allclose(extent_m(mockup, "box"), [[0.0, 0.3, -0.09], [0.1, 0.4, 0.09]])


def test_the_wireframe_of_the_mockup_holds_the_circle_of_its_nose(shipped: dict[str, Target]) -> None:
    edges_m = shipped["mockup"].edges_m
    circle = edges_m[np.isclose(edges_m[:, :, 0], 0.4).all(axis=1)]
    assert len(circle) == 32
    np.testing.assert_allclose(np.linalg.norm(circle[:, :, 1:], axis=2), 0.1)
    np.testing.assert_allclose(circle.mean(axis=(0, 1)), [0.4, 0.0, 0.0], atol=1e-12)


def test_the_front_of_the_mockup_tells_its_sectors_apart(shipped: dict[str, Target]) -> None:
    mockup = shipped["mockup"]
    front = (mockup.triangle_part == 0) & (mockup.normals[:, 0] > 0.99)
    names = [mockup.materials[index].name for index in mockup.triangle_material[front]]
    assert names == ["panel", "gold-mli", "silver-mli"] * 2


def test_no_turn_by_sixty_degrees_maps_the_mockup_onto_itself(shipped: dict[str, Target]) -> None:
    points_m = shipped["mockup"].model_points_m
    surface = cKDTree(points_m)
    for turn in range(1, 6):
        turned_m = Rotation.from_euler("x", 60.0 * turn, degrees=True).apply(points_m)
        assert np.max(surface.query(turned_m)[0]) > 0.15


def planes(target: Target, turn: Rotation) -> dict[tuple[float, ...], float]:
    """Return the area of the surface, turned, in each plane (unit normal, distance) and of each material."""
    corners_m = turn.apply(target.triangles_m.reshape(-1, 3)).reshape(-1, 3, 3)
    products = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    areas_m2 = np.linalg.norm(products, axis=1) / 2.0
    normals = turn.apply(target.normals)
    distances_m = (normals * corners_m[:, 0]).sum(axis=1)
    keys = np.round(np.column_stack([normals, distances_m, target.triangle_material]), 6) + 0.0
    found: dict[tuple[float, ...], float] = {}
    for key, area_m2 in zip(keys.tolist(), areas_m2.tolist(), strict=True):
        found[tuple(key)] = found.get(tuple(key), 0.0) + area_m2
    return found


def corners(target: Target, turn: Rotation) -> set[tuple[float, ...]]:
    turned_m = np.round(turn.apply(target.triangles_m.reshape(-1, 3)), 6) + 0.0
    return {tuple(corner) for corner in turned_m.tolist()}


def maps_onto_itself(target: Target, turn: Rotation) -> bool:
    still = Rotation.identity()
    same = planes(target, turn) == pytest.approx(planes(target, still))
    return same and corners(target, turn) == corners(target, still)


def turns(target: Target) -> list[Rotation]:
    return [
        Rotation.from_rotvec(2.0 * np.pi * step / symmetry.order * np.array(symmetry.axis))
        for symmetry in target.symmetries
        if symmetry.exact
        for step in range(1, symmetry.order)
    ]


@pytest.mark.parametrize(("name", "count"), [("hexagonal-body", 11), ("rocket-stage", 7)])
def test_every_exact_symmetry_maps_the_target_onto_itself(
    name: str, count: int, shipped: dict[str, Target]
) -> None:
    target = shipped[name]
    assert len(turns(target)) == count
    assert all(maps_onto_itself(target, turn) for turn in turns(target))


@pytest.mark.parametrize("name", ["hexagonal-body", "rocket-stage"])
def test_exact_symmetries_are_all_there_are_and_make_a_group(name: str, shipped: dict[str, Target]) -> None:
    target = shipped[name]
    declared = [Rotation.identity(), *turns(target)]
    for one in declared:
        for other in declared:
            assert min((one * other * turn.inv()).magnitude() for turn in declared) < 1e-9
    flips = [
        Rotation.from_rotvec(np.pi * np.array([0.0, np.cos(a), np.sin(a)]))
        for a in np.pi / 48 * np.arange(48)
    ]
    about = [Rotation.from_euler("x", 7.5 * step, degrees=True) for step in range(1, 48)]
    for turn in [*flips, *about]:
        known = min((turn * known.inv()).magnitude() for known in declared) < 1e-9
        assert maps_onto_itself(target, turn) == known


@pytest.mark.parametrize("name", ["mockup", "envisat-slim", "envisat-bulky", "envisat-mesh"])
def test_targets_with_details_have_no_exact_symmetry(name: str, shipped: dict[str, Target]) -> None:
    assert shipped[name].symmetries
    assert not turns(shipped[name])


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("envisat-slim", (-21.0, -5.0, -1.9), (5.0, 5.0, 1.0)),
        ("envisat-bulky", (-21.0, -5.0, -2.9), (5.0, 5.0, 2.0)),
    ],
)
def test_envisat_is_26_m_long_and_10_m_wide(
    shipped: dict[str, Target], name: str, low: tuple[float, ...], high: tuple[float, ...]
) -> None:
    np.testing.assert_allclose(extent_m(shipped[name]), [low, high])
    reflectivity = {material.name: material.reflectivity for material in shipped[name].materials}
    assert reflectivity == {"steel": 0.733, "solar-cells": 0.175, "aluminium": 0.969}


def test_the_mesh_stands_like_the_cuboids(shipped: dict[str, Target]) -> None:
    mesh = shipped["envisat-mesh"]
    low_m, high_m = np.array(extent_m(mesh))
    assert len(mesh.triangles_m) == 842
    assert (high_m - low_m).max() == pytest.approx(26.0)
    assert low_m[0] == pytest.approx(-19.376, abs=1e-3)  # the array
    corners_m = mesh.triangles_m.reshape(-1, 3)
    antenna = corners_m[np.abs(corners_m[:, 1]) > 4.0]
    assert antenna[:, 2].max() < 0.0
    assert np.ptp(antenna[:, 1]) == pytest.approx(9.066, abs=2e-3)


@pytest.mark.parametrize("name", ["envisat-slim", "envisat-bulky", "envisat-mesh", "envisat-detailed"])
def test_envisat_turns_most_easily_about_its_long_axis(name: str, shipped: dict[str, Target]) -> None:
    moments = np.diag(shipped[name].inertia_kg_m2)
    assert np.argmin(moments) == np.argmax(np.ptp(shipped[name].triangles_m, axis=(0, 1)))


@pytest.mark.parametrize("name", shipped_targets())
def test_the_parameters_survive_being_written_and_read(name: str) -> None:
    parameters = load(TargetParameters, PACKAGE / "targets" / f"{name}.yaml")
    again = TargetParameters.model_validate(parameters.model_dump(mode="json"))
    assert again.model_dump(mode="json") == parameters.model_dump(mode="json")


@pytest.mark.parametrize("name", shipped_targets())
def test_the_turns_are_those_of_the_symmetries_without_the_identity(
    name: str, shipped: dict[str, Target]
) -> None:
    target = shipped[name]
    every, exact = target.turns(), target.turns(exact=True)
    assert len(every) == sum(symmetry.order - 1 for symmetry in target.symmetries)
    assert len(exact) == len(turns(target))
    for expected in turns(target):
        assert min((turn.rotation * expected.inv()).magnitude() for turn in exact) < 1e-9
    for turn in every:
        np.testing.assert_array_equal(turn.translation, np.zeros(3))
        assert turn.rotation.magnitude() > 0.1


def test_the_near_symmetries_of_the_cuboids_are_half_turns(shipped: dict[str, Target]) -> None:
    target = shipped["envisat-bulky"]
    assert target.turns(exact=True) == []
    axes = [turn.rotation.as_rotvec() / np.pi for turn in target.turns()]
    np.testing.assert_allclose(np.abs(axes), np.eye(3), atol=1e-12)
    assert not any(maps_onto_itself(target, turn.rotation) for turn in target.turns())
