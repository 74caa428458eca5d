"""The integrity monitor: levels, tests and states, on tracks whose errors are known."""

import re
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pytest
from navigator_rig import Slow
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from rpod_pose.navigation.filter import POSE, innovation_of, start
from rpod_pose.navigation.history import History, apply
from rpod_pose.navigation.integrity.frame_evidence import FrameEvidence
from rpod_pose.navigation.integrity.levels import (
    LevelsOf,
    Solution,
    declared_covariance,
    protection_levels,
)
from rpod_pose.navigation.integrity.monitor import (
    DECLARED_ONLY,
    SIZE_BELIEVED,
    SIZE_DECLARED,
    Memory,
    Monitor,
)
from rpod_pose.navigation.integrity.refused import refused_solutions
from rpod_pose.navigation.integrity.residuals import (
    APART,
    DECLARED,
    LIVELY,
    Residual,
    lasting_errors,
    residual_of,
    residual_tests,
)
from rpod_pose.navigation.integrity.sizes import shifts_of, sized_after
from rpod_pose.navigation.integrity.wrong_streams import CLOCK_MOVED_S
from rpod_pose.navigation.pose_measurement import Origin, PoseMeasurement
from rpod_pose.navigation.sensors.streams import Stream
from rpod_pose.navigation.state import Cause, NavigatorState, Output
from rpod_pose.ports import Registration
from rpod_pose.pose_evidence import Misfit, OtherSize, PartSolution
from rpod_schemas.config.estimator import EstimatorSettings, LidarInput, PmdInput
from rpod_schemas.config.estimator.filter import FilterConfig, FilterTuning
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.poses import make_pose
from rpod_schemas.types import EstimatorStatus, IntegrityState, Mode, Odometry, Source
from rpod_target.equivalence import Equivalence

SECOND_NS = 1_000_000_000
CONFIG = FilterConfig(acceleration_density_m2_s3=1e-5, angular_acceleration_density_rad2_s3=1e-6)
SIGMA = SIGMA_M, SIGMA_RAD = 0.002, 0.002
COVARIANCE = np.diag([SIGMA_M**2] * 3 + [SIGMA_RAD**2] * 3)
NO_FLOORS = CONFIG.model_copy(update={"position_floor_m": 0.0, "attitude_floor_deg": 0.0})
NOTHING_UNSEEN = IntegrityConfig(
    mount_sigma_deg=0.0, mount_sigma_m=0.0, clock_sigma_s=0.0, tuning={"range_share": 0.0}
)
START_NS = 100 * SECOND_NS
TEN_M = np.array([0.0, 0.0, 10.0])


def truth(time_s):
    """Return T_chaser_target: 0.2 m/s nearer, and 2 deg/s about x."""
    return make_pose(
        rotation=Rotation.from_rotvec([np.deg2rad(2.0) * time_s, 0.0, 0.0]),
        translation_m=(0.0, 0.0, 6.0 - 0.2 * time_s),
    )


def length_of(covariance, probability):
    """Return the length that a normal vector with a covariance exceeds with a probability."""
    filled = np.zeros((6, 6))
    filled[:3, :3] = covariance
    return protection_levels(
        [Solution("", np.zeros(6), filled)], np.zeros((6, 6)), 2 * probability
    ).position_m


def levels_of(solutions, config, *how):
    """Return the levels with a configuration's declared errors at a place, velocity and rate."""
    return protection_levels(solutions, declared_covariance(config, *how), config.risk)


@dataclass
class Track:
    """A navigator's state, measurement by measurement, and the monitor that reads it."""

    monitor: Monitor
    noise: np.random.Generator
    memory: Memory = field(default_factory=Memory)
    config: FilterConfig = CONFIG
    state: NavigatorState = field(default_factory=NavigatorState)

    def measure(
        self, time_s, *, sensor="pmd", off=None, frozen=False, accepted=True, alone=False, sigma=SIGMA
    ):
        """Apply a pose of a sensor with noise, ``off`` by a pose; return the integrity."""
        pose = truth(time_s) * (make_pose() if off is None else off)
        error = self.noise.standard_normal(6) * np.repeat(sigma, 3)
        covariance = np.diag(np.repeat(sigma, 3) ** 2)
        pose = make_pose(
            rotation=Rotation.from_rotvec(error[3:]) * pose.rotation,
            translation_m=pose.translation + error[:3],
        )
        stamp_ns = START_NS + round(time_s * SECOND_NS)
        measured, nis = PoseMeasurement(stamp_ns, pose, covariance, alone=alone), float("nan")
        if self.state.history is None:
            filtered = start(pose, covariance, stamp_ns, config=self.config)
            self.state = NavigatorState(mode=Mode.TRACKING, history=History(filtered))
        elif accepted:
            grown, nis, accepted = apply(self.state.history, measured, self.config)
            self.state = replace(self.state, history=grown)
        return self.judge(stamp_ns, sensor=sensor, nis=nis, accepted=accepted, frozen=frozen)

    def judge(
        self, stamp_ns, *, sensor, nis=float("nan"), accepted=True, frozen=False, cause=Cause.OTHER, **told
    ):
        newest = self.state.history.state
        odometry = Odometry(
            stamp_ns=max(stamp_ns, newest.stamp_ns), frame_id="chaser", child_frame_id="target_estimate",
            pose=newest.T_chaser_target, linear_m_s=np.zeros(3), angular_rad_s=np.zeros(3),
            pose_covariance=newest.covariance[POSE, POSE],
        )  # fmt: skip
        told = {"reason": "" if accepted else "too few pixels"} | told
        status = EstimatorStatus(
            stamp_ns=stamp_ns, frame_id="chaser", mode=self.state.mode, sensor=sensor, nis=nis,
            accepted=accepted, **told,
        )  # fmt: skip
        output = Output(status, odometry if self.state.mode is Mode.TRACKING else None, cause=cause)
        self.memory, integrity = self.monitor.assess(self.memory, self.state, output, frozen=frozen)
        return integrity


@pytest.fixture
def track():
    settings = EstimatorSettings(sensors=(PmdInput(), LidarInput()), filter=CONFIG)
    return Track(Monitor(settings), np.random.default_rng(7))


