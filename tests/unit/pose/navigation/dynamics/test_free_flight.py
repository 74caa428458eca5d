"""Tracks through gaps on synthetic measurements: a small form of ``make free-flight``."""

from dataclasses import replace

import numpy as np
import pytest

from free_flight.course import AT_THEIR_WORD, Course, fly
from rpod_motion.imu import Imu
from rpod_pose.navigation.dynamics.free_motion import CENTRE_OF_MASS, GYRO_BIAS, INERTIA
from rpod_pose.navigation.dynamics.options import Dynamics, evidence_of
from rpod_pose.navigation.dynamics.slewing import CHASER_TURNS, turns
from rpod_pose.navigation.integrity.declared_states import declared_tests
from rpod_pose.navigation.integrity.refused import turning_solutions
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator.dynamics import DynamicsConfig
from rpod_schemas.config.motion import ImuNoiseConfig
from rpod_schemas.errors import ConfigurationError
from rpod_target import Equivalence, Symmetry, load_target

TORQUE_FREE = {"target": "torque_free"}
ENVISAT, MOCKUP = load_target("envisat-bulky"), load_target("mockup")
SCANS = Course(ENVISAT, 5.0, TORQUE_FREE, range_m=40.0, scans_hz=1.0, sigma_m=0.02, tracked_s=120.0)
CAMERA = Course(MOCKUP, 8.0, TORQUE_FREE, scans_hz=5.0, tracked_s=40.0)


def sigmas(state, name):
    return np.sqrt(np.diag(state.covariance)[state.places()[name]])


@pytest.mark.parametrize("moments", [(1.0, 1.0, 1.0), (1.0, 1.0, 1.2), (1.0, 0.8, 1.0)])
def test_the_attitude_is_predicted_for_a_minute_whether_or_not_the_inertia_is_right(moments):
    found = [fly(replace(SCANS, moments=moments, gap_s=60.0), seed) for seed in (1, 2)]
    assert max(each.attitude_deg for each in found) < 0.3
    assert max(each.nees for each in found) < 20.0


@pytest.mark.parametrize("course", [SCANS, CAMERA], ids=["scans", "camera"])
def test_a_gap_of_half_a_minute_costs_little_although_centre_and_inertia_are_wrong(course):
    unsure = {**TORQUE_FREE, "centre_of_mass_sigma_m": 0.05}
    wrong = replace(course, dynamics=unsure, moments=(1.0, 1.0, 1.2), centre_off_m=(0.05, -0.03, 0.04))
    found = fly(wrong, 3)
    assert found.attitude_deg < 0.3
    assert found.position_m < 0.03
    assert found.nees < 20.0
    assert sigmas(found.state, CENTRE_OF_MASS).max() < 0.02


@pytest.mark.parametrize(
    ("moments", "declared", "is_told"),
    [
        ((1.0, 1.0, 1.0), 0.1, False),
        ((1.0, 1.0, 1.2), 0.1, False),
        ((0.4, 1.0, 0.8), 0.1, True),
        ((0.4, 1.0, 0.8), 0.4, False),
    ],
)
def test_an_inertia_that_contradicts_what_is_declared_of_it_is_told(moments, declared, is_told):
    wrong = replace(CAMERA, dynamics={**TORQUE_FREE, "inertia_sigma": declared}, moments=moments, gap_s=0.0)
    (test,) = declared_tests(fly(wrong, 3).state)
    assert test.exceeds_risk(1e-6) is is_told
    assert test.describe(1e-6).endswith(
        "; correct inertia_kg_m2 of the target's file, or raise dynamics.inertia_sigma"
    )


def test_a_centre_of_mass_that_contradicts_what_is_declared_of_it_is_told():
    unsure = {**TORQUE_FREE, "centre_of_mass_sigma_m": 0.02}
    for off_m, is_told in (((0.02, -0.02, 0.01), False), ((0.2, -0.2, 0.1), True)):
        course = replace(SCANS, dynamics=unsure, centre_off_m=off_m, gap_s=0.0)
        centre, _ = declared_tests(fly(course, 3).state)
        assert centre.exceeds_risk(1e-6) is is_told
        assert "m expected by what is declared" in centre.name


