"""Commands of thrusters whose execution, with its errors, is the motion."""

import numpy as np
import pytest

from rpod_motion import build_motion
from rpod_motion.thrust import Thrusters, specific_force_m_s2
from rpod_schemas.config.motion import (
    ApproachConfig,
    CommandErrorConfig,
    MotionConfig,
    StationKeepingConfig,
    TumbleConfig,
)

CENTRE_M = np.array([-0.4, 0.1, 0.05])
EXACT = CommandErrorConfig(sigma=0.0, delay_s=0.0, noise_m_s_sqrt_s=0.0)
"""Thrusters without errors."""


def a_motion(trajectory):
    config = MotionConfig(attitude=TumbleConfig(rate_deg_s=np.array([3.0, 5.0, 1.0])), trajectory=trajectory)
    return build_motion(
        config, centre_of_mass_m=CENTRE_M, inertia_kg_m2=np.diag([10.0, 12.0, 13.0]), duration_s=40.0
    )


def thrusters(config, seed=1, trajectory=None):
    motion = a_motion(trajectory or ApproachConfig(ramp_share=0.5))
    return Thrusters(config, motion, centre_of_mass_m=CENTRE_M, seed=seed), motion


def test_exact_thrusters_are_commanded_what_the_chaser_does_in_the_middle_of_the_period():
    source, motion = thrusters(EXACT)
    got = source.command(5, 7.0)
    np.testing.assert_allclose(got.acceleration_m_s2, specific_force_m_s2(motion, CENTRE_M, 7.05), rtol=1e-12)
    assert np.linalg.norm(got.acceleration_m_s2) > 1e-3
    assert got.variance == 0.0


def test_a_delay_is_commanded_earlier():
    source, motion = thrusters(EXACT.model_copy(update={"delay_s": 0.5}))
    np.testing.assert_allclose(
        source.command(5, 7.0).acceleration_m_s2, specific_force_m_s2(motion, CENTRE_M, 7.55), rtol=1e-12
    )


def test_size_and_direction_of_what_is_executed_are_off_as_stated():
    """The mean over seeds of the squared error is that of the stated variance, over three axes."""
    off = []
    for seed in range(300):
        source, motion = thrusters(EXACT.model_copy(update={"sigma": 0.05}), seed)
        got = source.command(0, 7.0)
        executed = specific_force_m_s2(motion, CENTRE_M, 7.05)
        off.append(np.sum((executed - got.acceleration_m_s2) ** 2) / (3.0 * got.variance))
        along = got.acceleration_m_s2 / np.linalg.norm(got.acceleration_m_s2)
        gain, turn = source.errors[0], source.errors[1:]
        error = np.sqrt(got.variance) * (gain * along + np.cross(turn, along))
        np.testing.assert_allclose(executed - got.acceleration_m_s2, error, atol=1e-12)
    assert np.mean(off) == pytest.approx(1.0, abs=0.2)


def test_a_chaser_in_free_flight_is_commanded_nothing():
    source, _ = thrusters(CommandErrorConfig(), trajectory=StationKeepingConfig())
    got = source.command(0, 7.0)
    assert not got.acceleration_m_s2.any()
    assert got.variance == 0.0


def test_noise_is_keyed_by_seed_and_time():
    noisy = CommandErrorConfig(sigma=0.0, noise_m_s_sqrt_s=1e-3)
    (source, _), (again, _) = thrusters(noisy), thrusters(noisy)
    got = source.command(0, 7.0).acceleration_m_s2
    np.testing.assert_array_equal(got, again.command(0, 7.0).acceleration_m_s2)
    quiet, _ = thrusters(noisy.model_copy(update={"noise_m_s_sqrt_s": 0.0}))
    times_s = np.arange(300) / 10.0
    off = [source.command(0, t).acceleration_m_s2 - quiet.command(0, t).acceleration_m_s2 for t in times_s]
    assert np.std(off) == pytest.approx(1e-3 * np.sqrt(10.0), rel=0.1)