def follow(track, times_s, **how):
    return [track.measure(time_s, **how) for time_s in times_s]


PMD_S = np.arange(0.0, 6.0, 0.1)


def test_a_good_track_becomes_nominal_with_levels_that_hold_its_errors(track):
    told = follow(track, PMD_S)[20:]
    assert {each.state for each in told} == {IntegrityState.NOMINAL}
    newest = track.state.history.state.T_chaser_target
    error_m = np.linalg.norm(newest.translation - truth(PMD_S[-1]).translation)
    assert error_m < told[-1].position_level_m < 0.03 == told[-1].position_limit_m
    assert told[-1].attitude_level_deg < 1.0
    assert told[-1].reason == ""


def test_without_a_track_integrity_is_unavailable_and_levels_are_unknown(track):
    follow(track, PMD_S)
    track.state = replace(track.state, mode=Mode.LOST)
    told = track.judge(START_NS + 7 * SECOND_NS, sensor="pmd")
    assert (told.state, told.reason) == (IntegrityState.UNAVAILABLE, "the target is not tracked: LOST")
    assert np.isnan(told.attitude_level_deg)


def test_a_level_above_the_alert_limit_makes_the_estimate_unavailable_and_says_which(track):
    follow(track, PMD_S)
    refused = track.measure(6.0, accepted=False)
    assert (refused.state, refused.reason) == (
        IntegrityState.CAUTION,
        "the newest measurement is not used: too few pixels",
    )
    newest = track.state.history.state
    track.state = replace(
        track.state, history=History(replace(newest, covariance=newest.covariance + 1e-4 * np.eye(12)))
    )
    told = track.judge(newest.stamp_ns, sensor="pmd")
    assert told.state is IntegrityState.UNAVAILABLE
    assert told.attitude_level_deg > told.attitude_limit_deg == 1.0
    assert "protection level of the attitude" in told.reason


def test_a_track_that_jumps_to_a_half_turn_is_an_alert_for_as_long_as_both_may_be_right(track):
    follow(track, PMD_S)
    flip = make_pose(rotation=Rotation.from_rotvec([0.0, np.pi, 0.0]))
    there = truth(6.0) * flip
    track.state = replace(
        track.state, history=History(start(there, COVARIANCE, START_NS + 6 * SECOND_NS, config=CONFIG))
    )
    told = follow(track, np.arange(6.1, 40.0, 0.5), off=flip)
    assert {each.state for each in told} == {IntegrityState.ALERT}
    assert "the estimate and its prediction from before" in told[0].reason


def test_a_sensor_that_is_out_of_its_range_is_no_reason_for_caution(track):
    follow(track, PMD_S)
    told = track.judge(START_NS + 6 * SECOND_NS, sensor="lidar", accepted=False, cause=Cause.OUT_OF_RANGE)
    assert told.state is IntegrityState.NOMINAL


def test_a_level_contains_the_measurement_that_the_gate_refuses(track):
    follow(track, PMD_S)
    off_m = 0.1
    told = track.measure(6.0, off=make_pose(translation_m=(0.0, 0.0, off_m)))
    assert not track.state.history.steps[-1].outcome.accepted
    # whether the target moved or the measurement is wrong, the estimate is within the level
    assert off_m < told.position_level_m < off_m + 0.05
    assert told.state is IntegrityState.UNAVAILABLE
    assert "refused measurement" in told.reason


def test_the_refused_measurement_of_a_target_with_a_free_axis_leaves_a_level():
    alike = Equivalence(np.eye(3)[None], np.array([[0.0, 1.0, 0.0]]))
    filtered = start(truth(0.0), COVARIANCE, START_NS, config=CONFIG, alike=alike)
    off = truth(0.0) * make_pose(translation_m=(0.0, 0.0, 30.0))
    history = apply(History(filtered), PoseMeasurement(START_NS + SECOND_NS, off, COVARIANCE), CONFIG).history
    (solution,) = refused_solutions(history, 0.01)
    about_the_axis, *others = np.linalg.eigvalsh(solution.covariance[3:, 3:])
    assert about_the_axis == pytest.approx(0.0, abs=1e-15)
    assert others == pytest.approx([SIGMA_RAD**2] * 2, rel=10.0)


def test_a_frozen_stream_is_an_alert_until_it_moves_again(track):
    follow(track, PMD_S)
    told = track.judge(START_NS + 6 * SECOND_NS, sensor="pmd", accepted=False, frozen=True)
    assert (told.state, told.reason) == (
        IntegrityState.ALERT,
        "pmd: frozen, its last frames are identical, or those of an earlier time",
    )
    assert track.measure(6.1).state is IntegrityState.NOMINAL


def test_a_frozen_sensor_that_is_switched_off_is_no_alert_for_the_others(track):
    follow(track, PMD_S)
    track.judge(START_NS + 6 * SECOND_NS, sensor="pmd", accepted=False, frozen=True)
    assert track.measure(6.1, sensor="lidar").state is IntegrityState.ALERT
    assert "frozen" not in track.measure(8.6, sensor="lidar").reason


def set_back(track, time_s, **how):
    """Return the integrity after a frame whose clock was set back by 50 ms."""
    stamp_ns = START_NS + round((time_s - 0.05) * SECOND_NS)
    return track.judge(stamp_ns, sensor="pmd", evidence={CLOCK_MOVED_S: -0.05}, **how)


def test_a_clock_that_was_set_is_an_alert_that_names_it_until_its_stamps_are_as_before(track):
    follow(track, PMD_S)
    told = set_back(track, 6.0, accepted=False, reason="clock_step: its stamps have moved")
    assert told.state is IntegrityState.ALERT
    assert told.reason.startswith("pmd: its stamps have moved by -0.050 s against their arrival")
    assert track.measure(6.1).state is IntegrityState.NOMINAL


def test_a_clock_whose_new_stamps_are_used_is_an_alert_for_a_minute(track):
    follow(track, PMD_S)
    set_back(track, 6.0, accepted=False, reason="clock_step: its stamps have moved")
    assert set_back(track, 6.1).state is IntegrityState.ALERT
    told = track.measure(8.0)
    assert told.state is IntegrityState.ALERT
    assert told.reason.startswith("2.1 s ago: the stamps of pmd have moved by -0.050 s")
    assert "a reset ends this alert" in told.reason
    assert "stamps of pmd" not in follow(track, np.arange(65.0, 68.0, 0.1))[-1].reason


