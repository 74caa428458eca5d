from functools import cache

import numpy as np
import pytest

from rpod_target import load_target
from rpod_target.outlines import plane_faces

found = cache(lambda name, area_m2=0.0: plane_faces(load_target(name), min_area_m2=area_m2))


def test_the_mock_up_s_largest_faces_are_its_two_hexagons():
    faces, _ = found("mockup")
    for face, x in zip(sorted(faces[:2], key=lambda face: face.normal[0]), (-0.8, 0.0), strict=True):
        assert len(face.corners_m) == 6
        assert np.allclose(face.corners_m[:, 0], x)
        assert np.allclose(np.linalg.norm(face.corners_m[:, 1:], axis=1), 0.5)
        assert face.area_m2 == pytest.approx(1.5 * np.sqrt(3.0) * 0.25)


def test_corners_run_counter_clockwise_seen_from_outside_and_normals_point_outwards():
    faces, discs = found("hexagonal-body")
    assert len(faces) == 8
    assert discs == []
    body_m = load_target("hexagonal-body").triangles_m.reshape(-1, 3).mean(axis=0)
    for face in faces:
        turn = np.cross(face.corners_m[1] - face.corners_m[0], face.corners_m[2] - face.corners_m[1])
        assert turn @ face.normal > 0.0
        assert (face.corners_m.mean(axis=0) - body_m) @ face.normal > 0.3


def test_the_nose_ends_in_the_farthest_disc():
    _, discs = found("mockup")
    nose = max(discs, key=lambda disc: disc.centre_m[0])
    assert np.allclose(nose.centre_m, (0.4, 0.0, 0.0))
    assert np.allclose(nose.normal, (1.0, 0.0, 0.0))
    assert nose.radius_m == pytest.approx(0.1, rel=0.01)


def test_facets_of_cones_and_cylinders_are_no_faces():
    faces, _ = found("mockup")
    assert {len(face.corners_m) for face in faces} == {4, 6}
    assert len(faces) == 2 + 6 + 2 * 6


def test_small_faces_are_left_out():
    faces, discs = found("mockup", 0.3)
    assert len(faces) == 8
    assert discs == []


def test_a_mesh_with_holes_in_its_faces_and_open_edges_is_no_error():
    faces, _ = found("envisat-mesh", 1.0)
    assert faces
    assert all(np.ptp(face.corners_m @ face.normal) < 1e-3 for face in faces)
