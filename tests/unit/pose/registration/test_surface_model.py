"""The edges at which a target's surface may end for a sensor."""

import numpy as np

from rpod_pose.registration.surface_model import outline_edges
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
