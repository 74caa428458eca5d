from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rpod_geometry.wireframe import project, visible_pieces
from rpod_schemas.types import Camera

CAMERA = Camera(width=200, height=160, fx=150.0, fy=150.0, cx=99.5, cy=79.5)


def square(z, half):
    a, b, c, d = ((-half, -half, z), (-half, half, z), (half, half, z), (half, -half, z))
    triangles = np.array([[a, b, c], [a, c, d]])
    edges = np.array([[a, b], [b, c], [c, d], [d, a]])
    return triangles, edges


def squares(*of):
    """Squares facing the sensor at depths z with half sides, as a target."""
    parts = [square(z, half) for z, half in of]
    edges = np.concatenate([part[1] for part in parts])
    return SimpleNamespace(
        triangles_m=np.concatenate([part[0] for part in parts]),
        edges_m=edges,
        edge_normals=np.tile((0.0, 0.0, -1.0), (len(edges), 2, 1)),
    )


def length(pieces):
    return np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).sum()


def test_a_square_in_front_is_seen_whole():
    assert length(visible_pieces(squares((4.0, 0.5)), RigidTransform.identity())) == pytest.approx(4.0)


def test_an_edge_between_faces_that_look_away_is_not_seen():
    target = squares((4.0, 0.5))
    target.edge_normals = -target.edge_normals
    assert len(visible_pieces(target, RigidTransform.identity())) == 0


def test_what_stands_behind_a_surface_is_not_seen():
    pieces = visible_pieces(squares((4.0, 0.5), (6.0, 0.4)), RigidTransform.identity())
    np.testing.assert_allclose(pieces[..., 2], 4.0)


def test_what_looks_out_from_behind_is_seen_in_part():
    target = squares((4.0, 0.5), (5.0, 0.5))
    shifted = target.edges_m.copy()
    shifted[4:, :, 0] += 0.6
    target.edges_m = shifted
    behind = visible_pieces(target, RigidTransform.identity())
    behind = behind[behind[..., 2].mean(axis=1) > 4.5]
    assert 0.5 < length(behind) < 3.5
    assert behind[..., 0].max() > 0.625


def test_what_reaches_behind_the_sensor_is_left_out():
    target = squares((4.0, 0.5))
    assert len(visible_pieces(target, RigidTransform.from_translation([0.0, 0.0, -4.0]))) == 0


def test_projection_is_the_cameras_and_follows_its_distortion():
    point = np.array([[[0.3, -0.2, 2.0], [0.0, 0.0, 1.0]]])
    np.testing.assert_allclose(project(point, CAMERA), [[[122.0, 64.5], [99.5, 79.5]]], atol=1e-6)
    bent = CAMERA.model_copy(update={"distortion": np.array([-0.3, 0.0, 0.0, 0.0, 0.0])})
    assert project(point, bent)[0, 0, 0] < 122.0
    np.testing.assert_allclose(project(point, None), [[[150.0, -100.0], [0.0, 0.0]]])
