"""Errors of the target's model, considered in a covariance."""

import numpy as np

from rpod_pose.registration.model_error import ModelError

PLACES_M = np.array([[0.1, 0.1, 0.0], [0.2, 0.1, 0.0], [1.6, 0.1, 0.0]])
NORMAL = np.array([0.0, 0.0, 1.0])


def rows_of(places_m, normal=NORMAL):
    return np.hstack((np.tile(-normal, (len(places_m), 1)), np.cross(normal, places_m)))


def considered(error, covariance):
    cells = error.cells(PLACES_M)
    informations = np.array(
        [rows_of(PLACES_M[cells == cell]).T @ rows_of(PLACES_M[cells == cell]) for cell in (0, 1)]
    )
    centres_m = np.array([PLACES_M[cells == cell].mean(axis=0) for cell in (0, 1)])
    return error.considered(covariance, informations, centres_m)


def test_places_near_each_other_share_a_cell():
    assert ModelError(0.01, 0.0, 1.0).cells(PLACES_M).tolist() == [0, 0, 1]
    assert ModelError(0.01, 0.0, 1.0).cells(PLACES_M[:0]).size == 0


def test_a_displaced_cell_moves_the_pose_as_least_squares_do():
    error = ModelError(0.01, 0.0, 1.0)
    rows, weak = rows_of(PLACES_M), 1e-3 * np.eye(6)
    covariance = np.linalg.inv(rows.T @ rows + weak)
    moved = []
    for cell in (0, 1):
        for axis in range(3):
            shift_m = np.where(error.cells(PLACES_M) == cell, NORMAL[axis] * error.tolerance_m, 0.0)
            moved.append(covariance @ rows.T @ shift_m)
    expected = covariance + sum(np.outer(each, each) for each in moved)
    assert np.allclose(considered(error, covariance), expected)


def test_a_wrong_scale_moves_the_pose_by_the_places_from_the_origin():
    error, covariance = ModelError(0.0, 0.01, 1.0), np.eye(6)
    assert np.allclose(considered(error, covariance), covariance)  # the plane through the origin stays
    assert error.matters
    assert not ModelError(0.0, 0.0, 1.0).matters
