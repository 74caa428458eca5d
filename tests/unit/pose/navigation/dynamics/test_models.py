"""The models of motion, against numerical integration, and their derivatives, against differences."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from rpod_pose.navigation.dynamics.chaser import Held
from rpod_pose.navigation.dynamics.command_track import Commanded, CommandTrack
from rpod_pose.navigation.dynamics.free_motion import (
    ACCELERATION_BIAS,
    CENTRE_OF_MASS,
    GYRO_BIAS,
    INERTIA,
    FreeMotion,
)
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_pose.navigation.dynamics.relative_orbit import inertial_transition, transition
from rpod_pose.navigation.dynamics.slewing import Turning, relied_on
from rpod_pose.navigation.dynamics.torque_free import Inertia, constant_rate, curvature, torque_free
from rpod_pose.navigation.filter import ATTITUDE, Block, FilterState, innovation_of, predict, to_odometry
from rpod_pose.navigation.filter.rotations import cross_matrix
from rpod_pose.navigation.integrity.clocks import Pair, clock_test
from rpod_pose.navigation.integrity.residuals import residual_of, residual_tests
from rpod_schemas.config.estimator.dynamics import CommandTuning
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.estimator.integrity import IntegrityConfig
from rpod_schemas.poses import make_pose, rotation_of
from rpod_schemas.topics import CHASER
from rpod_schemas.types import ImuReading

INERTIA_KG_M2 = np.array([[17.0, 0.4, -0.3], [0.4, 125.0, 0.2], [-0.3, 0.2, 129.0]])
FILTER = FilterConfig()


def integrated(slope, start, end_s):
    solved = solve_ivp(slope, (0.0, end_s), start, method="DOP853", rtol=1e-12, atol=1e-12)
    assert solved.success
    return solved.y[:, -1]


def test_a_body_without_torque_turns_as_eulers_equations_say():
    rate = np.radians([3.0, 5.0, -4.0])

    def slope(_, y):
        R, w = y[:9].reshape(3, 3), y[9:]
        turned = R @ cross_matrix(w)
        return np.concatenate(
            [turned.ravel(), np.linalg.solve(INERTIA_KG_M2, -np.cross(w, INERTIA_KG_M2 @ w))]
        )

    y = integrated(slope, np.concatenate([np.eye(3).ravel(), rate]), 60.0)
    found = torque_free(rate, Inertia(INERTIA_KG_M2).shaped(np.zeros(2)), 60.0)
    off = Rotation.from_matrix(y[:9].reshape(3, 3).T @ found.turn).magnitude()
    assert np.degrees(off) < 1e-3
    np.testing.assert_allclose(found.rate_rad_s, y[9:], atol=1e-7)


def test_a_sphere_turns_at_a_constant_rate():
    rate = np.radians([3.0, 5.0, -4.0])
    general = torque_free(rate, Inertia(np.eye(3)).shaped(np.zeros(0)), 20.0)
    simple = constant_rate(rate, 20.0)
    for one, other in zip(general, simple, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_a_relative_orbit_obeys_the_equations_of_clohessy_and_wiltshire():
    n = 2.0 * np.pi / 6000.0
    start = np.array([20.0, -30.0, 10.0, 0.02, -0.05, 0.01])

    def slope(_, y):
        x, _, z, vx, vy, vz = y
        return np.array([vx, vy, vz, 3 * n**2 * x + 2 * n * vy, -2 * n * vx, -(n**2) * z])

    np.testing.assert_allclose(transition(n, 900.0) @ start, integrated(slope, start, 900.0), atol=1e-7)
    np.testing.assert_allclose(transition(1e-12, 9.0), transition(0.0, 9.0), atol=1e-9)


def test_the_inertial_transition_is_the_identity_of_axes_at_rest_for_a_short_time_and_composes():
    R = Rotation.from_euler("zyx", [0.3, -0.7, 1.1]).as_matrix()
    n = 2.0 * np.pi / 6000.0
    np.testing.assert_allclose(inertial_transition(n, 0.0, R), np.eye(6), atol=1e-15)
    # in axes at rest, the orbital frame has turned by n t at the start of the second step
    turned = R @ Rotation.from_rotvec([0.0, 0.0, n * 50.0]).as_matrix()
    both = inertial_transition(n, 40.0, turned) @ inertial_transition(n, 50.0, R)
    np.testing.assert_allclose(both, inertial_transition(n, 90.0, R), atol=1e-10)


def a_state(blocks):
    generator = np.random.default_rng(3)
    size = 12 + sum(block.size for block in blocks)
    return FilterState(
        stamp_ns=10**18,
        T_chaser_target=make_pose(
            rotation=Rotation.from_euler("zyx", [0.4, -0.2, 1.0]), translation_m=[0.3, -0.4, 8.0]
        ),
        velocity_m_s=np.array([0.03, -0.02, 0.05]),
        rate_rad_s=np.radians([4.0, -3.0, 5.0]),
        covariance=1e-10 * np.diag(generator.uniform(0.5, 1.5, size)),
        centre_of_mass_m=np.array([0.5, -0.2, 0.1]),
        blocks=tuple(blocks),
    )


def a_track(rate_hz=100.0, span_s=(-1.0, 4.0), **fields):
    track = ImuTrack()
    for number in range(round(span_s[0] * rate_hz), round(span_s[1] * rate_hz)):
        time_s = number / rate_hz
        rate = np.radians([1.0, 0.5 * np.sin(0.3 * time_s), -0.3])
        force = 1e-3 * np.array([2.0, -time_s, 3.0])
        stamp_ns = 10**18 + round(time_s * 1e9)
        track.take(
            ImuReading(stamp_ns=stamp_ns, frame_id=CHASER, rate_rad_s=rate, force_m_s2=force, **fields)
        )
    return track


BLOCKS = (
    Block(CENTRE_OF_MASS, np.array([0.1, 0.05, -0.1]), np.full(3, 0.2)),
    Block(INERTIA, np.array([0.05, -0.1]), np.full(2, 0.1)),
    Block(GYRO_BIAS, np.radians([0.02, -0.03, 0.01]), np.full(3, 1e-3)),
    Block(ACCELERATION_BIAS, np.array([1e-3, 2e-3, -1e-3]), np.full(3, 1e-3)),
)


def difference(state, other):
    """Return the errors of a state from another, in the filter's coordinates."""
    one, two = rotation_of(state.T_chaser_target), rotation_of(other.T_chaser_target)
    return np.concatenate(
        [
            state.T_chaser_target.translation - other.T_chaser_target.translation,
            (one * two.inv()).as_rotvec(),
            state.velocity_m_s - other.velocity_m_s,
            state.rate_rad_s - other.rate_rad_s,
            *(a.value - b.value for a, b in zip(state.blocks, other.blocks, strict=True)),
        ]
    )


