"""The analytic parts: closed, facing outwards, of the right size."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rpod_target.build.surfaces import (
    FACETS,
    Surface,
    box_surface,
    cylinder_surface,
    frustum_surface,
    prism_surface,
)
from rpod_target.mesh.topology import open_edges, unit_normals, volume_m3
from rpod_target.parameters import BoxParameters, CylinderParameters, FrustumParameters, PrismParameters

LENGTH_M = st.floats(0.01, 20.0)


def polygon_area_m2(sides: int, circumradius_m: float) -> float:
    return float(0.5 * sides * circumradius_m**2 * np.sin(2.0 * np.pi / sides))


def assert_encloses(surface: Surface, volume: float) -> None:
    assert open_edges(surface.triangles_m) == 0
    assert volume_m3(surface.triangles_m) == pytest.approx(volume, rel=1e-9)
    assert len(surface.materials) == len(surface.triangles_m)


@given(LENGTH_M, LENGTH_M, LENGTH_M)
def test_a_box_is_closed_and_encloses_its_volume(x: float, y: float, z: float) -> None:
    part = BoxParameters(name="part", material="paint", shape="box", size_m=(x, y, z))
    assert_encloses(box_surface(part), x * y * z)


@given(st.integers(3, 12), LENGTH_M, LENGTH_M)
def test_a_prism_is_closed_and_encloses_its_volume(sides: int, radius: float, length: float) -> None:
    part = PrismParameters(
        name="part", material="paint", shape="prism", sides=sides, circumradius_m=radius, length_m=length
    )
    assert_encloses(prism_surface(part), polygon_area_m2(sides, radius) * length)


@given(LENGTH_M, st.one_of(st.just(0.0), LENGTH_M), LENGTH_M)
def test_a_frustum_is_closed_and_encloses_its_volume(base: float, top: float, length: float) -> None:
    part = FrustumParameters(
        name="part", material="paint", shape="frustum", base_radius_m=base, top_radius_m=top, length_m=length
    )
    volume = polygon_area_m2(FACETS, 1.0) * length / 3.0 * (base**2 + base * top + top**2)
    assert_encloses(frustum_surface(part), volume)


@given(LENGTH_M, LENGTH_M)
def test_a_cylinder_is_closed_and_encloses_its_volume(radius: float, length: float) -> None:
    part = CylinderParameters(
        name="part", material="paint", shape="cylinder", radius_m=radius, length_m=length
    )
    assert_encloses(cylinder_surface(part), polygon_area_m2(FACETS, radius) * length)


def test_every_normal_of_a_convex_part_points_away_from_its_middle() -> None:
    part = PrismParameters(
        name="part", material="paint", shape="prism", sides=6, circumradius_m=0.5, length_m=0.8
    )
    triangles_m = prism_surface(part).triangles_m
    outwards = triangles_m.mean(axis=1) - [0.4, 0.0, 0.0]
    assert (np.einsum("ij,ij->i", unit_normals(triangles_m), outwards) > 0.0).all()


def test_a_prism_takes_its_materials_sector_by_sector() -> None:
    part = PrismParameters(
        name="part",
        material="paint",
        shape="prism",
        sides=6,
        circumradius_m=1.0,
        length_m=2.0,
        top_materials=("gold", "silver"),
        side_materials=("foil",),
    )
    surface = prism_surface(part)
    materials = np.array(surface.materials)
    x = surface.triangles_m[:, :, 0]
    assert set(materials[(x == 0.0).all(axis=1)]) == {"paint"}
    assert set(materials[np.ptp(x, axis=1) > 0.0]) == {"foil"}
    top = (x == 2.0).all(axis=1)
    middle = surface.triangles_m[top].mean(axis=1)
    sector = np.floor(np.mod(np.arctan2(middle[:, 2], middle[:, 1]), 2.0 * np.pi) / (np.pi / 3.0))
    assert materials[top].tolist() == [("gold", "silver")[int(number) % 2] for number in sector]
