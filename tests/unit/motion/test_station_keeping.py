"""The chaser on a safety ellipse: its range, and where it looks."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rpod_motion.trajectories.station_keeping import StationKeeping
from rpod_schemas.arrays import FloatArray


def ellipse(*, phase_deg: float = 0.0) -> StationKeeping:
    return StationKeeping.on_safety_ellipse(
        np.zeros(3),
        least_range_m=20.0,
        greatest_range_m=50.0,
        phase_rad=np.deg2rad(phase_deg).item(),
        semi_major_axis_m=7.144e6,
        inclination_rad=np.deg2rad(98.5).item(),
    )


def period_s(motion: StationKeeping) -> float:
    """Return the time of one revolution of the mean argument of latitude, which is one relative orbit."""
    return 2.0 * np.pi / sum(motion.orbit.target.rates_rad_s[1:])


def chaser_local_m(motion: StationKeeping, time_s: float) -> FloatArray:
    return motion.orbit.separation(time_s)[0]


@given(phase_deg=st.floats(-180.0, 180.0), share=st.floats(0.0, 2.0))
def test_the_range_stays_within_its_bounds_and_the_boresight_on_the_centre_of_mass(
    phase_deg: float, share: float
) -> None:
    motion = ellipse(phase_deg=phase_deg)
    state = motion.state(share * period_s(motion))
    x_m, y_m, range_m = state.position_m
    assert (x_m, y_m) == (0.0, 0.0)
    assert 20.0 - 2e-3 <= range_m <= 50.0 + 2e-3
    np.testing.assert_allclose(state.R_epoch_chaser.T @ state.R_epoch_chaser, np.eye(3), atol=1e-12)
    assert np.linalg.det(state.R_epoch_chaser) > 0.0


def test_both_bounds_are_reached_below_and_ahead_of_the_target() -> None:
    np.testing.assert_allclose(chaser_local_m(ellipse(), 0.0), [-20.0, 0.0, 0.0], atol=2e-3)
    np.testing.assert_allclose(chaser_local_m(ellipse(phase_deg=90.0), 0.0), [0.0, 40.0, 30.0], atol=2e-3)


def test_the_ellipse_stays_clear_of_the_track_and_is_turned_along_itself_by_the_perigee_alone() -> None:
    motion = ellipse(phase_deg=15.0)
    times_s = np.linspace(0.0, period_s(motion), 721)
    path_m = np.array([chaser_local_m(motion, time_s) for time_s in times_s.tolist()])
    assert np.hypot(path_m[:, 0], path_m[:, 2]).min() >= 20.0 - 0.1
    perigee_rad = period_s(motion) * motion.orbit.chaser.rates_rad_s[1]
    assert np.linalg.norm(path_m[-1] - path_m[0]) < 40.0 * 1.1 * abs(perigee_rad)


def test_the_chasers_down_is_as_near_as_may_be_to_the_ellipses_normal() -> None:
    motion = ellipse(phase_deg=70.0)
    for time_s in (0.0, 1000.0, 4000.0):
        state = motion.state(time_s)
        _, _, target = motion.orbit.separation(time_s)
        R_local_chaser = target.R_inertial_local.T @ motion.R_epoch_inertial.T @ state.R_epoch_chaser
        np.testing.assert_allclose(motion.down_L @ R_local_chaser, [0.0, 1.0, 0.0], atol=5e-3)