MODELS = {
    "chaser at rest": FreeMotion(Held(), Inertia(INERTIA_KG_M2), angular_acceleration_density_rad2_s3=2e-11),
    "constant rate in orbit": FreeMotion(Held(np.eye(3)[[1, 2, 0]], 1e-3), None, 1e-3),
    "all with an imu": FreeMotion(
        a_track(R_orbit_chaser=Rotation.from_euler("zyx", [1.0, 0.3, -0.4])),
        Inertia(INERTIA_KG_M2),
        1e-3,
        acceleration_density_m2_s3=1e-16,
        angular_acceleration_density_rad2_s3=1e-16,
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_the_derivatives_of_a_model_are_those_of_its_states(name):
    model = MODELS[name]
    blocks = [block for block in BLOCKS if model.inertia is not None or block.name != INERTIA]
    state = replace(a_state(blocks), model=model)
    moved, F, _, after = model(state, 2.0, FILTER)
    found = after @ F
    for index in range(state.size):
        step = np.zeros(state.size)
        step[index] = 1e-5
        ends = [model(state.corrected(sign * step), 2.0, FILTER).state for sign in (1.0, -1.0)]
        column = difference(*ends) / 2e-5
        np.testing.assert_allclose(
            found[:, index],
            column,
            atol=2e-3 if index >= state.places()[GYRO_BIAS].start else 1e-6,
            err_msg=f"state {index}",
        )
    assert rotation_of(moved.T_chaser_target).magnitude() > 0.1


def test_the_derivatives_do_not_depend_on_the_length_of_the_steps():
    state = replace(a_state(BLOCKS), model=MODELS["all with an imu"])
    whole = predict(state, state.stamp_ns + 2_000_000_000, FILTER)
    parts = state
    for part in range(1, 11):
        parts = predict(parts, state.stamp_ns + part * 200_000_000, FILTER)
    np.testing.assert_allclose(difference(parts, whole), 0.0, atol=3e-5)
    np.testing.assert_allclose(parts.covariance, whole.covariance, rtol=5e-3, atol=2e-12)


def test_a_chaser_that_turns_sees_a_target_at_rest_turn_the_other_way():
    track = ImuTrack()
    rate = np.radians([0.0, 1.0, 0.0])
    for number in range(-50, 3100):
        stamp_ns = 10**18 + number * 10_000_000
        track.take(ImuReading(stamp_ns=stamp_ns, frame_id=CHASER, rate_rad_s=rate))
    pose = make_pose(translation_m=[0.0, 0.0, 10.0])
    state = FilterState(
        10**18, pose, -np.cross(rate, pose.translation), -rate, np.eye(12), model=FreeMotion(track)
    )
    seen = predict(state, 10**18 + 30_000_000_000, FILTER)
    turn = Rotation.from_rotvec(-30.0 * rate)
    np.testing.assert_allclose(seen.T_chaser_target.translation, turn.apply(pose.translation), atol=1e-9)
    assert (rotation_of(seen.T_chaser_target) * turn.inv()).magnitude() < 1e-9
    np.testing.assert_allclose(
        seen.velocity_m_s, -np.cross(rate, seen.T_chaser_target.translation), atol=1e-9
    )


def test_time_without_readings_adds_the_noise_of_a_chaser_that_nobody_measures():
    track = a_track()
    model = FreeMotion(track, Inertia(INERTIA_KG_M2), angular_acceleration_density_rad2_s3=2e-11)
    state = replace(a_state(()), model=model)
    known = predict(state, state.stamp_ns + 3_500_000_000, FILTER)
    blind = predict(state, state.stamp_ns + 10_000_000_000, FILTER)
    added = blind.covariance[ATTITUDE, ATTITUDE].trace() - known.covariance[ATTITUDE, ATTITUDE].trace()
    assert added > 3 * FILTER.angular_acceleration_density_rad2_s3 * 6.0**3 / 3.0


@pytest.mark.parametrize("silent_s", [0.5, 8.0])
def test_time_without_readings_before_others_moves_the_target_until_the_end(silent_s):
    """The position after ten seconds, of which 1.5 are without readings, early or late."""
    track = ImuTrack()
    for number in range(101):
        if not 10 * silent_s < number < 10 * silent_s + 15:
            reading = {"rate_rad_s": np.zeros(3), "force_m_s2": np.zeros(3)}
            track.take(ImuReading(stamp_ns=10**18 + number * 10**8, frame_id=CHASER, **reading))
    model = FreeMotion(track, None, acceleration_density_m2_s3=1e-16)
    state = replace(a_state(()), centre_of_mass_m=np.zeros(3), model=model)
    whole = predict(state, 10**18 + 10**10, FILTER)
    late, early = 10.0 - silent_s, 10.0 - silent_s - 1.5
    expected = FILTER.acceleration_density_m2_s3 * (late**3 - early**3) / 3.0
    assert whole.covariance[0, 0] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("begin_s", [8.95, 3.05])
def test_a_chaser_that_turned_otherwise_while_its_imu_was_silent_turns_as_the_next_reading_says(begin_s):
    """The IMU is silent for six seconds, in which the chaser reverses its turn: +1 deg/s before, -1 after.

    The state of the target, at rest, is right where the step begins, as frames have told it.
    """
    track, turns = ImuTrack(), np.radians([0.0, 1.0, 0.0])
    for number in range(1001):
        if not 300 < number < 900:
            rate = turns if number <= 300 else -turns
            stamp_ns = 10**18 + number * 10_000_000
            track.take(ImuReading(stamp_ns=stamp_ns, frame_id=CHASER, rate_rad_s=rate))
    pose = make_pose(translation_m=[0.0, 0.0, 10.0])
    begin_ns, end_ns = 10**18 + round(begin_s * 1e9), 10**18 + 9_050_000_000
    before = -turns * (1.0 - 2.0 * (begin_s - 3.0) / 6.0 if begin_s < 8.0 else -1.0)
    state = FilterState(
        begin_ns, pose, np.cross(before, pose.translation), before, np.eye(12), model=FreeMotion(track)
    )
    seen = predict(state, end_ns, FILTER)
    if begin_s > 8.0:
        turn = Rotation.from_rotvec(turns * (end_ns - begin_ns) * 1e-9)
        off_deg = np.degrees((rotation_of(seen.T_chaser_target) * turn.inv()).magnitude())
        assert off_deg < 0.01
    np.testing.assert_allclose(np.degrees(seen.rate_rad_s), [0.0, 1.0, 0.0], atol=0.05)


@pytest.mark.parametrize(
    ("model", "named"),
    [
        (None, ""),
        (FreeMotion(ImuTrack()), "chaser/imu (axes, sign, rad/s, stamps)"),
        (FreeMotion(Held()), "a chaser that holds its attitude (dynamics.imu)"),
        (
            FreeMotion(Commanded(ImuTrack(), CommandTrack(), CommandTuning()), Inertia(INERTIA_KG_M2)),
            "guidance/command (axes, sign, stamps), and on chaser/imu (axes, sign, rad/s, stamps), and on a "
            "target without torque, with the inertia of its file (dynamics.target)",
        ),
    ],
    ids=["steady", "imu", "held", "commands"],
)
def test_what_a_prediction_relies_on_is_told_with_a_pose_that_contradicts_it(model, named):
    told = f"; predictions rely on {named}" if named else ""
    state = replace(a_state(()), model=model)
    assert relied_on(state) == told
    pose = make_pose(translation_m=state.T_chaser_target.translation + 1.0)
    found = innovation_of(state, pose, 1e-6 * np.eye(6), config=FILTER)
    tests, _ = residual_tests("pmd", [residual_of(state, found, state.stamp_ns)], dof=6, correlated_s=1.0)
    assert all(test.describe(1e-6).endswith(told) for test in tests)


def test_the_difference_of_two_sensors_before_a_chaser_that_turns_names_it_beside_the_clock():
    """Filters without one sensor go on with a held attitude, so that they differ without a wrong mount."""
    state = replace(a_state(()), model=Turning(FreeMotion(Held()), ()))
    moved = make_pose(translation_m=state.T_chaser_target.translation + state.velocity_m_s)
    other = replace(state, T_chaser_target=moved)
    test, _ = clock_test(Pair("lidar", "pmd"), state, other, estimate=state, config=IntegrityConfig())
    assert test.cause.endswith(
        " against those of lidar; the chaser turns without a known rate, so that no gap is bridged (set "
        "dynamics.imu)"
    )


def test_readings_that_are_not_newer_are_not_used():
    track = a_track()
    newest_ns = 10**18 + 3_990_000_000
    old = ImuReading(stamp_ns=newest_ns, frame_id=CHASER, rate_rad_s=np.ones(3))
    assert not track.take(old)
    assert track.covers(newest_ns + 9_000_000)
    assert not track.covers(newest_ns + 11_000_000)


def test_an_inertia_of_any_ratios_is_positive():
    inertia = Inertia(INERTIA_KG_M2)
    declared = inertia.shaped(np.zeros(2)).J
    np.testing.assert_allclose(declared, INERTIA_KG_M2 / np.trace(INERTIA_KG_M2), atol=1e-15)
    for k in range(2):
        step = 1e-6 * np.eye(2)[k]
        at = np.array([0.3, -0.2])
        slope = (inertia.shaped(at + step).J - inertia.shaped(at - step).J) / 2e-6
        np.testing.assert_allclose(inertia.shaped(at).by_coefficient[k], slope, atol=1e-9)
    assert np.linalg.eigvalsh(inertia.shaped(np.array([2.0, -3.0])).J).min() > 0.0


def test_the_star_tracker_tells_the_bias_of_the_gyro():
    n, sigma, bias = 1e-3, np.radians(0.01), np.radians([0.004, -0.002, 0.003])
    track = ImuTrack(
        np.radians(0.0025), orbit_rate_rad_s=n, bias_sigma_rad_s=np.radians(0.003),
        bias_walk_rad_s_sqrt_s=np.radians(2.6e-6),
    )  # fmt: skip
    generator, R = np.random.default_rng(1), Rotation.identity()
    for number in range(1201):
        time_s = 0.1 * number
        rate = np.radians([0.5, 1.0 * np.sin(0.1 * time_s), 0.0])
        noise = np.radians(0.0025) * np.sqrt(10.0) * generator.standard_normal(3)
        measured = Rotation.from_rotvec([0.0, 0.0, -n * time_s]) * R
        track.take(
            ImuReading(
                stamp_ns=10**18 + number * 100_000_000, frame_id=CHASER, rate_rad_s=rate + bias + noise,
                R_orbit_chaser=measured * Rotation.from_rotvec(sigma * generator.standard_normal(3)),
                attitude_variance=sigma**2,
            )
        )  # fmt: skip
        middle = np.radians([0.5, 1.0 * np.sin(0.1 * (time_s + 0.05)), 0.0])
        R = R * Rotation.from_rotvec(0.1 * middle)
    found = track.bias_at(10**18 + 120_000_000_000)
    off = found.bias_rad_s - bias
    assert np.sqrt(found.variance) < np.radians(4e-4)
    assert off @ np.linalg.solve(found.covariance[3:, 3:], off) < 16.3  # 99.9 % of chi-squared with 3


def test_the_second_order_of_the_rotation_is_that_of_samples():
    generator, inertia, mean = np.random.default_rng(5), Inertia(INERTIA_KG_M2), np.radians([1.0, 3.0, -2.0])
    sigma = np.concatenate([np.full(3, np.radians(4.0)), np.full(2, 0.1)])
    found = curvature(mean, np.zeros(2), inertia, np.diag(sigma), 1.0)
    middle = torque_free(mean, inertia.shaped(np.zeros(2)), 1.0)
    samples = sigma * generator.standard_normal((300, 5))
    over = []
    for sample in samples:
        ends = [
            torque_free(mean + sign * sample[:3], inertia.shaped(sign * sample[3:]), 1.0).rate_rad_s
            for sign in (1.0, -1.0)
        ]
        over.append(0.5 * (ends[0] + ends[1]) - middle.rate_rad_s)  # the even part: second order and higher
    off = (found.mean[3:] - np.mean(over, axis=0)) / (np.std(over, axis=0) / np.sqrt(len(over)))
    assert np.abs(off).max() < 4.0
    covariance = (found.spread @ found.spread.T)[3:, 3:]
    np.testing.assert_allclose(np.diag(covariance), np.var(over, axis=0), rtol=0.5)


def test_the_published_twist_is_as_uncertain_as_the_gyro_against_which_it_is_given():
    """A target at rest, whose rate is known: what is seen of it is the noise of the chaser's own rate."""
    walk, rate_hz, found = np.radians(0.0025), 100.0, []
    pose = make_pose(translation_m=[0.0, 0.0, 10.0])
    for seed in range(200):
        track, generator = ImuTrack(walk), np.random.default_rng(seed)
        for number in range(-40, 31):
            noise = walk * np.sqrt(rate_hz) * generator.standard_normal(3)
            stamp_ns = 10**18 + number * 10_000_000
            track.take(ImuReading(stamp_ns=stamp_ns, frame_id=CHASER, rate_rad_s=noise))
        begin, known = track.step(10**18, 10**18).rate_after_rad_s, 1e-18 * np.eye(12)
        state = FilterState(
            10**18, pose, -np.cross(begin, pose.translation), -begin, known, model=FreeMotion(track)
        )
        seen = predict(state, 10**18 + 305_000_000, FILTER.model_copy(update=STILL))
        odometry = to_odometry(seen, frame_id=CHASER, child_frame_id="target")
        twist = np.concatenate([odometry.linear_m_s, odometry.angular_rad_s])
        found.append(twist[[0, 1, 5]] ** 2 / np.diag(odometry.twist_covariance)[[0, 1, 5]])
    # the mean of 600 values of chi-squared with 1 degree of freedom has a standard deviation of 0.06
    assert 0.8 < np.mean(found) < 1.2


STILL = {"acceleration_density_m2_s3": 1e-16, "angular_acceleration_density_rad2_s3": 1e-18}
"""No accelerations."""


@pytest.mark.parametrize("better", [1e-2, 1e2])
def test_the_noise_that_readings_state_counts_between_them_too(better):
    """Steps that end between two readings: a gyro and an accelerometer that are not as assumed."""
    walk, force_walk = better * np.radians(0.0025), better * 1e-3
    track = ImuTrack(np.radians(0.0025), force_noise_m_s_sqrt_s=1e-3)
    for number in range(201):
        stamp_ns = 10**18 + number * 20_000_000
        track.take(
            ImuReading(
                stamp_ns=stamp_ns, frame_id=CHASER, rate_rad_s=np.zeros(3), rate_variance=50.0 * walk**2,
                force_m_s2=np.zeros(3), force_variance=50.0 * force_walk**2,
            )
        )  # fmt: skip
    stamps_ns = 10**18 + 10**9 + np.arange(31) * 10**9 // 15
    steps = [track.step(int(a), int(b)) for a, b in pairwise(stamps_ns)]
    assert sum(step.turn_variance for step in steps) == pytest.approx(2.0 * walk**2, rel=1e-6)
    assert sum(step.force_noise[2] for step in steps) == pytest.approx(2.0 * force_walk**2, rel=1e-6)
