"""What a track assumes of the motion before two frames have shown it."""

from dataclasses import replace

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, View, registration, rig

from rpod_pose.navigation.dynamics.manoeuvre import MOST_M_S2, greatest
from rpod_pose.navigation.filter import start, velocity_sigma_m_s
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Mode


def closing(range_m: float, speed_m_s: float, since_s: float) -> View:
    """Return a view of a target that comes straight towards the chaser."""
    pose = make_pose(translation_m=[0.0, 0.0, range_m - speed_m_s * since_s])
    seen = registration(MOUNT.inv() * pose, covariance=np.diag([1e-6] * 3 + [1e-6] * 3))
    return View(round((START_S + since_s) * SECOND_NS), tracked=seen, acquired=(seen,))


@pytest.mark.parametrize("rate_hz", [1.0, 30.0])
@pytest.mark.parametrize(("range_m", "speed_m_s"), [(17.5, 1.75), (1.0, 1.75), (40.0, 5.0), (7.0, 5.0)])
def test_a_target_that_closes_is_tracked_from_the_second_frame(range_m, speed_m_s, rate_hz):
    """A prior of 1 m/s for every range refused 5 m/s in each second frame."""
    made, steps = rig(), [0.0, 0.02, 0.04] if range_m < 2.0 else np.arange(3) / max(rate_hz, speed_m_s)
    for since_s in steps:
        output = made.see(closing(range_m, speed_m_s, since_s))
        assert output.status.accepted, output.status.reason
    assert made.mode == Mode.TRACKING
    velocity_m_s = made.state.history.state.velocity_m_s
    np.testing.assert_allclose(velocity_m_s, [0.0, 0.0, -speed_m_s], atol=0.15)


def test_a_second_pose_that_no_chaser_can_brake_for_is_refused():
    made = rig()
    made.see(closing(7.0, 0.0, 0.0))
    reason = made.see(closing(7.0, 12.0, 0.5)).status.reason
    assert "raise filter.initial_velocity_sigma_m_s to a third of the largest speed" in reason


def test_the_prior_of_the_velocity_follows_from_the_range_unless_it_is_given():
    config, near, far = FilterConfig(), *(make_pose(translation_m=[0.0, 0.9 * r, 1.2 * r]) for r in (1, 4))
    assert velocity_sigma_m_s(near, config) == pytest.approx(1.0)  # 3 m/s2 over 1.5 m stop 3 m/s
    assert velocity_sigma_m_s(far, config) == pytest.approx(2.0)
    given = FilterConfig(initial_velocity_sigma_m_s=0.3)
    assert velocity_sigma_m_s(far, given) == 0.3
    for prior, sigma_m_s in ((config, 2.0), (given, 0.3)):
        state = start(far, np.eye(6), 0, config=prior)
        np.testing.assert_allclose(np.diag(state.covariance)[6:9], sigma_m_s**2)


def test_a_track_becomes_no_less_certain_than_at_its_beginning():
    state = start(make_pose(translation_m=[0.0, 0.0, 1.5]), np.eye(6), 0, config=FilterConfig())
    config = FilterConfig(acceleration_density_m2_s3=1.0)
    assert greatest(10.0, state, config).acceleration * 10.0 == pytest.approx(1.0**2)
    farther = replace(state, T_chaser_target=make_pose(translation_m=[0.0, 0.0, 150.0]))
    assert greatest(1.0, farther, config).acceleration == pytest.approx(MOST_M_S2**2 / 3.0)
