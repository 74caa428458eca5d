"""Every motion, whatever its kinds: twist, range of times, sun, and what it refuses."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rpod_motion import MARGIN_S, Motion, MotionError, build_motion
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.motion import (
    ApproachConfig,
    FixedAttitudeConfig,
    MotionConfig,
    SpinConfig,
    StationKeepingConfig,
    SunConfig,
    TumbleConfig,
)

CENTRE_OF_MASS_M = np.array([-3.86, -0.01, 0.3])
INERTIA_KG_M2 = np.array([[17e3, 4e2, -2.2e3], [4e2, 125e3, 3e2], [-2.2e3, 3e2, 129e3]])
DURATION_S = 60.0

ATTITUDE = Rotation.from_euler("ZYX", [20.0, -50.0, 130.0], degrees=True)
TRAJECTORIES = {
    "approach": ApproachConfig(start_m=np.array([0.5, -0.2, 7.0]), end_m=np.array([0.0, 0.1, 2.0])),
    "approach at constant velocity": ApproachConfig(ramp_share=0.0),
    "station keeping": StationKeepingConfig(phase_deg=40.0),
    "station keeping from 25 to 53 m": StationKeepingConfig(
        phase_deg=-100.0, greatest_range_m=53.0, least_range_m=25.0
    ),
}
ATTITUDES = {
    "fixed": FixedAttitudeConfig(R_chaser_target=ATTITUDE),
    "spin": SpinConfig(R_chaser_target=ATTITUDE, axis=np.array([1.0, 2.0, -1.0]), rate_deg_s=-8.0),
    "tumble": TumbleConfig(R_chaser_target=ATTITUDE, rate_deg_s=np.array([5.0, 4.0, -3.0])),
}
KINDS = list(product(TRAJECTORIES, ATTITUDES))


@cache
def motion_of(trajectory: str, attitude: str) -> Motion:
    config = MotionConfig(
        trajectory=TRAJECTORIES[trajectory],
        attitude=ATTITUDES[attitude],
        sun=SunConfig(direction=np.array([3.0, 0.0, 4.0]), irradiance_W_m2=1000.0),
    )
    return built(config)


def built(
    config: MotionConfig, inertia_kg_m2: FloatArray = INERTIA_KG_M2, duration_s: float = DURATION_S
) -> Motion:
    return build_motion(
        config, centre_of_mass_m=CENTRE_OF_MASS_M, inertia_kg_m2=inertia_kg_m2, duration_s=duration_s
    )


def vee(skew: FloatArray) -> FloatArray:
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


@given(kind=st.sampled_from(KINDS), time_s=st.floats(-0.9, DURATION_S + 0.9))
def test_the_twist_is_the_derivative_of_the_pose(kind: tuple[str, str], time_s: float) -> None:
    motion, half_s = motion_of(*kind), 1e-2
    state = motion.state(time_s)
    before, after = (motion.state(time_s + step).T_chaser_target for step in (-half_s, half_s))

    R = state.T_chaser_target.rotation.as_matrix()
    velocity = (after.translation - before.translation) / (2 * half_s)
    R_rate = (after.rotation.as_matrix() - before.rotation.as_matrix()) / (2 * half_s)
    np.testing.assert_allclose(state.linear_m_s, R.T @ velocity, atol=1e-6)  # orbits are rounded at 1e-9 m
    np.testing.assert_allclose(state.angular_rad_s, vee(R.T @ R_rate), atol=2e-7)


@given(kind=st.sampled_from(KINDS), time_s=st.floats(0.0, DURATION_S))
def test_sun_and_chaser_rate_belong_to_the_same_inertial_space(kind: tuple[str, str], time_s: float) -> None:
    motion, half_s = motion_of(*kind), 0.5
    rate = (motion.sun_W_m2(time_s + half_s) - motion.sun_W_m2(time_s - half_s)) / (2 * half_s)
    turning = -np.cross(motion.state(time_s).chaser_angular_rad_s, motion.sun_W_m2(time_s))
    np.testing.assert_allclose(rate, turning, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_at_the_epoch_all_is_as_configured_in_chaser_axes(kind: tuple[str, str]) -> None:
    motion = motion_of(*kind)
    turn = motion.state(0.0).T_chaser_target.rotation * ATTITUDE.inv()
    assert turn.magnitude() < 1e-12
    np.testing.assert_allclose(motion.sun_W_m2(0.0), [600.0, 0.0, 800.0], rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_the_motion_reaches_a_second_beyond_both_ends_and_no_further(kind: tuple[str, str]) -> None:
    motion = motion_of(*kind)
    for time_s in (-MARGIN_S, DURATION_S + MARGIN_S):
        assert np.isfinite(motion.state(time_s).T_chaser_target.as_matrix()).all()
    for time_s in (-MARGIN_S - 1e-6, DURATION_S + MARGIN_S + 1e-6, float("nan")):
        with pytest.raises(MotionError, match="lies outside the motion, -1 to 61 s"):
            motion.state(time_s)
        with pytest.raises(MotionError, match="lies outside"):
            motion.sun_W_m2(time_s)


def test_without_a_sun_it_is_dark() -> None:
    assert not built(MotionConfig()).sun_W_m2(1.0).any()


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_a_duration_that_is_no_time_is_refused(duration_s: float) -> None:
    with pytest.raises(MotionError, match="must be positive"):
        built(MotionConfig(), duration_s=duration_s)


@pytest.mark.parametrize(
    ("inertia_kg_m2", "reason"),
    [
        (np.diag([1.0, 1.0, 3.0]), "at most the sum of the other two"),
        (np.diag([0.0, 1.0, 1.0]), "must be positive"),
        (np.array([[2.0, 0.5, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]]), "not symmetric"),
    ],
)
def test_tumbling_refuses_the_inertia_of_no_rigid_body(inertia_kg_m2: FloatArray, reason: str) -> None:
    with pytest.raises(MotionError, match=reason):
        built(MotionConfig(attitude=ATTITUDES["tumble"]), inertia_kg_m2=inertia_kg_m2)
