"""Covariance of a scan by its own residuals."""

from types import SimpleNamespace

import numpy as np
import pytest

from rpod_pose.lidar.posterior.scan_uncertainty import FaceRows, noise_information

WEAK = 1e-6 * np.eye(6)
SIGMA_M, SLACK_M = 0.025, 0.02


def registered(*, outline: bool) -> SimpleNamespace:
    """Return a registration without an outline, or one whose outline adds an information of 100."""
    information = 100.0 * np.eye(6)
    faces = SimpleNamespace(information=information if outline else np.eye(6))
    return SimpleNamespace(information=information, faces=faces)


def scans(noise_m: float, number: int = 200, returns: int = 150):
    """Yield returns on faces with a noise, and the step from the true pose to that of their fit."""
    rng = np.random.default_rng(11)
    J = rng.normal(size=(returns, 6))
    weights = np.full(returns, 1.0 / (SIGMA_M**2 + SLACK_M**2))
    for _ in range(number):
        errors_m = noise_m * rng.normal(size=returns)
        step = np.linalg.lstsq(J, errors_m, rcond=None)[0]
        left_m = errors_m - J @ step
        yield FaceRows(J, weights, np.ones(returns), left_m, np.zeros((returns, 3)), 1.0), step


@pytest.mark.parametrize("noise_m", [0.5 * SIGMA_M, SIGMA_M, 2.0 * SIGMA_M])
def test_the_covariance_is_that_of_the_noise_whatever_is_assumed(noise_m: float):
    nees = [
        step @ noise_information(rows, registered(outline=False), WEAK) @ step
        for rows, step in scans(noise_m)
    ]
    assert np.mean(nees) == pytest.approx(6.0, abs=1.0)


def test_what_the_outline_adds_is_kept():
    rows, _ = next(scans(SIGMA_M))
    few = rows._replace(derivatives=rows.derivatives[:0], weights=rows.weights[:0], fading=rows.fading[:0])
    few = few._replace(residuals_m=rows.residuals_m[:0])
    found = noise_information(few, registered(outline=True), WEAK)
    np.testing.assert_allclose(found, 100.0 * np.eye(6), rtol=1e-3)
