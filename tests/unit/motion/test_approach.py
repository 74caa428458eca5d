"""The straight approach."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rpod_motion import Motion, build_motion
from rpod_motion.errors import MotionError
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import (
    ApproachConfig,
    FixedAttitudeConfig,
    MotionConfig,
    SpinConfig,
    SwayConfig,
    TumbleConfig,
)

START_M, END_M = np.array([1.0, -0.5, 7.0]), np.array([0.0, 0.0, 2.0])
DURATION_S = 20.0


def approach(ramp_share: float) -> Motion:
    config = MotionConfig(
        trajectory=ApproachConfig(start_m=START_M, end_m=END_M, ramp_share=ramp_share),
        attitude=SpinConfig(),
    )
    return build_motion(
        config, centre_of_mass_m=np.array([-0.4, 0.0, 0.0]), inertia_kg_m2=np.eye(3), duration_s=DURATION_S
    )


def origin_m(motion: Motion, time_s: float) -> FloatArray:
    return motion.state(time_s).T_chaser_target.translation


@given(ramp_share=st.floats(0.0, 0.5))
def test_the_origin_starts_and_ends_where_it_should(ramp_share: float) -> None:
    motion = approach(ramp_share)
    np.testing.assert_allclose(origin_m(motion, 0.0), START_M, atol=1e-12)
    np.testing.assert_allclose(origin_m(motion, DURATION_S), END_M, atol=1e-12)


@given(ramp_share=st.floats(0.0, 0.5), share=st.floats(0.0, 1.0))
def test_the_origin_keeps_to_the_line_although_the_target_spins(ramp_share: float, share: float) -> None:
    way_m = origin_m(approach(ramp_share), share * DURATION_S) - START_M
    np.testing.assert_allclose(np.cross(way_m, END_M - START_M), 0.0, atol=1e-12)


@pytest.mark.parametrize("ramp_share", [0.1, 0.3, 0.5])
def test_the_profile_is_smooth_up_to_its_acceleration(ramp_share: float) -> None:
    motion, step_s = approach(ramp_share), 0.01
    times_s = np.arange(-0.5, DURATION_S + 0.5, step_s)
    way_m = np.array([np.linalg.norm(origin_m(motion, time_s) - START_M) for time_s in times_s])
    speed_m_s, acceleration_m_s2 = np.diff(way_m) / step_s, np.diff(way_m, 2) / step_s**2

    peak_m_s2 = 1.5 * speed_m_s.max() / (ramp_share * DURATION_S)  # of the ramp 3 w^2 - 2 w^3
    assert speed_m_s.min() > -1e-12
    np.testing.assert_allclose(np.abs(acceleration_m_s2).max(), peak_m_s2, rtol=1e-3)
    largest_jerk_m_s3 = 4.0 * peak_m_s2 / (ramp_share * DURATION_S)
    assert np.abs(np.diff(acceleration_m_s2)).max() < 1.01 * largest_jerk_m_s3 * step_s


def test_the_target_rests_before_the_epoch_and_after_the_end() -> None:
    motion = approach(0.2)
    for time_s, place_m in ((-0.7, START_M), (DURATION_S + 0.7, END_M)):
        np.testing.assert_allclose(origin_m(motion, time_s), place_m, atol=1e-12)
        assert np.linalg.norm(motion.state(time_s).linear_m_s) < 1e-12


def test_without_ramps_the_velocity_is_constant_beyond_both_ends_too() -> None:
    motion = approach(0.0)
    velocity_m_s = (END_M - START_M) / DURATION_S
    for time_s in (-0.7, 3.0, DURATION_S + 0.7):
        np.testing.assert_allclose(origin_m(motion, time_s), START_M + time_s * velocity_m_s, atol=1e-12)


def test_chaser_and_fixed_target_do_not_turn() -> None:
    config = MotionConfig(attitude=FixedAttitudeConfig())
    motion = build_motion(config, centre_of_mass_m=np.ones(3), inertia_kg_m2=np.eye(3), duration_s=DURATION_S)
    state = motion.state(9.0)
    assert not state.angular_rad_s.any()
    assert not state.chaser_angular_rad_s.any()


def synchronised(attitude) -> Motion:
    config = MotionConfig(
        trajectory=ApproachConfig(start_m=START_M, end_m=END_M, synchronised=True),
        attitude=attitude,
    )
    inertia_kg_m2 = np.diag([1.0, 2.0, 2.5])
    return build_motion(
        config, centre_of_mass_m=np.zeros(3), inertia_kg_m2=inertia_kg_m2, duration_s=DURATION_S
    )


@pytest.mark.parametrize("attitude", [SpinConfig(rate_deg_s=3.5), TumbleConfig(rate_deg_s=[2.0, 2.5, 1.5])])
@pytest.mark.parametrize("time_s", [0.0, 7.0, 20.0])
def test_a_synchronised_chaser_sees_the_target_at_rest_but_for_the_way_and_the_sun_turn(
    attitude, time_s: float
) -> None:
    motion = synchronised(attitude)
    first, state = motion.state(0.0), motion.state(time_s)
    R = state.T_chaser_target.rotation
    np.testing.assert_allclose(R.as_matrix(), first.T_chaser_target.rotation.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(state.angular_rad_s, 0.0, atol=1e-12)
    rate_deg_s = np.rad2deg(np.linalg.norm(state.chaser_angular_rad_s))
    assert 3.2 < rate_deg_s < 3.9, "the chaser turns with the target"
    # the chaser's attitude is the integral of its rate
    step_s = 1e-4
    before, after = (motion.trajectory.state(time_s + step).R_epoch_chaser for step in (-step_s, step_s))
    turn = (before.T @ after - np.eye(3)) / (2.0 * step_s)
    rate = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
    np.testing.assert_allclose(rate, state.chaser_angular_rad_s, atol=1e-5)


def test_a_state_is_the_same_whatever_was_asked_before() -> None:
    asked, fresh = (synchronised(TumbleConfig(rate_deg_s=[2.0, 2.5, 1.5])) for _ in range(2))
    times_s = [-0.5, *np.arange(0.0, 1.0, 0.05).tolist(), 0.0, 0.5, -0.5, 3.0]
    answers = [asked.state(time_s) for time_s in times_s]
    alone = fresh.state(3.0)
    for name in ("R_epoch_chaser", "linear_m_s", "angular_rad_s", "chaser_angular_rad_s"):
        assert np.array_equal(getattr(answers[-1], name), getattr(alone, name)), name
        assert np.array_equal(getattr(answers[-2], name), getattr(answers[0], name)), name


@pytest.mark.parametrize("attitude", [FixedAttitudeConfig(), SwayConfig()], ids=lambda one: one.kind)
def test_an_approach_cannot_be_synchronised_with_an_attitude_relative_to_the_chaser(attitude) -> None:
    with pytest.raises(MotionError, match=f"relative to the chaser .{attitude.kind} is"):
        synchronised(attitude)
