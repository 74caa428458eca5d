"""The posterior of likelihoods that are steps: compared with sums over all of space."""

import numpy as np
import pytest
from scipy.special import ndtr

from rpod_pose.lidar.posterior.step_posterior import Steps, propagated

HOLD = np.full(6, 1e4)


def steps_in_plane(normals, distances, odds):
    rows = np.zeros((len(normals), 6))
    rows[:, :2] = normals
    return Steps(len(rows), rows, np.asarray(distances, float), np.asarray(odds, float))


def summed(steps, prior, blur):
    """Return mean and covariance of the first two unknowns, by a sum over a fine grid."""
    side = np.linspace(-4.0, 4.0, 801)
    x, y = np.meshgrid(side, side, indexing="ij")
    log = -0.5 * prior * (x**2 + y**2)
    for row, distance, odds in zip(steps.rows, steps.distance_m, steps.odds, strict=True):
        inside, outside = min(1.0, np.exp(odds)), min(1.0, np.exp(-odds))
        share = ndtr((distance + row[0] * x + row[1] * y) / blur)
        log += np.log(outside + (inside - outside) * share)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    mean = np.array([(weight * x).sum(), (weight * y).sum()])
    d = np.stack((x - mean[0], y - mean[1]))
    return mean, np.einsum("iab,jab,ab->ij", d, d, weight)


@pytest.mark.parametrize("seed", range(6))
def test_mean_and_covariance_are_those_of_the_whole_posterior(seed):
    random = np.random.default_rng(seed)
    angles = random.uniform(0.0, 2.0 * np.pi, 14)
    normals = np.column_stack((np.cos(angles), np.sin(angles)))
    truth = random.normal(0.0, 0.5, 2)
    distances = random.uniform(-1.5, 1.5, 14)
    odds = np.where(distances + normals @ truth > 0.0, 6.0, -3.0)
    steps, information = steps_in_plane(normals, distances, odds), np.diag([1.0, 1.0, 0, 0, 0, 0])
    hold = HOLD.copy()
    hold[:2] = 1e-9
    found = propagated(steps, information, np.zeros(6), hold, 0.05)
    mean, covariance = summed(steps, 1.0, 0.05)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(found.mean[:2] - mean), 0.35 * sigma)
    spread = np.linalg.inv((information + found.information)[:2, :2])
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), sigma, rtol=0.35)


def test_two_steps_bound_a_motion_between_them():
    steps = steps_in_plane([(1.0, 0.0), (-1.0, 0.0)], [0.2, 0.4], [30.0, 30.0])
    found = propagated(steps, np.zeros((6, 6)), np.zeros(6), np.full(6, 1.0), 1e-3)
    assert found.mean[0] == pytest.approx(0.1, abs=0.01)
    assert found.information[0, 0] ** -0.5 == pytest.approx(0.6 / np.sqrt(12.0), rel=0.25)
    assert not found.information[1:, 1:].any()


def test_a_step_that_holds_for_sure_tells_nothing():
    steps = steps_in_plane([(1.0, 0.0)], [100.0], [10.0])
    found = propagated(steps, np.eye(6), np.zeros(6), HOLD, 0.01)
    assert not found.mean.any()
    assert not found.information.any()


def test_a_step_that_contradicts_everything_else_leaves_finite_numbers():
    steps = steps_in_plane([(1.0, 0.0), (1.0, 0.0)], [-1e3, -30.0], [30.0, 30.0])
    found = propagated(steps, 1e6 * np.eye(6), np.zeros(6), HOLD, 1e-3)
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.information).all()
    assert np.linalg.eigvalsh(found.information)[0] >= -1e-6