def test_two_sensors_that_differ_by_more_than_their_covariances_are_an_alert(track):
    follow(track, PMD_S)
    wrong = make_pose(rotation=Rotation.from_rotvec([0.0, np.deg2rad(1.0), 0.0]))
    told = []
    for k in range(60):
        told.append(track.measure(6.0 + 0.1 * k))
        told.append(track.measure(6.05 + 0.1 * k, sensor="lidar", off=wrong))
    assert told[-1].state is IntegrityState.ALERT
    good = Track(track.monitor, np.random.default_rng(8))
    fine = [good.measure(0.05 * k, sensor="pmd" if k % 2 else "lidar").state for k in range(120)][60:]
    assert IntegrityState.ALERT not in fine


def spin(time_s):
    """Return T_chaser_target of a calm spin at 8 deg/s."""
    turn = Rotation.from_rotvec([np.deg2rad(8.0) * time_s, 0.0, 0.0])
    return make_pose(rotation=turn, translation_m=(0.0, 0.0, 6.0))


@pytest.mark.parametrize("late_s", [0.05, -0.05, 0.0])
def test_stamps_50_ms_off_beside_another_sensor_are_an_alert_that_names_clock_and_mount(late_s, monkeypatch):
    monkeypatch.setitem(globals(), "truth", spin)
    stated = {
        "attitude_floor_deg": 0.0,
        "position_floor_m": 0.0,
        "tuning": FilterTuning(correlation_inflation=1.0),
    }
    config = CONFIG.model_copy(update=stated)
    settings = EstimatorSettings(sensors=(PmdInput(), LidarInput()), filter=config)
    track = Track(Monitor(settings), np.random.default_rng(7), config=config)
    off = spin(0.0).inv() * spin(-late_s)
    told = []
    for k in range(100):
        track.measure(0.1 * k + 0.05, sensor="lidar")
        told.append(track.measure(0.1 * k + 0.1, off=off))
    if not late_s:
        assert IntegrityState.ALERT not in {each.state for each in told}
        return
    alerts = [each for each in told if each.state is IntegrityState.ALERT]
    assert len(alerts) > 20
    alerts = [each for each in alerts if "differ by" in each.reason]
    found = re.search(r"differ by ([.\d]+) deg .*: mounts, or the stamps of pmd are (\d+) \+- (\d+) ms (\w+) "
                      r"against those of lidar", alerts[-1].reason)  # fmt: skip
    assert found is not None
    assert float(found[1]) == pytest.approx(0.4, abs=0.1)
    assert float(found[2]) == pytest.approx(50.0, abs=4.0 * float(found[3]))
    sigma_s = alerts[-1].evidence["pmd_against_lidar_stamps_late_sigma_s"]
    assert alerts[-1].evidence["pmd_against_lidar_stamps_late_s"] == pytest.approx(late_s, abs=4.0 * sigma_s)
    assert found[4] == ("late" if late_s > 0.0 else "early")


@pytest.mark.parametrize("late_s", [0.05, -0.05, 0.0])
def test_a_slow_sensor_tells_the_clock_of_a_fast_one_by_all_its_scans(late_s, monkeypatch):
    """Between scans the target may accelerate: a filter of the LIDAR alone knows the clock to 70 ms."""
    monkeypatch.setitem(globals(), "truth", spin)
    tuning = FilterTuning(correlation_inflation=1.0)
    config = FilterConfig(attitude_floor_deg=0.0, position_floor_m=0.0, tuning=tuning)
    settings = EstimatorSettings(sensors=(PmdInput(), LidarInput()), filter=config)
    track, off = (
        Track(Monitor(settings), np.random.default_rng(7), config=config),
        spin(0.0).inv() * spin(-late_s),
    )
    told = []
    for k in range(50):
        told.append(track.measure(0.2 * k, off=off, sigma=(0.002, np.deg2rad(0.05))))
        if k % 5 == 0:
            told.append(track.measure(0.2 * k, sensor="lidar", sigma=(0.005, np.deg2rad(0.25))))
    offset_s, sigma_s = (
        told[-1].evidence[f"pmd_against_lidar_stamps_late_{name}s"] for name in ("", "sigma_")
    )
    assert sigma_s < 0.014
    assert offset_s == pytest.approx(late_s, abs=3.0 * sigma_s)
    assert told[-1].state in {IntegrityState.CAUTION, IntegrityState.ALERT}
    assert abs(8.0 * late_s) < told[-1].attitude_level_deg < 1.0
    if not late_s:
        assert IntegrityState.ALERT not in {each.state for each in told}
        assert told[-1].attitude_level_deg < 0.5
    silent = [track.measure(0.2 * k, off=off, sigma=(0.002, np.deg2rad(0.05))) for k in range(50, 80)]
    assert abs(8.0 * late_s) < silent[-1].attitude_level_deg


@pytest.mark.parametrize("late_s", [0.06, 0.0])
@pytest.mark.parametrize("delay", [0, 2])
def test_the_noise_of_a_fast_sensors_track_is_no_clock_of_a_sharp_slow_one(delay, late_s, monkeypatch):
    """Each scan is sharper than the track of the camera, and may arrive after newer images."""
    monkeypatch.setitem(globals(), "truth", spin)
    config = FilterConfig(
        attitude_floor_deg=0.0, position_floor_m=0.0, tuning=FilterTuning(correlation_inflation=1.0),
        acceleration_density_m2_s3=1e-3, angular_acceleration_density_rad2_s3=1e-6,
    )  # fmt: skip
    settings = EstimatorSettings(sensors=(PmdInput(), LidarInput()), filter=config)
    track = Track(Monitor(settings), np.random.default_rng(7), config=config)
    off, told = spin(0.0).inv() * spin(-late_s), []
    for k in range(80):
        told.append(track.measure(0.1 * k, off=off, sigma=(0.003, np.deg2rad(0.05))))
        if k % 5 == delay and k > delay:
            sharp = (0.0005, np.deg2rad(0.1))
            told.append(track.measure(0.1 * (k - delay), sensor="lidar", sigma=sharp))
    offset_s, sigma_s = (
        told[-1].evidence[f"pmd_against_lidar_stamps_late_{name}s"] for name in ("", "sigma_")
    )
    assert sigma_s < 0.015
    assert offset_s == pytest.approx(late_s, abs=3.0 * sigma_s)
    assert (IntegrityState.ALERT in {each.state for each in told}) is bool(late_s)
    if delay:
        return
    for k in range(40, 70):  # the LIDAR is silent, and nothing has answered which of both is right
        silent = track.measure(0.2 * k, off=off, sigma=(0.003, np.deg2rad(0.05)))
    assert (silent.state is IntegrityState.ALERT) is bool(late_s)
    assert ("stamps of pmd" in silent.reason) is bool(late_s)


