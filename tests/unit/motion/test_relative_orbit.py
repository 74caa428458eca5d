"""The safety ellipse of mean elements, against numerical propagation about an oblate Earth."""

from functools import cache
from math import atan2, cos, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from rpod_motion.trajectories.relative_orbit import (
    EARTH_J2,
    EARTH_MU_M3_S2,
    EARTH_RADIUS_M,
    MeanOrbit,
    RelativeOrbit,
    eccentric_anomaly,
)
from rpod_schemas.arrays import FloatArray

SEMI_MAJOR_AXIS_M = 7.144e6
LEAST_M, GREATEST_M = 25.0, 53.0
TIMES_S = 50.0 * np.arange(241)


def target_orbit(*, latitude_deg: float = 110.0, eccentricity: float = 0.0) -> MeanOrbit:
    perigee_rad = 0.0 if eccentricity == 0.0 else pi / 2.0
    return MeanOrbit(
        semi_major_axis_m=SEMI_MAJOR_AXIS_M,
        eccentricity=eccentricity,
        inclination_rad=np.deg2rad(98.5).item(),
        node_rad=0.4,
        perigee_rad=perigee_rad,
        mean_anomaly_rad=np.deg2rad(latitude_deg).item() - perigee_rad,
    )


def ellipse_about(target: MeanOrbit) -> RelativeOrbit:
    return RelativeOrbit.safety_ellipse(
        target, radial_m=LEAST_M, cross_track_m=sqrt(GREATEST_M**2 - 4.0 * LEAST_M**2)
    )


def separations_m(orbit: RelativeOrbit) -> FloatArray:
    return np.array([orbit.separation(time_s)[0] for time_s in TIMES_S.tolist()])


def acceleration_m_s2(position_m: FloatArray) -> FloatArray:
    """Return the acceleration of a point mass with J2."""
    radius_m = np.linalg.norm(position_m)
    up2 = 5.0 * (position_m[2] / radius_m) ** 2
    oblate = 1.5 * EARTH_J2 * (EARTH_RADIUS_M / radius_m) ** 2 * np.array([1.0 - up2, 1.0 - up2, 3.0 - up2])
    return np.asarray(-EARTH_MU_M3_S2 / radius_m**3 * position_m * (1.0 + oblate))


def propagated(state: FloatArray) -> FloatArray:
    """Return positions and velocities, shape (241, 6), from an osculating state, shape (6,)."""
    solution = solve_ivp(
        lambda _, y: np.r_[y[3:], acceleration_m_s2(y[:3])],
        (0.0, TIMES_S[-1]),
        state,
        method="DOP853",
        t_eval=TIMES_S,
        rtol=1e-13,
        atol=1e-8,
    )
    return np.asarray(solution.y.T)


def osculating_state(orbit: MeanOrbit) -> FloatArray:
    """Return position and velocity with the first-order short-period terms of J2, for a mean circle.

    Source: F. R. Hoots, R. L. Roehrich, Spacetrack Report No. 3 (1980), section 6 (after Lane and Cranford).
    """
    a, i, n = orbit.semi_major_axis_m, orbit.inclination_rad, orbit.mean_motion_rad_s
    u, c = orbit.perigee_rad + orbit.mean_anomaly_rad, cos(orbit.inclination_rad)
    k = 0.5 * EARTH_J2 * (EARTH_RADIUS_M / a) ** 2
    radius_m = a * (1.0 - 1.5 * k * (3.0 * c * c - 1.0) + 0.5 * k * (1.0 - c * c) * cos(2.0 * u))
    radial_m_s = -k * n * a * (1.0 - c * c) * sin(2.0 * u)
    along_m_s = n * a * (1.0 + k * ((1.0 - c * c) * cos(2.0 * u) - 1.5 * (1.0 - 3.0 * c * c)))
    node = orbit.node_rad + 1.5 * k * c * sin(2.0 * u)
    i += 1.5 * k * c * sin(i) * cos(2.0 * u)
    u -= 0.25 * k * (7.0 * c * c - 1.0) * sin(2.0 * u)
    node_axis, quarter_axis = [cos(node), sin(node), 0.0], [-sin(node) * cos(i), cos(node) * cos(i), sin(i)]
    plane = np.array([node_axis, quarter_axis])
    radius, track = np.array([cos(u), sin(u)]) @ plane, np.array([-sin(u), cos(u)]) @ plane
    return np.concatenate([radius_m * radius, radial_m_s * radius + along_m_s * track])


def seen_from_target_m(target: FloatArray, chaser: FloatArray) -> FloatArray:
    """Return separations in the target's local axes, shape (241, 3), from states of shape (241, 6)."""
    x = target[:, :3] / np.linalg.norm(target[:, :3], axis=1, keepdims=True)
    z = np.cross(target[:, :3], target[:, 3:])
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    separation = chaser[:, :3] - target[:, :3]
    return np.stack([(separation * axis).sum(axis=1) for axis in (x, np.cross(z, x), z)], axis=1)


