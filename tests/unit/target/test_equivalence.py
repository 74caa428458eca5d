"""Which attitudes of a target no measurement tells apart, and errors modulo these."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_target.equivalence import FREE_SIGMA_RAD, NO_SYMMETRY, Equivalence, Symmetry

Z, X = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
FREE, FLIP = Symmetry(Z, 12, exact=True, continuous=True), Symmetry(X, 2, exact=True)


@pytest.mark.parametrize(
    ("symmetries", "turns", "dof"),
    [
        ([], 1, 6),
        ([Symmetry(Z, 12, continuous=True)], 1, 6),  # near: sensors tell the angle from close by
        ([Symmetry(Z, 16, exact=True)], 16, 6),
        ([Symmetry(Z, 16, exact=True), FLIP], 32, 6),  # and half turns about each axis across
        ([Symmetry(Z, 33, exact=True), FLIP], 2, 5),  # as good as round
        ([Symmetry(Z, 3, exact=True), Symmetry((0.7071, 0.7071, 0.0), 2, exact=True)], 6, 6),  # rounded
        ([Symmetry(Z, 4, exact=True), Symmetry(X, 4, exact=True)], 24, 6),  # a cube
        ([FREE], 1, 5),
        ([FREE, FLIP, Symmetry(Z, 7, exact=True)], 2, 5),
        ([FREE, Symmetry(X, 12, exact=True, continuous=True)], 1, 3),  # a sphere
        (
            [FREE, Symmetry((0.0, 0.01, -1.0), 12, exact=True, continuous=True)],
            1,
            5,
        ),  # rounded, the other way
    ],
)
def test_the_turns_are_the_group_of_the_exact_symmetries_modulo_the_free_axis(symmetries, turns, dof):
    alike = Equivalence.of(symmetries)
    assert (len(alike.turns), alike.dof) == (turns, dof)
    np.testing.assert_array_equal(alike.turns[0], np.eye(3))


@pytest.mark.parametrize("symmetries", [[], [Symmetry(Z, 5, exact=True), FLIP], [FREE], [FREE, FLIP]])
def test_the_nearest_equivalent_attitude_is_found(symmetries):
    alike, generator = Equivalence.of(symmetries), np.random.default_rng(3)
    truth = Rotation.random(20, rng=generator)
    off = Rotation.from_rotvec(0.1 * generator.standard_normal((20, 3)))
    about = generator.uniform(-np.pi, np.pi, 20) * len(alike.free_axes)
    class_of = generator.integers(len(alike.turns), size=20)
    found = off * truth * Rotation.from_matrix(alike.turns[class_of])
    found = found * Rotation.from_rotvec(about[:, None] * np.array(Z))
    near = alike.nearest(truth, found)
    error = (near.inv() * found).as_rotvec()
    assert (np.linalg.norm(error, axis=1) <= off.magnitude() + 1e-9).all()
    cosines = alike.cosines(truth.as_matrix(), found.as_matrix()).diagonal()
    np.testing.assert_allclose(np.cos(np.linalg.norm(error, axis=1)), cosines, atol=1e-9)
    np.testing.assert_allclose(error @ alike.free_axes.T, 0.0, atol=1e-9)
    one = alike.nearest(truth[0], found[0])
    np.testing.assert_allclose(one.as_matrix(), near[0].as_matrix(), atol=1e-12)


def test_of_a_sphere_no_attitude_is_an_error_and_all_are_free():
    alike = Equivalence.of([FREE, Symmetry(X, 24, exact=True)])
    truth, found = Rotation.random(2, rng=np.random.default_rng(4))
    assert alike.nearest(truth, found).approx_equal(found)
    assert alike.cosines(truth.as_matrix()[None], found.as_matrix()[None]) == 1.0
    free = alike.with_free_variance(np.ones((6, 6)), truth.as_matrix(), FREE_SIGMA_RAD**2)
    expected = np.block(
        [[np.ones((3, 3)), np.zeros((3, 3))], [np.zeros((3, 3)), FREE_SIGMA_RAD**2 * np.eye(3)]]
    )
    np.testing.assert_allclose(free, expected, atol=1e-12)


def test_only_the_variance_about_the_free_axis_is_replaced():
    alike, R = Equivalence.of([FREE]), Rotation.random(rng=np.random.default_rng(1)).as_matrix()
    root = np.random.default_rng(2).standard_normal((6, 6))
    covariance = root @ root.T
    free = alike.with_free_variance(covariance, R, FREE_SIGMA_RAD**2)
    along = np.concatenate((np.zeros(3), R @ np.array(Z)))
    across = np.linalg.svd(along[None])[2][1:]
    np.testing.assert_allclose(free @ along, FREE_SIGMA_RAD**2 * along, atol=1e-12)
    np.testing.assert_allclose(across @ free @ across.T, across @ covariance @ across.T, atol=1e-12)
    np.testing.assert_array_equal(NO_SYMMETRY.with_free_variance(covariance, R, 1.0), covariance)