def test_residuals_of_late_stamps_name_the_clock_and_its_offset():
    state = start(truth(0.0), 1e-2 * COVARIANCE, START_NS, config=CONFIG)
    state = replace(
        state,
        velocity_m_s=np.array([0.0, 0.0, -0.2]),
        rate_rad_s=np.array([np.deg2rad(2.0), 0.0, 0.0]),
        covariance=1e-8 * np.eye(12),
    )
    noise = np.random.default_rng(1)
    found = []
    for k in range(40):
        pose = truth(-0.5)  # half a second late
        shift_m = SIGMA_M * noise.standard_normal(3)
        pose = make_pose(rotation=pose.rotation, translation_m=pose.translation + shift_m)
        innovation = innovation_of(state, pose, COVARIANCE, config=CONFIG)
        found.append(residual_of(state, innovation, START_NS + k * SECOND_NS))
    (size, mean), evidence = residual_tests("pmd", found, dof=6, correlated_s=1.0)
    assert mean.exceeds_risk(1e-6)
    assert evidence["pmd_stamps_late_s"] == pytest.approx(0.5, abs=0.05)
    assert "stamps that are" in mean.describe(1e-6)
    assert size.dof == pytest.approx(6 * 40)


def test_a_clock_explains_at_most_all_of_a_test_and_is_named_for_the_test_that_it_explains():
    """The residuals of a body that turns to and fro have nearly no mean; late stamps explain 39 % of them."""
    late, size_of = np.array([4.0, 0.0, 0.0, 0.0, 0.0, 0.0]), np.array([8.0, 10.0, 0.0, 0.0, 0.0, 0.0])
    found = [
        Residual(START_NS + k * SECOND_NS, z=sign * size_of + 1e-3, late=sign * late)
        for k, sign in enumerate((1.0, -1.0, 1.0, -1.0))
    ]
    tests, evidence = residual_tests("pmd", found, dof=6, correlated_s=1.0)
    assert evidence["pmd_stamps_late_s"] == pytest.approx(2.0)
    assert [test.cause for test in tests] == [LIVELY, LIVELY]
    along = [replace(each, z=2.0 * each.late) for each in found]
    size, mean = residual_tests("pmd", along, dof=6, correlated_s=1.0)[0]
    assert size.cause == "; stamps that are 2.000 s late (sigma 0.125 s) explain 100%"
    assert mean.cause == LIVELY, "of a mean that is 0 nothing is to be explained"


def residuals_with(declared, generator, frames=6):
    """Return residuals, once a second, of a sensor beside another one whose declared errors are in them."""
    config = IntegrityConfig()
    state = start(truth(0.0), 1e-4 * COVARIANCE, START_NS, config=NO_FLOORS)
    found = []
    for k in range(frames):
        innovation = innovation_of(state, truth(0.0), COVARIANCE, config=NO_FLOORS, white=True)
        lasting = lasting_errors(state, innovation, config)
        noise = np.linalg.cholesky(innovation.covariance) @ generator.standard_normal(6)
        innovation = innovation._replace(difference=noise + lasting[DECLARED] @ declared)
        found.append(residual_of(state, innovation, START_NS + k * SECOND_NS, lasting))
    return found


def test_declared_errors_of_two_sensors_fail_no_test_more_often_than_its_risk():
    generator, risk, trials = np.random.default_rng(169), 0.02, 1500
    counts = {several: np.zeros(2) for several in (False, True)}
    for _ in range(trials):
        residuals = residuals_with(generator.standard_normal(8), generator)
        for several, count in counts.items():
            tests, _ = residual_tests("lidar", residuals, dof=6, correlated_s=1.0, several=several)
            count += [test.exceeds_risk(risk) for test in tests]
    assert (counts[True] / trials <= risk + 4.0 * np.sqrt(risk / trials)).all()
    assert counts[False][1] / trials > 0.2, "without what is declared, the mean would be an alert"


def test_an_error_far_beyond_what_is_declared_fails_the_test_of_the_mean():
    turned = np.zeros(8)
    turned[:3] = 30.0  # mounts 0.85 deg off about each axis
    residuals = residuals_with(turned, np.random.default_rng(1))
    (_, mean), _ = residual_tests("lidar", residuals, dof=6, correlated_s=1.0, several=True)
    assert mean.exceeds_risk(1e-6)
    assert mean.describe(1e-6).endswith(APART)


def test_frames_of_one_second_count_as_one_in_the_tests():
    state = start(truth(0.0), COVARIANCE, START_NS, config=CONFIG)
    innovation = innovation_of(state, truth(0.0), COVARIANCE, config=CONFIG)
    frames = [residual_of(state, innovation, START_NS + k) for k in range(45)]
    (size, _), _ = residual_tests("pmd", frames, dof=6, correlated_s=1.0)
    assert size.dof == pytest.approx(6.0, rel=1e-6)


@pytest.mark.parametrize("sigma", [1e-3, 1e-2])
def test_errors_exceed_their_level_as_rarely_as_the_risk_says(sigma):
    config = NOTHING_UNSEEN.model_copy(update={"risk": 0.02})
    alone = Solution("", np.zeros(6), sigma**2 * np.eye(6))
    levels = levels_of([alone], config, TEN_M, np.zeros(3), np.zeros(3))
    lengths = sigma * np.linalg.norm(np.random.default_rng(3).standard_normal((200_000, 3)), axis=1)
    assert np.mean(lengths > levels.position_m) == pytest.approx(0.02 / 2, rel=0.1)