@pytest.mark.parametrize("is_inverted", [False, True])
def test_a_star_tracker_that_contradicts_the_gyro_is_told(is_inverted, monkeypatch):
    """The chaser turns with its orbit; inverted, its attitude is stated as that of the orbit in its axes."""
    reading = Imu.reading

    def stated(self, stamp_ns, time_s):
        true = reading(self, stamp_ns, time_s)
        R = true.R_orbit_chaser.inv() if is_inverted else true.R_orbit_chaser
        return true.model_copy(update={"R_orbit_chaser": R})

    monkeypatch.setattr(Imu, "reading", stated)
    tracker = ImuNoiseConfig(rate_hz=10.0, star_tracker_sigma_deg=0.01)
    dynamics = {"orbit": {"period_s": 6009.6}, "imu": {}}
    course = replace(SCANS, dynamics=dynamics, imu=tracker, in_orbit=True, tracked_s=20.0, gap_s=0.0)
    (test,) = declared_tests(fly(course, 1).state)
    assert test.exceeds_risk(1e-6) is is_inverted
    assert test.name.startswith("the gyro's bias: estimated")


def test_without_eulers_equations_the_same_gap_loses_the_attitude():
    assert fly(replace(SCANS, dynamics={}, filter=AT_THEIR_WORD), 3).attitude_deg > 3.0


def test_what_a_pure_spin_does_not_tell_keeps_its_prior():
    _, axes = np.linalg.eigh(ENVISAT.inertia_kg_m2)
    spin = replace(SCANS, axis=tuple(axes[:, 2]), dynamics={**TORQUE_FREE, "centre_of_mass_sigma_m": 0.05})
    state = fly(spin, 1).state
    place = state.places()[CENTRE_OF_MASS]
    P = state.covariance[place, place]
    assert np.sqrt(axes[:, 2] @ P @ axes[:, 2]) > 0.95 * 0.05
    assert np.sqrt(axes[:, 0] @ P @ axes[:, 0]) < 0.3 * 0.05
    assert np.linalg.norm(sigmas(state, INERTIA)) > 0.9 * 0.1


def test_a_slew_costs_nothing_with_the_gyro_whose_bias_is_a_state():
    gyro = replace(CAMERA, dynamics={**TORQUE_FREE, "imu": {}}, imu=ImuNoiseConfig(rate_hz=10.0))
    still, slewing = fly(gyro, 5), fly(replace(gyro, slews=True), 5)
    assert slewing.tracked_deg < 1.1 * still.tracked_deg
    assert slewing.tracked_m < 1.1 * still.tracked_m
    assert slewing.attitude_deg < 0.3
    off = slewing.state.blocks[-1].value - slewing.imu.gyro_bias_rad_s
    assert (np.abs(off) < 4.0 * sigmas(slewing.state, GYRO_BIAS)).all()
    assert sigmas(slewing.state, GYRO_BIAS).min() < 0.9 * np.radians(0.003)


def test_a_slew_without_a_gyro_is_survived_and_told():
    """Worst errors without the model of decision 154: more than 20 deg, or the target is lost."""
    course = replace(SCANS, slews=True, gap_s=0.0, filter=AT_THEIR_WORD)
    slewing = fly(course, 2)
    assert turns(slewing.state)
    assert evidence_of(slewing.state)[CHASER_TURNS] == 1.0
    assert slewing.worst_deg < 3.0
    assert slewing.tracked_deg < 0.4
    assert 1.0 < slewing.tracked_nees < 12.0
    assert not turns(fly(replace(course, slews=False), 2).state)


def test_a_level_contains_the_estimate_of_a_chaser_that_turns_before_this_is_known():
    """Until the poses decide, the track and the filter beside it may both be right."""
    track = fly(replace(CAMERA, slews=True, tracked_s=5.0, gap_s=0.0, filter=AT_THEIR_WORD), 1).state
    assert not turns(track)
    (found,) = turning_solutions(track, AT_THEIR_WORD, 1e-4)
    assert np.degrees(np.linalg.norm(found.separation[3:])) > 0.05
    assert 1e-4 / (1.0 + 1e-4) <= found.probability < 1.0
    likely = replace(track, other=replace(track.other, log_odds=12.0))
    assert turning_solutions(likely, AT_THEIR_WORD, 1e-4)[0].probability > 0.9
    assert turning_solutions(replace(track, other=None), AT_THEIR_WORD, 1e-4) == []


