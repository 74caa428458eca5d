"""The edges at which a target's surface may end for a sensor, and the ways of casting rays at it."""

import numpy as np
import pytest

from rpod_geometry.rays import Hits, RayGrid, cast_pose
from rpod_pose.registration.surface_model import MANY, Faces, cast_faces, outline_edges
from rpod_target import load_target
from rpod_target.mesh.topology import unit_normals

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
TETRAHEDRON = CORNERS[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]


def edges(triangles_m):
    return outline_edges(triangles_m, unit_normals(triangles_m))


def test_a_convex_body_may_end_at_each_edge_and_a_hollow_one_at_none():
    assert len(edges(TETRAHEDRON).faces) == 6
    assert len(edges(TETRAHEDRON[:, ::-1].copy()).faces) == 0


def test_a_border_has_its_face_twice_and_runs_counter_clockwise_about_it():
    found = edges(TETRAHEDRON[:3].copy())
    border = found.faces[:, 0] == found.faces[:, 1]
    assert border.sum() == 3
    for (start, end), (face, _) in zip(found.ends_m[border], found.faces[border], strict=True):
        middle = TETRAHEDRON[face].mean(axis=0)
        assert np.cross(end - start, middle - start) @ unit_normals(TETRAHEDRON)[face] > 0.0


def test_a_surface_does_not_end_within_a_plane():
    square = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    found = edges(square)
    assert len(found.faces) == 4
    assert not (np.abs(found.ends_m[:, 1] - found.ends_m[:, 0]).sum(axis=1) > 1.5).any()


def test_where_more_than_two_faces_meet_each_has_a_border():
    found = edges(np.concatenate([TETRAHEDRON, TETRAHEDRON * np.array([1.0, -1.0, 1.0])[:, None].T]))
    shared = (np.abs(found.ends_m[:, :, 1]) < 1e-9).all(axis=1)
    assert (found.faces[shared, 0] == found.faces[shared, 1]).all()


@pytest.mark.parametrize("rays", [8, 40, 200], ids=["few", "some", "more than triangles"])
def test_each_way_of_casting_finds_the_same_hits(rays):
    """`envisat-detailed` has more than ``MANY`` triangles; few rays use the tree, many the shared corners."""
    faces = Faces.of(load_target("envisat-detailed"))
    assert len(faces.triangles_m) > MANY
    angles_rad = np.radians(np.linspace(-8.0, 8.0, rays))
    grid, R, t = RayGrid.azimuth_elevation(angles_rad, angles_rad), np.eye(3), np.array([1.0, 0.5, 60.0])
    one, other = Hits.of(grid), Hits.of(grid)
    cast_pose(grid.arrays, faces.triangles_m, R, t, True, *one.arrays)
    cast_faces(grid.arrays, faces, R, t, other.arrays)
    np.testing.assert_array_equal(one.triangle, other.triangle)
    np.testing.assert_allclose(one.range_m, other.range_m, rtol=1e-6)
    assert (one.triangle >= 0).any()