def test_a_quantile_of_a_length_is_that_of_its_covariances_shape():
    flat, alike = np.diag([1.0, 0.09, 0.3]), np.eye(3)
    lengths = np.linalg.norm(np.random.default_rng(3).standard_normal((400_000, 3)) @ np.sqrt(flat), axis=1)
    assert np.mean(lengths > length_of(flat, 0.01)) == pytest.approx(0.01, rel=0.05)
    assert length_of(np.diag([4e-6, 0.0, 0.0]), 1e-6) == pytest.approx(9.784e-3, rel=1e-3)
    assert length_of(alike, 1e-6) == pytest.approx(5.538, rel=1e-3)
    assert length_of(np.zeros((3, 3)), 1e-6) == pytest.approx(0.0, abs=1e-9)


def test_the_risks_of_all_hypotheses_at_the_level_add_up_to_half_of_the_risk():
    sigmas, apart, shares = np.array([1.0, 2.0, 4.0]), np.array([0.0, 3.0, 6.0]), np.array([1.0, 0.2, 0.05])
    solutions = [
        Solution(str(k), np.r_[apart[k], np.zeros(5)], np.diag([sigmas[k] ** 2, 0, 0, 0, 0, 0]), shares[k])
        for k in range(3)
    ]
    level_m = protection_levels(solutions, np.zeros((6, 6)), 0.02).position_m
    risk = (shares * 2.0 * ndtr(-(level_m - apart) / sigmas)).sum()
    assert risk == pytest.approx(0.01, rel=0.02)
    assert risk <= 0.01


def test_a_hypothesis_that_is_less_probable_than_the_risk_has_no_part_in_the_level():
    alone = Solution("", np.zeros(6), 1e-6 * np.eye(6))
    far = Solution("far", np.r_[1.0, np.zeros(5)], 1e-6 * np.eye(6), 1e-7)
    assert protection_levels([alone, far], np.zeros((6, 6)), 1e-6).position_m < 0.01


def test_levels_do_not_depend_on_what_was_asked_before():
    generator = np.random.default_rng(3)
    noises = [generator.standard_normal((6, 6)) * 1e-2 for _ in range(4)]
    solutions = [
        Solution(str(k), 1e-2 * generator.standard_normal(6), noise @ noise.T, 0.3**k)
        for k, noise in enumerate(noises)
    ]
    levels = LevelsOf(1e-6 * np.eye(6), 1e-6)
    for chosen in (solutions[:2], solutions, solutions[::2], solutions):
        assert levels.by(chosen) == protection_levels(chosen, 1e-6 * np.eye(6), 1e-6)
    unknown = replace(solutions[1], covariance=np.full((6, 6), np.inf))
    assert np.isnan([levels.by([solutions[0], unknown]).position_m for _ in range(2)]).all()
    assert levels.by(solutions) == protection_levels(solutions, 1e-6 * np.eye(6), 1e-6)


def test_a_hypothesis_whose_covariance_is_not_known_leaves_no_level():
    alone, still = Solution("", np.zeros(6), 1e-12 * np.eye(6)), np.zeros(3)
    unknown = Solution("without lidar", np.zeros(6), np.full((6, 6), np.nan), 1e-4)
    levels = levels_of([alone, unknown], NOTHING_UNSEEN, TEN_M, still, still)
    assert np.isnan([levels.attitude_deg, levels.position_m]).all()
    assert levels.position_by == "without lidar"


def test_a_mounts_turn_and_a_drift_of_the_ranges_act_across_each_other():
    alone, still = [Solution("", np.zeros(6), 1e-12 * np.eye(6))], np.zeros(3)

    def level_m(mount_deg, share):
        declared = {"mount_sigma_deg": mount_deg, "tuning": {"range_share": share}}
        config = IntegrityConfig(mount_sigma_m=0.0, clock_sigma_s=0.0, **declared)
        return levels_of(alone, config, TEN_M, still, still).position_m

    across, along = level_m(0.05, 0.0), level_m(0.0, 5e-4)
    assert across == pytest.approx(5.386 * 10.0 * np.deg2rad(0.05), rel=1e-3)
    assert along == pytest.approx(5.026 * 0.005, rel=1e-3)
    assert max(across, along) < level_m(0.05, 5e-4) < np.hypot(across, along)


def test_a_second_sensor_takes_nothing_away_and_what_is_not_covered_is_told(track):
    for k in range(60):
        track.measure(0.1 * k)
        if k < 40:
            track.measure(0.1 * k + 0.05, sensor="lidar")
    told = track.measure(6.0)  # two seconds after the LIDAR's last frame
    assert told.state is IntegrityState.CAUTION
    assert told.reason.startswith(DECLARED_ONLY)
    assert "(without pmd)" in told.reason
    alone = Track(track.monitor, np.random.default_rng(7))
    single = follow(alone, np.arange(0.0, 6.05, 0.1))[-1]
    offset_s, sigma_s = (told.evidence[f"pmd_against_lidar_stamps_late_{name}s"] for name in ("", "sigma_"))
    with_clock_m = 0.2 * (abs(offset_s) + 4.0 * sigma_s)  # what is known of the clocks stays
    assert 0.8 * single.position_level_m < told.position_level_m < single.position_level_m + with_clock_m


def test_the_most_tolerant_limit_of_the_sensors_that_support_the_track_counts(track):
    told = follow(track, PMD_S)[-1]
    assert told.attitude_limit_deg == 1.0
    newest_ns = track.state.history.state.stamp_ns
    track.state = replace(
        track.state, streams={"lidar": Stream(newest_ns, SECOND_NS, accepted_ns=newest_ns - SECOND_NS)}
    )
    assert track.measure(6.0).attitude_limit_deg == 3.0
    assert track.measure(7.5).attitude_limit_deg == 1.0


def inside(**found):
    registration = Registration(Source.PMD_JOINT, **found)
    return FrameEvidence().after("pmd", START_NS, registration, 60.0)