def test_a_chaser_that_holds_its_attitude_again_bridges_gaps_again():
    """It slews once, and then holds the new attitude: the model of a held attitude returns."""
    found = fly(
        replace(CAMERA, rate_deg_s=5.0, slews=True, holds_again=True, tracked_s=90.0, scans_hz=1.0), 1
    )
    assert not turns(found.state)
    assert found.attitude_deg < 0.5
    assert found.worst_deg < 3.0


def test_thrust_that_is_measured_is_not_noise():
    forced = {**TORQUE_FREE, "imu": {"acceleration_bias_sigma_m_s2": 1e-4}}
    precise = ImuNoiseConfig(
        rate_hz=10.0, acceleration_noise_m_s_sqrt_s=3e-5, acceleration_bias_sigma_m_s2=1e-4
    )
    found = fly(replace(CAMERA, dynamics=forced, imu=precise, slews=True, filter=AT_THEIR_WORD), 2)
    assert found.position_m < 0.03
    assert found.nees < 20.0


@pytest.mark.parametrize("stated", [True, False])
def test_the_noise_of_an_accelerometer_is_in_the_prediction(stated, monkeypatch):
    """A tactical one drifts by 0.1 m in half a minute; thrust that is measured is known no better."""
    forced = {**TORQUE_FREE, "imu": {"acceleration_bias_sigma_m_s2": 1e-4}}
    tactical = ImuNoiseConfig(
        rate_hz=10.0, acceleration_noise_m_s_sqrt_s=1e-3, acceleration_bias_sigma_m_s2=1e-4
    )
    if not stated:
        read = Imu.reading
        monkeypatch.setattr(
            Imu, "reading", lambda *args: read(*args).model_copy(update={"force_variance": 0.0})
        )
    course = replace(CAMERA, dynamics=forced, imu=tactical, slews=True, filter=AT_THEIR_WORD)
    found = [fly(course, seed) for seed in (1, 2, 3)]
    assert np.mean([each.nees for each in found]) < 12.0
    assert 0.05 < found[0].sigma_m < 0.3


def test_a_relative_orbit_is_predicted_with_the_attitude_of_the_star_tracker():
    tracker = ImuNoiseConfig(rate_hz=10.0, star_tracker_sigma_deg=0.01)
    orbit = {"orbit": {"period_s": 6009.6}, "imu": {}, **TORQUE_FREE}
    course = replace(SCANS, dynamics=orbit, imu=tracker, in_orbit=True, gap_s=60.0)
    with_orbit = fly(course, 1)
    assert with_orbit.position_m < 0.1
    assert with_orbit.nees < 20.0


def test_an_orbit_without_an_attitude_in_it_is_refused():
    with pytest.raises(
        ConfigurationError, match=r"attitude in the orbital frame .* set orbit\.R_orbit_chaser"
    ):
        check(DynamicsConfig, {"orbit": {"period_s": 6000.0}}, source="here")


def test_an_orbit_that_no_body_can_have_is_refused():
    orbit = {"period_s": 100.0, "R_orbit_chaser": {"quaternion_xyzw": [0, 0, 0, 1]}}  # in minutes
    with pytest.raises(
        ConfigurationError, match=r"orbit.period_s: is 100 s, needs 3600 s or more: .* seconds"
    ):
        check(DynamicsConfig, {"orbit": orbit}, source="here")


def test_a_body_of_revolution_is_not_predicted_without_torque():
    free = Equivalence.of([Symmetry((0.0, 0.0, 1.0), 1, exact=True, continuous=True)])
    target = replace(MOCKUP, symmetries=())
    object.__setattr__(target, "equivalence", free)
    with pytest.raises(ConfigurationError, match="use constant_rate"):
        Dynamics.of(DynamicsConfig(target="torque_free"), target)


def test_the_status_tells_the_further_states():
    state = fly(replace(CAMERA, tracked_s=2.0, gap_s=0.0), 1).state
    assert set(evidence_of(state)) == {INERTIA, f"{INERTIA}_sigma"}
