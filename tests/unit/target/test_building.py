"""What is built of the parts: distance field, model points and wireframe."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rpod_schemas.arrays import FloatArray
from rpod_target import DistanceField, Target

Build = Callable[..., Target]
HALF_M = np.array([1.0, 0.5, 0.25])


def box(*size_m: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0), **more: Any) -> dict[str, Any]:
    return {"shape": "box", "size_m": list(size_m), "T_target_part": {"translation_m": list(at)}, **more}


def box_distance_m(points_m: FloatArray, half_m: FloatArray) -> FloatArray:
    """Return the exact signed distance to a box about the origin."""
    beyond = np.abs(points_m) - half_m
    distance_m: FloatArray = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) + np.minimum(
        beyond.max(axis=-1), 0.0
    )
    return distance_m


def nodes_m(field: DistanceField) -> FloatArray:
    index = np.moveaxis(np.indices(field.values.shape), 0, -1)
    return np.asarray(field.origin_m + field.spacing_m * index)


def test_the_field_of_a_box_is_its_exact_distance(build: Build) -> None:
    field = build().require_field()
    expected = box_distance_m(nodes_m(field), HALF_M)
    np.testing.assert_allclose(field.values, expected, atol=1e-5)
    assert field.values.dtype == np.float32


def test_the_field_follows_a_part_that_is_turned_and_moved(build: Build) -> None:
    pose = {"translation_m": [0.3, -0.2, 0.1], "euler_321_deg": [90.0, 0.0, 0.0]}
    field = build({"shape": "box", "size_m": [2.0, 1.0, 0.5], "T_target_part": pose}).require_field()
    expected = box_distance_m(nodes_m(field) - [0.3, -0.2, 0.1], HALF_M[[1, 0, 2]])
    np.testing.assert_allclose(field.values, expected, atol=1e-5)


def test_the_grid_reaches_the_margin_beyond_the_parts(build: Build) -> None:
    field = build().require_field()
    last_m = nodes_m(field)[-1, -1, -1]
    np.testing.assert_allclose(field.origin_m, -HALF_M - 0.3)
    assert (last_m >= HALF_M + 0.3 - 1e-9).all()
    assert (last_m < HALF_M + 0.3 + 0.1 + 1e-9).all()


def test_the_field_of_overlapping_parts_is_the_minimum_of_theirs(build: Build) -> None:
    field = build(box(1.0, 1.0, 1.0), box(0.6, 0.6, 2.0, at=(0.3, 0.0, 0.0))).require_field()
    first = box_distance_m(nodes_m(field), np.full(3, 0.5))
    second = box_distance_m(nodes_m(field) - [0.3, 0.0, 0.0], np.array([0.3, 0.3, 1.0]))
    np.testing.assert_allclose(field.values, np.minimum(first, second), atol=1e-5)


def test_overlapping_surfaces_of_one_mesh_are_bodies_of_their_own(
    build: Build, write_stl: Callable[[str, Any], Any]
) -> None:
    grid = {
        "spacing_m": 0.1,
        "margin_m": 0.33,
    }  # no whole number of nodes, which the file's rounding could tip
    two = build(box(1.0, 1.0, 1.0), box(0.6, 0.6, 2.0, at=(0.3, 0.0, 0.0)), distance_field=grid)
    write_stl("two.stl", two.triangles_m)
    mesh = build({"shape": "mesh", "file": "two.stl", "metres_per_unit": 1.0}, distance_field=grid)
    np.testing.assert_allclose(mesh.require_field().values, two.require_field().values, atol=1e-5)
    assert len(mesh.edges_m) == len(two.edges_m)


def test_triangles_and_normals_face_outwards(build: Build) -> None:
    target = build()
    middle_m = target.triangles_m.mean(axis=1)
    assert (np.einsum("ij,ij->i", target.normals, middle_m) > 0.0).all()
    spanned = np.cross(
        target.triangles_m[:, 1] - target.triangles_m[:, 0],
        target.triangles_m[:, 2] - target.triangles_m[:, 0],
    )
    np.testing.assert_allclose(
        target.normals, spanned / np.linalg.norm(spanned, axis=1, keepdims=True), atol=1e-12
    )
    assert target.radius_m == pytest.approx(np.linalg.norm(HALF_M))


def test_model_points_lie_on_the_surface_with_its_normals(build: Build) -> None:
    target = build()
    np.testing.assert_allclose(box_distance_m(target.model_points_m, HALF_M), 0.0, atol=1e-9)
    out_m = target.model_points_m + 1e-3 * target.model_normals
    np.testing.assert_allclose(box_distance_m(out_m, HALF_M), 1e-3, rtol=1e-6)


def test_model_points_stand_for_equal_areas(build: Build) -> None:
    target = build(model_points=700)
    assert len(target.model_points_m) == pytest.approx(700, rel=0.02)
    for axis, area_m2 in enumerate((0.5, 1.0, 2.0)):
        for sign in (-1.0, 1.0):
            on_face = sign * target.model_normals[:, axis] > 0.5
            assert on_face.sum() == pytest.approx(100 * area_m2, rel=0.12)


def test_model_points_of_a_face_keep_their_distance(build: Build) -> None:
    target = build(model_points=700)
    points = np.hstack([target.model_points_m, target.model_normals])  # other faces are far away
    nearest_m = np.asarray(cKDTree(points).query(points, k=2)[0])[:, 1]
    pitch_m = np.sqrt(7.0 / 700)
    assert np.median(nearest_m) > 0.75 * pitch_m
    assert nearest_m.min() > 0.3 * pitch_m


def test_both_faces_of_a_thin_panel_have_model_points(build: Build) -> None:
    normals = build(box(4.0, 2.0, 0.002), model_points=400).model_normals
    up, down = (normals[:, 2] > 0.5).sum(), (normals[:, 2] < -0.5).sum()
    assert up == pytest.approx(200, rel=0.05)
    assert down == pytest.approx(200, rel=0.05)


@pytest.mark.parametrize("overlap_m", [0.0, 0.1])
def test_surface_hidden_in_another_part_has_no_model_points(build: Build, overlap_m: float) -> None:
    """Two unit cubes that touch or overlap: no point on or between the two faces that meet."""
    points_m = build(
        box(1.0, 1.0, 1.0), box(1.0, 1.0, 1.0, at=(1.0 - overlap_m, 0.0, 0.0)), model_points=500
    ).model_points_m
    shell_m = np.abs(points_m[:, 1:]).max(axis=1)
    between = np.abs(points_m[:, 0] - 0.5 + overlap_m / 2.0) <= overlap_m / 2.0 + 1e-6
    np.testing.assert_allclose(shell_m[between], 0.5)
    assert np.abs(points_m[:, 0] - 0.5).min() < 0.1


def test_the_points_of_a_part_inside_another_all_go_to_the_outer_one(build: Build) -> None:
    target = build(box(1.0, 1.0, 1.0), box(0.5, 0.5, 0.5))
    np.testing.assert_allclose(np.abs(target.model_points_m).max(axis=1), 0.5)
    assert len(target.edges_m) == 12


def test_an_edge_buried_in_another_part_is_left_out(build: Build) -> None:
    target = build(box(1.0, 1.0, 1.0), box(0.4, 0.4, 1.0, at=(0.0, 0.0, 0.9)))
    low_m = target.edges_m[:, :, 2].max(axis=1)
    assert len(target.edges_m) == 12 + 12 - 4
    assert not np.isclose(low_m, 0.4).any()


def test_a_rim_that_lies_on_another_part_stays(build: Build) -> None:
    stub = {"shape": "cylinder", "radius_m": 0.2, "length_m": 0.3}
    target = build(box(1.0, 1.0, 1.0), stub | {"T_target_part": {"translation_m": [0.5, 0.0, 0.0]}})
    radius_m = np.linalg.norm(target.edges_m[:, :, 1:], axis=2)
    on_foot = np.isclose(radius_m, 0.2).all(axis=1) & np.isclose(target.edges_m[:, :, 0], 0.5).all(axis=1)
    assert on_foot.sum() == 32


def test_indices_name_each_triangles_part_and_material(build: Build) -> None:
    target = build(box(1.0, 1.0, 1.0), box(1.0, 1.0, 1.0, at=(3.0, 0.0, 0.0), material="foil"))
    assert target.parts == ("part-0", "part-1")
    assert [material.name for material in target.materials] == ["paint", "foil"]
    assert target.materials[1].f0 == 0.8
    far = target.triangles_m[:, :, 0].min(axis=1) > 2.0
    np.testing.assert_array_equal(target.triangle_part, far)
    np.testing.assert_array_equal(target.triangle_material, far)


def test_a_mesh_is_scaled_to_its_longest_side(build: Build, write_stl: Callable[[str, Any], Any]) -> None:
    write_stl("brick.stl", build().triangles_m * 100.0)
    mesh = build({"shape": "mesh", "file": "brick.stl", "longest_side_m": 4.0})
    np.testing.assert_allclose(mesh.triangles_m.max(axis=(0, 1)), 2.0 * HALF_M)