def test_misfits_of_a_minute_are_tested_together_and_older_ones_forgotten():
    told = inside(misfit=Misfit(3.0, 1.0))
    (test,) = told.tests(10.0, 0.0)
    assert not test.exceeds_risk(1e-6)
    for k in range(1, 4):
        again = Registration(Source.LIDAR, misfit=Misfit(3.0, 1.0))
        told = told.after("pmd", START_NS + k * SECOND_NS, again, 60.0)
    (test,) = told.tests(10.0, 0.0)
    assert test.value == pytest.approx(12.0**2 / 4.0)
    assert test.exceeds_risk(1e-6)
    assert not told.after("pmd", START_NS + 70 * SECOND_NS, None, 60.0).misfits


@pytest.mark.parametrize(
    ("log_odds", "level_deg", "fails"), [(-2.0, 3.0, False), (-30.0, 2.0, False), (20.0, 3.0, True)]
)
def test_the_level_contains_another_size_until_the_frames_exclude_it(log_odds, level_deg, fails):
    began = start(truth(0.0), COVARIANCE, START_NS, config=CONFIG)
    estimate = replace(began, covariance=1e-12 * began.covariance)
    step = np.array([0.0, 0.0, 0.0, np.deg2rad(3.0), 0.0, 0.0])
    told = inside(other_sizes=lambda: (OtherSize(0.03, log_odds, step),))
    others, between = told.size_solutions(estimate, 1e-6, 1e-4, 1.0)
    still = np.zeros(3)
    alone = Solution("", np.zeros(6), 1e-12 * np.eye(6))
    levels = levels_of([alone, *others, *between], NOTHING_UNSEEN, TEN_M, still, still)
    assert levels.attitude_deg == pytest.approx(level_deg, abs=0.3)
    (test,) = told.tests(10.0, 0.0, 1.0)
    assert test.exceeds_risk(1e-6) == fails


@pytest.mark.parametrize(("log_odds", "sigmas"), [(-30.0, 3.37), (20.0, 5.67)])
def test_a_near_size_keeps_its_prior_and_counts_fully_where_frames_prefer_it(log_odds, sigmas):
    estimate = start(truth(0.0), COVARIANCE, START_NS, config=CONFIG)
    step, noise = np.deg2rad(3.0) * np.eye(6)[3], np.deg2rad(0.1) ** 2 * np.eye(6)
    told = inside(other_sizes=lambda: (OtherSize(0.01, log_odds, step, tests=False),))
    others, between = told.size_solutions(estimate, 1e-6, 1e-4, 1.0)
    near = [replace(each, covariance=noise) for each in (*others, *between)]
    levels = protection_levels([Solution("", np.zeros(6), noise), *near], np.zeros((6, 6)), 1e-6)
    assert levels.attitude_deg == pytest.approx(3.0 + 0.1 * sigmas, abs=0.06)
    assert not told.tests(10.0, 0.0, 1.0)


