"""Errors of the target's model, considered in a covariance."""

import numpy as np
import pytest

from rpod_pose.pmd.joint.edge_model import EdgeModel
from rpod_pose.registration.model_error import ModelError, Parts
from rpod_target import load_target

PLACES_M = np.array([[0.1, 0.1, 0.0], [0.2, 0.1, 0.0], [1.6, 0.1, 0.0]])
CELLS = np.array([0, 0, 1])
NORMAL = np.array([0.0, 0.0, 1.0])


def rows_of(places_m, normal=NORMAL):
    return np.hstack((np.tile(-normal, (len(places_m), 1)), np.cross(normal, places_m)))


def considered(error, covariance):
    informations = np.array(
        [rows_of(PLACES_M[cell == CELLS]).T @ rows_of(PLACES_M[cell == CELLS]) for cell in (0, 1)]
    )
    centres_m = np.array([PLACES_M[cell == CELLS].mean(axis=0) for cell in (0, 1)])
    return error.considered(covariance, informations, centres_m)


@pytest.fixture(scope="module")
def mockup():
    target = load_target("mockup")
    return target, Parts.of(target)


def test_a_small_part_is_one_cell_wherever_it_lies_and_a_long_one_is_several(mockup):
    target, parts = mockup
    for name, cells in (("nose", 1), ("box", 1), ("thruster-1", 1), ("bracket", 1), ("body", 8)):
        number = target.parts.index(name)
        corners_m = target.triangles_m[target.triangle_part == number].reshape(-1, 3)
        assert len(np.unique(parts.cells(corners_m, np.full(len(corners_m), number)))) == cells


def test_two_parts_share_no_cell_and_no_places_have_none(mockup):
    _, parts = mockup
    together_m = np.tile([[0.05, 0.32, 0.0]], (2, 1))
    assert parts.cells(together_m, np.array([0, 3])).tolist() == [0, 1]
    assert parts.cells(together_m[:0], np.zeros(0, np.intp)).size == 0


def test_places_belong_to_the_nearest_part_and_edges_to_their_own(mockup):
    target, parts = mockup
    beside_m = np.array([[0.41, 0.0, 0.0], [-0.4, 0.0, 0.62], [0.003, 0.0, -0.4]])
    assert [target.parts[part] for part in parts.at(beside_m)] == ["nose", "bracket", "body"]
    edges = EdgeModel.of(target, spacing_m=0.05)
    nose = edges.places_m[edges.parts == target.parts.index("nose")]
    assert len(nose)
    assert nose[:, 0].min() == pytest.approx(0.25)


def test_a_displaced_cell_moves_the_pose_as_least_squares_do():
    error = ModelError(0.01, 0.0)
    rows, weak = rows_of(PLACES_M), 1e-3 * np.eye(6)
    covariance = np.linalg.inv(rows.T @ rows + weak)
    moved = []
    for cell in (0, 1):
        for axis in range(3):
            shift_m = np.where(cell == CELLS, NORMAL[axis] * error.tolerance_m, 0.0)
            moved.append(covariance @ rows.T @ shift_m)
    expected = covariance + sum(np.outer(each, each) for each in moved)
    assert np.allclose(considered(error, covariance), expected)


def test_a_wrong_scale_moves_the_pose_by_the_places_from_the_origin():
    error, covariance = ModelError(0.0, 0.01), np.eye(6)
    assert np.allclose(considered(error, covariance), covariance)  # the plane through the origin stays
    assert error.matters
    assert not ModelError(0.0, 0.0).matters
