"""Shifts that edges share: those beside saturated pixels, and all."""

from types import SimpleNamespace

import numpy as np
import pytest

from rpod_geometry.kernels import kernel
from rpod_pose.pmd.joint.edge_points import (
    SHIFT_PX,
    EdgeErrors,
    EdgeEvidence,
    EdgeSums,
    Shifted,
    without_shift,
)
from rpod_pose.pmd.joint.fit import DepthErrors, _shares
from rpod_pose.registration.field_alignment import FieldEvidence
from rpod_pose.registration.lie_group import Vector
from rpod_pose.registration.normal_equations import add_residual, gradient_of, information_of, no_sums
from rpod_schemas.arrays import FloatArray

NUMBER, BESIDE = 40, 9
PER_PX2 = 3.0


@kernel
def summed(normals: FloatArray, places_m: FloatArray, residuals_px: FloatArray) -> FloatArray:
    sums = no_sums()
    for n in range(len(residuals_px)):
        normal = Vector(normals[n, 0], normals[n, 1], normals[n, 2])
        place = Vector(places_m[n, 0], places_m[n, 1], places_m[n, 2])
        add_residual(sums, normal, place, residuals_px[n], 1.0)
    return sums


@kernel
def eliminated(of_edges: FloatArray, shifts: EdgeSums, per_px2: float) -> Shifted:
    return without_shift(of_edges, shifts, per_px2)


@pytest.fixture(scope="module")
def edges():
    rng = np.random.default_rng(7)
    normals, places_m = rng.standard_normal((2, NUMBER, 3))
    sides = rng.choice([-1.0, 1.0], NUMBER)
    residuals_px = 0.1 * rng.standard_normal(NUMBER)
    beside = slice(0, BESIDE)
    shifts = EdgeSums(
        summed(normals[beside], places_m[beside], sides[beside]),
        float(BESIDE),
        float(sides[beside] @ residuals_px[beside]),
        summed(normals, places_m, sides),
        no_sums(),
        0.0,
    )
    J = np.hstack([-normals, np.cross(normals, places_m)])
    return SimpleNamespace(
        sums=PER_PX2 * summed(normals, places_m, residuals_px),
        shifts=shifts,
        J=J,
        residuals_px=residuals_px,
        sides=sides,
        of_shift=np.where(np.arange(NUMBER) < BESIDE, sides, 0.0),
    )


def test_the_step_is_that_of_a_fit_in_which_the_shift_is_an_unknown(edges):
    """Least squares with seven unknowns, the last of which has a prior."""
    sums = edges.sums.copy()
    eliminated(sums, edges.shifts, PER_PX2)
    J = np.column_stack([edges.J, edges.of_shift])
    information = PER_PX2 * J.T @ J
    information[6, 6] += SHIFT_PX**-2
    expected = np.linalg.solve(information, -PER_PX2 * J.T @ edges.residuals_px)
    step = np.linalg.solve(information_of(sums, 6), -gradient_of(sums, 6))
    np.testing.assert_allclose(step, expected[:6], rtol=1e-9)
    np.testing.assert_allclose(
        np.linalg.inv(information_of(sums, 6)), np.linalg.inv(information)[:6, :6], rtol=1e-9
    )


def test_noise_and_the_shift_s_prior_are_all_of_the_covariance(edges):
    """The sandwich of both is the inverse information."""
    sums = edges.sums.copy()
    found = eliminated(sums, edges.shifts, PER_PX2)
    inverse = np.linalg.inv(information_of(sums, 6))
    by_noise = inverse @ information_of(found.noisy, 6) @ inverse
    by_shift = inverse @ found.beside
    np.testing.assert_allclose(by_noise + np.outer(by_shift, by_shift), inverse, rtol=1e-9, atol=1e-12)


def test_a_shift_of_all_edges_moves_the_pose_by_as_much_as_stated(edges):
    sums = edges.sums.copy()
    found = eliminated(sums, edges.shifts, PER_PX2)
    J = np.column_stack([edges.J, edges.of_shift])
    information = PER_PX2 * J.T @ J
    information[6, 6] += SHIFT_PX**-2
    moved = np.linalg.solve(information, PER_PX2 * J.T @ edges.sides)[:6]
    np.testing.assert_allclose(np.linalg.inv(information_of(sums, 6)) @ found.every, moved, rtol=1e-9)


def test_some_edges_beside_saturated_pixels_take_no_weight_from_the_others():
    """With a seventh of them, each edge had a fiftieth of its weight."""
    shifts = EdgeSums(no_sums(), 37.0, 0.0, no_sums(), no_sums(), 0.0)
    errors = EdgeErrors(noise_px=0.3, most_edges=300.0, reach_px=3.0)
    depth = DepthErrors(noise_m=0.006, most_points=400.0, bias_m=0.04, uneven_m=0.005, slack_m=0.0)
    problem = SimpleNamespace(depth_errors=depth, edge_errors=errors)
    weights = [
        _shares.py_func(
            problem,
            FieldEvidence(0.0, 0.0, 0, 0.0),
            EdgeEvidence(244 * 0.3**2, 244, 260, 260, 250.0, np.zeros(3), shifted, 0.0, shifts),
            3.0,
        ).edges
        for shifted in (0, 37)
    ]
    assert weights[1] == pytest.approx(weights[0])