@cache
def disagreement_m(latitude_deg: float) -> float:
    """Return the largest distance over two orbits of the model from the best numerical trajectory.

    The target starts from its mean elements with their short-period terms; the chaser's state relative to it
    is the one of which the trajectory fits the model best, since a difference of semi-major axes of 5 cm, as
    the short-period terms beyond these formulas make it, drifts by a metre.
    """
    orbit = ellipse_about(target_orbit(latitude_deg=latitude_deg))
    target, model = propagated(osculating_state(orbit.target)), separations_m(orbit)
    mean_target, mean_chaser = orbit.target.state(0.0), orbit.chaser.state(0.0)
    chaser = (
        target[0]
        + np.r_[
            mean_chaser.position_m - mean_target.position_m,
            mean_chaser.velocity_m_s - mean_target.velocity_m_s,
        ]
    )
    steps = np.diag([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
    first = seen_from_target_m(target, propagated(chaser))
    sensitivity = [seen_from_target_m(target, propagated(chaser + step)) - first for step in steps]
    shares = np.linalg.lstsq(np.reshape(sensitivity, (6, -1)).T, (model - first).ravel(), rcond=None)[0]
    best = seen_from_target_m(target, propagated(chaser + shares @ steps))
    return float(np.linalg.norm(best - model, axis=1).max())


@pytest.mark.parametrize("latitude_deg", [90.0, 227.0])
def test_a_spacecraft_about_the_oblate_earth_follows_the_ellipse_to_two_centimetres(
    latitude_deg: float,
) -> None:
    assert disagreement_m(latitude_deg) < 0.02


def test_the_mean_orbit_stays_within_the_short_period_terms_of_the_propagated_one() -> None:
    orbit = target_orbit()
    numerical_m = propagated(osculating_state(orbit))[:, :3]
    mean_m = np.array([orbit.state(time_s).position_m for time_s in TIMES_S.tolist()])
    assert np.linalg.norm(numerical_m - mean_m, axis=1).max() < 7e3  # J2 R^2 / a is 6.2 km


@pytest.mark.parametrize("eccentricity", [0.0, 1e-3])
def test_the_ellipse_neither_drifts_nor_grows_within_two_orbits(eccentricity: float) -> None:
    orbit = ellipse_about(target_orbit(eccentricity=eccentricity))
    path_m = separations_m(orbit)
    first, second = path_m[:120], path_m[120:240]
    np.testing.assert_allclose(second.mean(axis=0), first.mean(axis=0), atol=0.1)
    tolerance_m = 5e-3 if eccentricity == 0.0 else 0.3
    ranges_m = np.linalg.norm(path_m, axis=1)
    assert ranges_m.min() == pytest.approx(LEAST_M, abs=tolerance_m)
    assert ranges_m.max() == pytest.approx(GREATEST_M, abs=tolerance_m)


def test_the_nodes_drift_as_those_of_a_sun_synchronous_orbit() -> None:
    orbit = target_orbit()
    assert np.rad2deg(orbit.rates_rad_s[0]) * 86400.0 == pytest.approx(360.0 / 365.24, abs=0.01)
    assert 2.0 * pi / sum(orbit.rates_rad_s[1:]) / 60.0 == pytest.approx(100.27, abs=0.01)


@given(
    time_s=st.floats(-100.0, 12e3),
    latitude_deg=st.floats(0.0, 360.0),
    eccentricity=st.sampled_from([0.0, 0.05]),
)
def test_velocities_are_the_derivatives_of_positions(
    time_s: float, latitude_deg: float, eccentricity: float
) -> None:
    orbit = ellipse_about(target_orbit(latitude_deg=latitude_deg, eccentricity=eccentricity))
    before, after = (orbit.target.state(time_s + step).position_m for step in (-0.5, 0.5))
    np.testing.assert_allclose(orbit.target.state(time_s).velocity_m_s, after - before, atol=1e-3)
    closer, farther = (orbit.separation(time_s + step)[0] for step in (-0.5, 0.5))
    np.testing.assert_allclose(orbit.separation(time_s)[1], farther - closer, atol=1e-7)


@given(mean_anomaly_rad=st.floats(-20.0, 20.0), eccentricity=st.floats(0.0, 0.7))
def test_keplers_equation_is_solved(mean_anomaly_rad: float, eccentricity: float) -> None:
    E = eccentric_anomaly(mean_anomaly_rad, eccentricity)
    assert E - eccentricity * sin(E) == pytest.approx(mean_anomaly_rad, abs=1e-13)


def test_radius_and_track_follow_from_the_elements() -> None:
    orbit = target_orbit(latitude_deg=0.0)
    state = orbit.state(0.0)
    np.testing.assert_allclose(state.position_m, SEMI_MAJOR_AXIS_M * np.array([cos(0.4), sin(0.4), 0.0]))
    assert atan2(state.velocity_m_s[2], -state.velocity_m_s[:2] @ [-sin(0.4), cos(0.4)]) == pytest.approx(
        pi - orbit.inclination_rad, abs=1e-3
    )
