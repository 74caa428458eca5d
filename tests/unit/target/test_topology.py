"""Creases, closedness and separate surfaces."""

import numpy as np
import pytest

from rpod_target.build.surfaces import (
    FACETS,
    box_surface,
    cylinder_surface,
    frustum_surface,
    prism_surface,
)
from rpod_target.mesh.topology import creases, edges, open_edges, separate_surfaces
from rpod_target.parameters import BoxParameters, CylinderParameters, FrustumParameters, PrismParameters

ANGLE_RAD = np.deg2rad(30.0)
BOX_M = box_surface(
    BoxParameters(name="part", material="paint", shape="box", size_m=(2.0, 1.0, 0.5))
).triangles_m


def test_a_box_has_twelve_edges_between_faces_at_right_angles() -> None:
    segments_m, normals = creases(BOX_M, angle_rad=ANGLE_RAD)
    assert len(segments_m) == 12
    lengths_m = np.sort(np.linalg.norm(segments_m[:, 1] - segments_m[:, 0], axis=1))
    np.testing.assert_allclose(lengths_m, [0.5] * 4 + [1.0] * 4 + [2.0] * 4)
    np.testing.assert_allclose(np.einsum("ij,ij->i", normals[:, 0], normals[:, 1]), 0.0, atol=1e-12)
    directions = segments_m[:, 1] - segments_m[:, 0]
    np.testing.assert_allclose(np.einsum("ij,ikj->ik", directions, normals), 0.0, atol=1e-12)


def test_a_hexagonal_prism_has_eighteen_edges() -> None:
    part = PrismParameters(
        name="part", material="paint", shape="prism", sides=6, circumradius_m=0.5, length_m=0.8
    )
    segments_m, _ = creases(prism_surface(part).triangles_m, angle_rad=ANGLE_RAD)
    assert len(segments_m) == 18


def test_the_wireframe_of_a_cylinder_is_its_two_rims() -> None:
    part = CylinderParameters(name="part", material="paint", shape="cylinder", radius_m=0.3, length_m=0.8)
    segments_m, _ = creases(cylinder_surface(part).triangles_m, angle_rad=ANGLE_RAD)
    assert len(segments_m) == 2 * FACETS
    np.testing.assert_allclose(np.linalg.norm(segments_m[:, :, 1:], axis=2), 0.3)
    assert np.ptp(segments_m[:, :, 0], axis=1).max() == 0.0


def test_a_pointed_cone_has_its_base_rim_only() -> None:
    part = FrustumParameters(
        name="part", material="paint", shape="frustum", base_radius_m=0.3, top_radius_m=0.0, length_m=0.8
    )
    segments_m, _ = creases(frustum_surface(part).triangles_m, angle_rad=ANGLE_RAD)
    assert len(segments_m) == FACETS
    assert np.abs(segments_m[:, :, 0]).max() == 0.0


def test_a_missing_triangle_leaves_three_open_edges() -> None:
    assert open_edges(BOX_M) == 0
    assert open_edges(BOX_M[1:]) == 3


def test_a_triangle_turned_over_is_an_open_surface() -> None:
    turned = BOX_M.copy()
    turned[0] = turned[0, ::-1]
    assert open_edges(turned) > 0


def test_an_open_boundary_is_an_edge_with_its_face_on_both_sides() -> None:
    segments_m, normals = creases(BOX_M[:1], angle_rad=ANGLE_RAD)
    assert len(segments_m) == 3
    np.testing.assert_array_equal(normals[:, 1], -normals[:, 0])


def test_corners_weld_wherever_the_surface_stands() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        noise = rng.normal(scale=1e-12, size=BOX_M.shape)
        assert open_edges(BOX_M + rng.uniform(-50.0, 50.0, 3) + noise) == 0


@pytest.mark.parametrize("count", [1, 2, 5])
def test_surfaces_that_share_no_corner_are_separated(count: int) -> None:
    heap = np.concatenate([BOX_M + np.array([0.7, 0.1, 0.0]) * number for number in range(count)])
    surfaces = separate_surfaces(heap)
    assert [len(surface) for surface in surfaces] == [12] * count
    assert [open_edges(surface) for surface in surfaces] == [0] * count


def test_a_part_without_triangles_has_no_edges() -> None:
    segments_m, faces = edges(np.zeros((0, 3, 3)))
    assert segments_m.shape == (0, 2, 3)
    assert faces.shape == (0, 2)
