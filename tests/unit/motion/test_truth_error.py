"""Truth with an error of its own: as large as declared, lasting as declared, and stated."""

import numpy as np
import pytest

from rpod.play.facility import configure
from rpod.scenarios import find
from rpod_motion.truth_error import TruthError
from rpod_schemas.config.motion import TruthErrorConfig
from rpod_schemas.poses import make_pose

RATE_HZ = 250.0


def errors(config, number, *, seed=1):
    error = TruthError(config, seed=seed, rate_hz=RATE_HZ)
    poses = [error.perturb(make_pose()) for _ in range(number)]
    return np.array([[*pose.translation, *pose.rotation.as_rotvec()] for pose in poses])


def test_errors_are_as_large_and_last_as_long_as_declared():
    config = TruthErrorConfig(correlation_s=0.02)
    drawn = errors(config, 8000)
    sigma = np.repeat([1.56e-3, np.radians(0.2)], 3)
    np.testing.assert_allclose(drawn.std(axis=0), sigma, rtol=0.1)
    lag = round(0.02 * RATE_HZ)
    correlation = (drawn[lag:] * drawn[:-lag]).mean(axis=0) / sigma**2
    np.testing.assert_allclose(correlation, np.exp(-1.0), atol=0.12)


def test_errors_without_correlation_are_independent_and_follow_the_seed():
    config = TruthErrorConfig(correlation_s=0.0)
    drawn = errors(config, 4000)
    assert abs((drawn[1:] * drawn[:-1]).mean() / drawn.var()) < 0.1
    np.testing.assert_array_equal(drawn[:5], errors(config, 5))
    assert (drawn[:5] != errors(config, 5, seed=2)).all()


@pytest.mark.parametrize("wrong", [None, TruthErrorConfig()])
def test_a_scenario_with_an_error_of_truth_shows_the_sensors_the_exact_motion(wrong, tmp_path):
    scenario = find("mockup-tumbling").model_copy(update={"truth_error": wrong})
    services = configure(scenario, directory=tmp_path, speed="max").services
    assert services["motion"].truth_error == wrong
    assert services["emulator"].motion == ("truth/odometry" if wrong is None else "motion/reference")
