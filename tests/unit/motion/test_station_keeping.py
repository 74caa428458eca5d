"""The safety ellipse, against the equations that it solves and the orbits that it approximates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from rpod_motion.station_keeping import EARTH_MU_M3_S2, StationKeeping
from rpod_schemas.arrays import FloatArray

SEMI_MAJOR_AXIS_M = 7.144e6


def ellipse(*, phase_deg: float = 0.0, scale: float = 1.0) -> StationKeeping:
    return StationKeeping(
        anchor_m=np.zeros(3),
        least_range_m=20.0 * scale,
        greatest_range_m=50.0 * scale,
        phase_rad=float(np.deg2rad(phase_deg)),
        semi_major_axis_m=SEMI_MAJOR_AXIS_M,
    )


def period_s(motion: StationKeeping) -> float:
    return 2.0 * np.pi / motion.mean_motion_rad_s


def chaser_epoch_m(motion: StationKeeping, time_s: float) -> FloatArray:
    """Chaser from the target's centre of mass, epoch axes."""
    state = motion.state(time_s)
    return np.asarray(-state.R_epoch_chaser @ state.position_m)


def local_axes_epoch(motion: StationKeeping, time_s: float) -> FloatArray:
    """Columns: radius, track and normal at a time, epoch axes."""
    angle = motion.mean_motion_rad_s * time_s
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(motion.R_epoch_local @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


def chaser_local_m(motion: StationKeeping, time_s: float) -> FloatArray:
    return np.asarray(local_axes_epoch(motion, time_s).T @ chaser_epoch_m(motion, time_s))


def test_the_period_of_envisats_orbit_is_that_of_envisat() -> None:
    assert period_s(ellipse()) / 60.0 == pytest.approx(100.16, abs=0.01)


@given(phase_deg=st.floats(-180.0, 180.0), share=st.floats(0.0, 1.0))
def test_the_range_stays_within_its_bounds_and_the_boresight_on_the_centre_of_mass(
    phase_deg: float, share: float
) -> None:
    motion = ellipse(phase_deg=phase_deg)
    state = motion.state(share * period_s(motion))
    x_m, y_m, range_m = state.position_m
    assert (x_m, y_m) == (0.0, 0.0)
    assert 20.0 - 1e-9 <= range_m <= 50.0 + 1e-9
    np.testing.assert_allclose(state.R_epoch_chaser.T @ state.R_epoch_chaser, np.eye(3), atol=1e-12)
    assert np.linalg.det(state.R_epoch_chaser) > 0.0


def test_both_bounds_are_reached_below_and_ahead_of_the_target() -> None:
    np.testing.assert_allclose(chaser_local_m(ellipse(), 0.0), [-20.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(chaser_local_m(ellipse(phase_deg=90.0), 0.0), [0.0, 40.0, 30.0], atol=1e-12)


def test_the_ellipse_closes_after_one_period_and_stays_clear_of_the_track() -> None:
    motion = ellipse(phase_deg=15.0)
    times_s = np.linspace(0.0, period_s(motion), 721)
    path_m = np.array([chaser_local_m(motion, time_s) for time_s in times_s])
    np.testing.assert_allclose(path_m[-1], path_m[0], atol=1e-9)
    assert np.hypot(path_m[:, 0], path_m[:, 2]).min() >= 20.0 - 1e-9


@given(phase_deg=st.floats(-180.0, 180.0))
def test_the_path_solves_the_equations_of_clohessy_and_wiltshire(phase_deg: float) -> None:
    motion, step_s = ellipse(phase_deg=phase_deg), 10.0
    n = motion.mean_motion_rad_s
    before, now, after = (chaser_local_m(motion, time_s) for time_s in (-step_s, 0.0, step_s))
    velocity, acceleration = (after - before) / (2 * step_s), (after - 2 * now + before) / step_s**2
    residual = acceleration - [
        3 * n**2 * now[0] + 2 * n * velocity[1],
        -2 * n * velocity[0],
        -(n**2) * now[2],
    ]
    np.testing.assert_allclose(residual, 0.0, atol=1e-4 * n**2 * 50.0)


def two_body_difference_m(motion: StationKeeping) -> float:
    """Largest distance over one period between the closed form and two Kepler orbits, integrated."""
    n = motion.mean_motion_rad_s
    axes = local_axes_epoch(motion, 0.0)
    target = np.r_[SEMI_MAJOR_AXIS_M * axes[:, 0], n * SEMI_MAJOR_AXIS_M * axes[:, 1]]
    state = motion.state(0.0)
    relative_velocity = -state.R_epoch_chaser @ (
        state.velocity_m_s + np.cross(state.chaser_angular_rad_s, state.position_m)
    )
    chaser = target + np.r_[chaser_epoch_m(motion, 0.0), relative_velocity]

    def kepler(_: float, y: FloatArray) -> FloatArray:
        bodies = y.reshape(2, 6)
        radius = np.linalg.norm(bodies[:, :3], axis=1, keepdims=True)
        return np.hstack([bodies[:, 3:], -EARTH_MU_M3_S2 * bodies[:, :3] / radius**3]).ravel()

    times_s = np.linspace(0.0, period_s(motion), 25)
    orbits = solve_ivp(
        kepler,
        (0.0, period_s(motion)),
        np.r_[target, chaser],
        method="DOP853",
        t_eval=times_s,
        rtol=1e-13,
        atol=1e-7,
    )
    separation = (orbits.y[6:9] - orbits.y[:3]).T
    closed = np.array([chaser_epoch_m(motion, time_s) for time_s in times_s])
    return float(np.linalg.norm(separation - closed, axis=1).max())


def test_the_closed_form_is_the_motion_of_two_kepler_orbits_to_first_order() -> None:
    metres, kilometres = two_body_difference_m(ellipse()), two_body_difference_m(ellipse(scale=100.0))
    assert metres < 0.01
    assert 80.0**2 < kilometres / metres < 120.0**2  # what is neglected is of second order
