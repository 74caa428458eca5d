"""Torque-free tumbling against its invariants and known solutions, and the swing of the origin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rpod_motion import Motion, build_motion
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import (
    ApproachConfig,
    FixedAttitudeConfig,
    MotionConfig,
    SpinConfig,
    StationKeepingConfig,
    SwayConfig,
    TumbleConfig,
)

ENVISAT_INERTIA = np.array([[17e3, 4e2, -2.2e3], [4e2, 125e3, 3e2], [-2.2e3, 3e2, 129e3]])
CENTRE_OF_MASS_M = np.array([-3.86, -0.01, 0.0])


def tumbling(
    rate_deg_s: list[float],
    inertia: FloatArray = ENVISAT_INERTIA,
    *,
    orbiting: bool = False,
    duration_s: float,
) -> Motion:
    config = MotionConfig(
        trajectory=StationKeepingConfig() if orbiting else ApproachConfig(),
        attitude=TumbleConfig(rate_deg_s=np.array(rate_deg_s)),
    )
    return build_motion(
        config, centre_of_mass_m=CENTRE_OF_MASS_M, inertia_kg_m2=inertia, duration_s=duration_s
    )


def target_rate_rad_s(motion: Motion, time_s: float) -> FloatArray:
    """Relative to inertial space, target axes, by the rule of the interface control document."""
    state = motion.state(time_s)
    return state.angular_rad_s + state.T_chaser_target.rotation.inv().apply(state.chaser_angular_rad_s)


@settings(max_examples=15, deadline=None)
@given(rate_deg_s=st.lists(st.floats(-8.0, 8.0), min_size=3, max_size=3), time_s=st.floats(-1.0, 601.0))
def test_energy_and_angular_momentum_are_conserved(rate_deg_s: list[float], time_s: float) -> None:
    motion = tumbling(rate_deg_s, duration_s=600.0)  # chaser axes are inertial in an approach

    def invariants(at_s: float) -> tuple[float, FloatArray]:
        momentum = ENVISAT_INERTIA @ target_rate_rad_s(motion, at_s)
        energy = float(target_rate_rad_s(motion, at_s) @ momentum)
        return energy, motion.state(at_s).T_chaser_target.rotation.apply(momentum)

    (energy, momentum), (energy_0, momentum_0) = invariants(time_s), invariants(0.0)
    assert energy == pytest.approx(energy_0, rel=1e-9, abs=1e-12)
    np.testing.assert_allclose(momentum, momentum_0, rtol=0.0, atol=1e-12 * float(np.linalg.norm(momentum_0)))


@pytest.mark.parametrize("orbiting", [False, True])
@pytest.mark.parametrize("time_s", [-0.5, 0.0, 17.3, 60.5])
def test_eulers_equations_hold_whether_the_chaser_turns_or_not(time_s: float, orbiting: bool) -> None:
    motion, half_s = tumbling([3.0, -5.0, 4.0], orbiting=orbiting, duration_s=60.0), 0.01
    rate = target_rate_rad_s(motion, time_s)
    change = (target_rate_rad_s(motion, time_s + half_s) - target_rate_rad_s(motion, time_s - half_s)) / (
        2 * half_s
    )
    torque = ENVISAT_INERTIA @ change + np.cross(rate, ENVISAT_INERTIA @ rate)
    np.testing.assert_allclose(torque, 0.0, atol=1e-6 * float(np.linalg.norm(ENVISAT_INERTIA @ rate)))


def test_a_symmetric_top_precesses_as_the_analytic_solution_says() -> None:
    axial, transverse = 2.0, 3.0
    motion = tumbling([4.0, 0.0, 7.0], np.diag([transverse, transverse, axial]), duration_s=300.0)
    w = np.deg2rad([4.0, 0.0, 7.0])
    precession_rad_s = (axial - transverse) / transverse * w[2]
    R_0 = motion.state(0.0).T_chaser_target.rotation
    momentum_T = np.diag([transverse, transverse, axial]) @ w
    for time_s in (-1.0, 33.0, 300.0):
        phase = precession_rad_s * time_s
        expected = [w[0] * np.cos(phase), w[0] * np.sin(phase), w[2]]
        np.testing.assert_allclose(target_rate_rad_s(motion, time_s), expected, atol=1e-10)
        # the body turns about its axis and with it about the momentum
        about_momentum = Rotation.from_rotvec(momentum_T / transverse * time_s)
        about_axis = Rotation.from_rotvec([0.0, 0.0, -phase])
        error = motion.state(time_s).T_chaser_target.rotation.inv() * R_0 * about_momentum * about_axis
        assert error.magnitude() < 1e-9


def test_rotation_about_the_intermediate_axis_flips_over() -> None:
    motion = tumbling([0.01, 8.0, 0.0], np.diag([1.0, 2.0, 3.0]), duration_s=500.0)
    rates = np.array([target_rate_rad_s(motion, time_s)[1] for time_s in np.arange(0.0, 500.0, 1.0)])
    assert rates.min() == pytest.approx(-rates.max(), rel=1e-3)
    assert (np.diff(np.sign(rates)) != 0).sum() >= 2


@pytest.mark.parametrize("axis", [0, 2])
def test_rotation_about_the_least_and_the_greatest_axis_is_stable(axis: int) -> None:
    rate_deg_s = [0.01, 0.01, 0.01]
    rate_deg_s[axis] = 8.0
    motion = tumbling(rate_deg_s, np.diag([1.0, 2.0, 3.0]), duration_s=300.0)
    rates = np.array([target_rate_rad_s(motion, time_s)[axis] for time_s in np.arange(0.0, 300.0, 5.0)])
    assert np.ptp(rates) < 1e-4 * rates[0]


def test_a_body_at_rest_stays_at_rest() -> None:
    motion = tumbling([0.0, 0.0, 0.0], duration_s=60.0)
    turn = motion.state(0.0).T_chaser_target.rotation.inv() * motion.state(60.0).T_chaser_target.rotation
    assert turn.magnitude() == 0.0


def test_a_spin_of_five_degrees_a_second_turns_fully_about_its_axis_in_72_seconds() -> None:
    config = MotionConfig(attitude=SpinConfig(axis=np.array([2.0, 0.0, 0.0]), rate_deg_s=5.0))
    motion = build_motion(config, centre_of_mass_m=np.zeros(3), inertia_kg_m2=np.eye(3), duration_s=72.0)
    attitude_0 = motion.state(0.0).T_chaser_target.rotation
    quarter = attitude_0.inv() * motion.state(18.0).T_chaser_target.rotation
    np.testing.assert_allclose(np.rad2deg(quarter.as_rotvec()), [90.0, 0.0, 0.0], atol=1e-9)
    assert (attitude_0.inv() * motion.state(72.0).T_chaser_target.rotation).magnitude() < 1e-12


@pytest.mark.parametrize("attitude", [FixedAttitudeConfig(), SpinConfig(axis=np.array([0.0, 1.0, 0.0]))])
def test_a_turning_body_swings_its_origin_about_its_centre_of_mass(
    attitude: FixedAttitudeConfig | SpinConfig,
) -> None:
    config = MotionConfig(trajectory=StationKeepingConfig(), attitude=attitude)
    motion = build_motion(
        config, centre_of_mass_m=CENTRE_OF_MASS_M, inertia_kg_m2=ENVISAT_INERTIA, duration_s=60.0
    )
    for time_s in np.linspace(-1.0, 61.0, 9):
        x_m, y_m, range_m = motion.state(time_s).T_chaser_target.apply(CENTRE_OF_MASS_M)
        assert (x_m, y_m) == pytest.approx((0.0, 0.0), abs=1e-12)
        assert 20.0 <= range_m <= 50.0


def test_a_fixed_target_keeps_its_attitude_in_the_axes_of_a_turning_chaser() -> None:
    config = MotionConfig(trajectory=StationKeepingConfig())
    motion = build_motion(
        config, centre_of_mass_m=CENTRE_OF_MASS_M, inertia_kg_m2=ENVISAT_INERTIA, duration_s=600.0
    )
    turn = motion.state(600.0).T_chaser_target.rotation * motion.state(0.0).T_chaser_target.rotation.inv()
    assert turn.magnitude() < 1e-12
    assert not motion.state(600.0).angular_rad_s.any()
    assert np.linalg.norm(motion.state(600.0).chaser_angular_rad_s) > 5e-4


def test_a_swaying_target_has_the_rate_of_its_attitude() -> None:
    config = MotionConfig(attitude=SwayConfig())
    motion = build_motion(config, centre_of_mass_m=np.zeros(3), inertia_kg_m2=np.eye(3), duration_s=60.0)
    step_s = 1e-4
    for time_s in (0.0, 3.7, 11.0, 52.3):
        before, now, after = (motion.state(time_s + shift_s) for shift_s in (-step_s, 0.0, step_s))
        turn = before.T_chaser_target.rotation.inv() * after.T_chaser_target.rotation
        np.testing.assert_allclose(turn.as_rotvec() / (2.0 * step_s), now.angular_rad_s, atol=1e-6)