def test_the_shift_of_an_estimate_by_another_size_is_that_of_a_filter_of_shifted_poses():
    history, sized = History(start(truth(0.0), COVARIANCE, START_NS, config=CONFIG)), {}
    for k, turn_deg in enumerate((1.0, 1.0, 1.0, 1.0, 0.0), 1):
        pose = PoseMeasurement(START_NS + k * SECOND_NS // 10, truth(0.1 * k), COVARIANCE)
        history, _, _ = apply(history, pose, CONFIG)
        size = OtherSize(0.01, 0.0, np.deg2rad(turn_deg) * np.eye(6)[3])
        sized = sized_after(sized, (size,), history.steps[-1], CONFIG)
    (shift,) = shifts_of(history.state, sized, CONFIG).values()
    assert 0.3 < np.rad2deg(np.linalg.norm(shift[3:])) < 1.0  # that of the newest frame is 0
    sigmas = [np.sqrt(np.diag(each.covariance)) for each in (sized[0.01], history.state)]
    assert np.allclose(*sigmas, rtol=0.01)


def test_a_filter_at_another_size_that_does_not_turn_like_the_track_begins_anew():
    """A filter that did not follow a jump of its track ended at an impossible motion, and at an error."""
    history = History(start(truth(0.0), COVARIANCE, START_NS, config=CONFIG))
    for k in range(1, 20):
        pose = PoseMeasurement(START_NS + k * SECOND_NS // 10, truth(0.1 * k), COVARIANCE)
        history, _, _ = apply(history, pose, CONFIG)
    step, size = history.steps[-1], OtherSize(0.01, 0.0, 0.01 * np.eye(6)[2])
    for rate_rad_s, remains in ((1.65 * np.eye(3)[1], False), (step.predicted.rate_rad_s, True)):
        before = replace(step.predicted, rate_rad_s=rate_rad_s)
        found = sized_after({0.01: before}, (size,), step, CONFIG)[0.01]
        assert np.allclose(found.rate_rad_s, history.state.rate_rad_s, atol=1e-3)
        off_m = np.linalg.norm(found.T_chaser_target.translation - history.state.T_chaser_target.translation)
        assert (off_m < 0.005) == remains  # a new filter has the whole shift of the newest pose


def test_a_size_that_no_frame_can_exclude_takes_nothing_away_whatever_its_step_is(track):
    follow(track, PMD_S)
    stamp_ns = track.state.history.state.stamp_ns
    told = []
    for step_m in np.linspace(0.0, 0.05, 51):
        sizes = [OtherSize(share, -60.0, np.eye(6)[2] * step_m) for share in (-0.03, 0.03)]
        track.memory = replace(track.memory, frames=inside(other_sizes=partial(tuple, sizes)))
        told.append(track.judge(stamp_ns, sensor="pmd"))
    assert {each.state for each in told} == {IntegrityState.NOMINAL, IntegrityState.CAUTION}
    assert all((SIZE_DECLARED in each.reason) == (each.state is IntegrityState.CAUTION) for each in told)


def test_sizes_of_frames_within_a_second_count_as_one():
    size = OtherSize(0.03, 10.0, np.zeros(6))
    told = FrameEvidence()
    for k in range(10):
        registration = Registration(Source.LIDAR, other_sizes=lambda: (size,))
        told = told.after("lidar", START_NS + k * SECOND_NS // 10, registration, 60.0)
    (test,) = told.tests(10.0, 0.0, 1.0)
    assert test.value == pytest.approx(2.0 * 10.0 * 1.9)


def test_however_many_frames_prefer_a_size_an_error_that_they_share_may_be_the_reason():
    told = FrameEvidence()
    for k in range(10):
        size = OtherSize(0.03, 10.0, np.zeros(6), 6.0)
        registration = Registration(Source.LIDAR, other_sizes=partial(tuple, [size]))
        told = told.after("lidar", START_NS + k * SECOND_NS, registration, 60.0)
    (test,) = told.tests(10.0, 0.0)
    assert test.value == pytest.approx(2.0 * 6.0)


@pytest.mark.parametrize(("off_m", "fails"), [(0.0, False), (0.02, False), (0.06, True)])
def test_a_level_covers_the_position_by_distances_alone(off_m, fails):
    estimate = start(truth(0.0), 1e-4 * COVARIANCE, START_NS, config=CONFIG)
    told = inside(by_part=PartSolution("measured distances alone", np.array([0.0, 0.0, off_m]), 0.007, 0.007))
    (test,) = told.tests(6.0, 0.0)
    ((solution, _),) = told.solutions(estimate, truth(0.0).translation, 1e-4, 0.0)
    assert test.exceeds_risk(1e-6) == fails
    still = np.zeros(3)
    alone = Solution("", np.zeros(6), 1e-12 * np.eye(6))
    levels = levels_of([alone, solution], NOTHING_UNSEEN, TEN_M, still, still)
    assert levels.position_by == "pmd: measured distances alone"
    assert levels.position_m > off_m + 1.6 * 0.007


def test_a_drift_of_the_ranges_moves_the_estimate_as_far_as_it_follows_them():
    alone, still = [Solution("", np.zeros(6), 1e-12 * np.eye(6))], np.zeros(3)
    config = IntegrityConfig(mount_sigma_deg=0.0, mount_sigma_m=0.0, clock_sigma_s=0.0)
    whole, part = (
        protection_levels(alone, declared_covariance(config, TEN_M, still, still, followed=share), 1e-6)
        for share in (1.0, 0.2)
    )
    assert part.position_m == pytest.approx(0.2 * whole.position_m, rel=1e-3)


def test_ranges_are_followed_as_the_sensors_do_by_their_weights():
    part = PartSolution("measured distances alone", np.zeros(3), 0.007, 0.006, follows=0.8)
    told, place_m = inside(by_part=part), truth(0.0).translation
    both = start(truth(0.0), COVARIANCE, START_NS, config=CONFIG)
    assert told.ranges_followed(both, {}, place_m) == pytest.approx(0.2)
    assert told.after("pmd", START_NS, None, 60.0).ranges_followed(both, {}, place_m) == 1.0
    told = told.after("lidar", START_NS, Registration(Source.LIDAR), 60.0)
    assert told.ranges_followed(both, {}, place_m) == 1.0
    camera, lidar = (replace(both, covariance=factor * both.covariance) for factor in (1.25, 5.0))
    without = {"lidar": camera, "pmd": lidar}
    assert told.ranges_followed(both, without, place_m) == pytest.approx(0.8 * 0.2 + 0.2)
    without = {"lidar": replace(both), "pmd": lidar}  # four fifths by the camera, and the rest is open
    assert told.ranges_followed(both, without, place_m) == pytest.approx(0.8 * 0.2 + 0.2)


def test_where_the_pose_follows_the_distances_their_agreement_tells_nothing():
    estimate = start(truth(0.0), 1e-4 * COVARIANCE, START_NS, config=CONFIG)
    part = PartSolution("measured distances alone", np.array([0.0, 0.0, 1e-4]), 0.04, 1e-4, follows=0.0)
    ((solution, agreeing),) = inside(by_part=part).solutions(estimate, truth(0.0).translation, 1e-4, 0.0)
    assert agreeing.probability == 1e-4
    assert solution.probability == pytest.approx(1e-4 * np.exp(0.5))


@pytest.mark.parametrize(
    ("off_m", "sigma_m", "state"),
    [
        (0.0, 0.001, IntegrityState.NOMINAL),
        (0.0, 0.04, IntegrityState.CAUTION),
        (0.018, 0.004, IntegrityState.UNAVAILABLE),
        (0.032, 0.007, IntegrityState.UNAVAILABLE),
        (0.0, np.inf, IntegrityState.CAUTION),
        (0.4, 0.04, IntegrityState.ALERT),
    ],
)
def test_distances_that_are_not_good_enough_take_nothing_away_and_are_told(track, off_m, sigma_m, state):
    before = follow(track, PMD_S)[-1]
    part = PartSolution("measured distances alone", np.array([0.0, 0.0, off_m]), sigma_m, sigma_m)
    track.memory = replace(track.memory, frames=inside(by_part=part))
    told = track.measure(PMD_S[-1] + 0.1)
    assert told.state is state
    if state is IntegrityState.UNAVAILABLE:
        assert told.position_level_m > off_m
    if state is IntegrityState.CAUTION:
        assert told.reason.startswith(SIZE_BELIEVED)
        assert "(pmd: measured distances alone)" in told.reason
        assert told.position_level_m == pytest.approx(before.position_level_m, rel=0.05)


def test_the_level_covers_what_a_solution_without_a_sensor_says():
    alone = Solution("", np.zeros(6), 1e-6 * np.eye(6))
    apart = np.array([0.5, 0.0, 0.0, 0.0, 0.0, np.pi / 2])
    other = Solution("without pmd", apart, 1e-6 * np.eye(6), 1e-4)
    levels = levels_of([alone, other], NOTHING_UNSEEN, TEN_M, np.zeros(3), np.zeros(3))
    assert levels.position_m > 0.5
    assert levels.attitude_deg > 90.0
    assert levels.position_by == levels.attitude_by == "without pmd"


def test_declared_errors_of_mount_clock_and_ranges_widen_the_levels():
    alone = [Solution("", np.zeros(6), 1e-8 * np.eye(6))]
    how = TEN_M, np.array([0.0, 0.3, 0.4]), np.array([0.1, 0.0, 0.0])
    without = levels_of(alone, NOTHING_UNSEEN, *how)
    for declared in (
        {"mount_sigma_deg": 0.1},
        {"mount_sigma_m": 0.005},
        {"clock_sigma_s": 0.05},
        {"tuning": NOTHING_UNSEEN.tuning.model_copy(update={"range_share": 1e-3})},
    ):
        wider = levels_of(alone, NOTHING_UNSEEN.model_copy(update=declared), *how)
        assert wider.position_m > without.position_m


def test_levels_count_from_the_sensor_and_not_from_the_chasers_origin():
    estimate = start(truth(0.0), COVARIANCE, START_NS, config=CONFIG)
    place_m = estimate.T_chaser_target.translation
    assert Memory().place_m(estimate) == pytest.approx(place_m)
    mounts = {"pmd": make_pose(translation_m=[0.0, 0.0, -3.0]), "lidar": make_pose(translation_m=[1.0, 0, 0])}
    assert Memory(mounts=mounts).place_m(estimate) == pytest.approx(place_m + np.array([0.0, 0.0, 3.0]))


def test_a_mount_is_known_from_a_measurement_of_its_sensor(track):
    follow(track, PMD_S[:5])
    mount = make_pose(translation_m=[0.0, 0.0, -2.0])
    stamp_ns = START_NS + SECOND_NS
    measured = PoseMeasurement(stamp_ns, truth(1.0), COVARIANCE, Origin("pmd", mount))
    grown, nis, accepted = apply(track.state.history, measured, CONFIG)
    track.state = replace(track.state, history=grown)
    track.judge(stamp_ns, sensor="lidar", nis=nis, accepted=accepted)
    assert "lidar" not in track.memory.residuals, "the measurement at this stamp is the camera's"
    track.judge(stamp_ns, sensor="pmd", nis=nis, accepted=accepted)
    assert track.memory.mounts == {"pmd": mount}


def began_again(track, time_s, off, *, unseen_s):
    """Let a new track begin at a pose after a time without frames."""
    filtered = start(truth(time_s) * off, COVARIANCE, START_NS + round(time_s * SECOND_NS), config=CONFIG)
    unseen_ns = None if unseen_s is None else START_NS + round(unseen_s * SECOND_NS)
    track.state = replace(track.state, history=History(filtered), unseen_ns=unseen_ns)


def test_a_target_that_was_accelerated_while_nobody_saw_it_is_no_alert(track):
    follow(track, PMD_S)
    away = make_pose(translation_m=(1.0, 0.0, 0.0))
    began_again(track, 8.0, away, unseen_s=PMD_S[-1])
    told = follow(track, np.arange(8.1, 20.0, 0.1), off=away)
    assert IntegrityState.ALERT not in {each.state for each in told}


@pytest.mark.parametrize("off", [make_pose(translation_m=(1.0, 0.0, 0.0)), make_pose()])
def test_a_jump_of_the_position_in_view_is_an_alert_with_its_size_and_a_remedy(track, off):
    follow(track, PMD_S)
    began_again(track, 6.0, off, unseen_s=None)
    told = track.measure(6.1, off=off)
    if off.translation.any():
        assert told.state is IntegrityState.ALERT
        assert re.search(r"0\.\d deg and (9[89]\d|10[01]\d) mm apart", told.reason)
        assert told.reason.endswith("a reset ends this alert")
    else:
        assert told.state is not IntegrityState.ALERT


def test_another_attitude_after_a_time_in_which_nobody_saw_the_target_is_an_alert(track):
    follow(track, PMD_S)
    flip = make_pose(rotation=Rotation.from_rotvec([0.0, np.pi / 4, 0.0]))
    began_again(track, 8.0, flip, unseen_s=PMD_S[-1])
    assert track.measure(8.1, off=flip).state is IntegrityState.ALERT


def test_a_prediction_is_no_past_with_which_an_estimate_is_compared(track):
    follow(track, PMD_S)
    before = track.memory.past
    track.state = replace(track.state, mode=Mode.COASTING)
    for time_s in (7.0, 12.0, 20.0):
        track.judge(START_NS + round(time_s * SECOND_NS), sensor="pmd", accepted=False)
    assert track.memory.past is before


def test_a_level_leaves_the_newest_frames_out_however_late_measurements_may_be():
    """Where no late measurement is applied, the filter's past is kept all the same."""
    levels = []
    for max_delay_s in (1.0, 1e-9):
        config = FilterConfig(max_delay_s=max_delay_s)
        settings = EstimatorSettings(sensors=(PmdInput(), LidarInput()), filter=config)
        made = Track(Monitor(settings), np.random.default_rng(7), config=config)
        told = follow(made, np.arange(0.0, 12.0, 1.0))[-1]
        levels.append((told.attitude_level_deg, told.position_level_m))
    assert levels[0] == levels[1]


def test_a_solution_without_a_sensor_follows_an_acceleration_as_the_estimate_does(track):
    """0.5 m/s2: the gate refuses poses until the densities are raised, in each of the filters."""
    for k in range(160):
        time_s = 0.05 * k
        off = make_pose(translation_m=(0.25 * max(time_s - 5.0, 0.0) ** 2, 0.0, 0.0))
        track.measure(time_s, sensor="lidar" if k % 2 else "pmd", off=off, alone=True)
    there_m = (truth(time_s) * off).translation
    newest_ns = track.state.history.state.stamp_ns
    for found in (track.state.history.state, *track.memory.without.values()):
        apart_m = found.T_chaser_target.translation - there_m
        assert newest_ns - found.stamp_ns <= SECOND_NS // 20
        assert np.linalg.norm(apart_m) < 0.15


def test_an_estimate_is_not_compared_with_one_of_hours_ago(track):
    follow(track, PMD_S)
    anchors = tuple(replace(each, model=Slow(300.0)) for each in track.memory.past.anchors)
    assert anchors
    track.memory = replace(track.memory, past=replace(track.memory.past, anchors=anchors))
    began_again(track, 3600.0, make_pose(), unseen_s=PMD_S[-1])
    track.measure(3600.1)
    assert {each.stamp_ns for each in track.memory.past.anchors} == {START_NS + 36_001 * SECOND_NS // 10}
