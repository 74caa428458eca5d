"""The filter against its own model: consistency, convergence, gate, twist."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.navigation.filter import (
    FilterState,
    StampOrderError,
    exponential,
    left_jacobian,
    predict,
    start,
    to_odometry,
    update,
)
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.estimator.filter import FilterConfig, FilterTuning
from rpod_schemas.poses import make_pose, rotation_of
from rpod_target import Equivalence, Symmetry

SECOND_NS = 1_000_000_000
PLAIN = FilterConfig(
    position_floor_m=0.0,
    attitude_floor_deg=0.0,
    tuning=FilterTuning(gate_nis=1e9, correlation_inflation=1.0),
    initial_velocity_sigma_m_s=1.0,
)
"""Takes measurements at their word."""
ORIGIN, CENTRE_M = np.zeros(3), np.array([-3.86, -0.4, 0.7])
"""Where the centre of mass lies, target axes."""
COVARIANCE = np.diag([2e-3, 3e-3, 8e-3, 4e-3, 5e-3, 3e-3]) ** 2
COVARIANCE[0, 4] = COVARIANCE[4, 0] = 4e-6


@dataclass
class Truth:
    pose: RigidTransform
    velocity_m_s: FloatArray
    rate_rad_s: FloatArray


def turned(rotvec: FloatArray, shift_m: FloatArray, pose: RigidTransform) -> RigidTransform:
    """Return a pose with an error (dp, dtheta) of the interface control document."""
    return make_pose(
        rotation=Rotation.from_rotvec(rotvec) * rotation_of(pose), translation_m=pose.translation + shift_m
    )


def measured(truth: Truth, covariance: FloatArray, rng: np.random.Generator) -> RigidTransform:
    error = rng.multivariate_normal(np.zeros(6), covariance)
    return turned(error[3:], error[:3], truth.pose)


def moved(
    truth: Truth,
    step_s: float,
    config: FilterConfig,
    rng: np.random.Generator,
    centre_m: FloatArray = ORIGIN,
) -> Truth:
    """Return the truth after a step of the filter's model: about the centre of mass."""
    centre = at_point(truth, centre_m)
    walk = np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    root = np.linalg.cholesky(walk)
    linear = np.sqrt(config.acceleration_density_m2_s3) * root @ rng.standard_normal((2, 3))
    angular = np.sqrt(config.angular_acceleration_density_rad2_s3) * root @ rng.standard_normal((2, 3))
    steady = turned(centre.rate_rad_s * step_s, centre.velocity_m_s * step_s, centre.pose)
    later = Truth(
        turned(angular[0], linear[0], steady), centre.velocity_m_s + linear[1], centre.rate_rad_s + angular[1]
    )
    return at_point(later, -centre_m)


def at_point(truth: Truth, point_m: FloatArray) -> Truth:
    """Return pose and twist of a point that is fixed in the target, target axes."""
    arm_m = rotation_of(truth.pose).apply(point_m)
    return Truth(
        turned(np.zeros(3), arm_m, truth.pose),
        truth.velocity_m_s + np.cross(truth.rate_rad_s, arm_m),
        truth.rate_rad_s,
    )


def error_of(state: FilterState, truth: Truth) -> FloatArray:
    turn = rotation_of(state.T_chaser_target) * rotation_of(truth.pose).inv()
    return np.concatenate(
        [
            state.T_chaser_target.translation - truth.pose.translation,
            turn.as_rotvec(),
            state.velocity_m_s - truth.velocity_m_s,
            state.rate_rad_s - truth.rate_rad_s,
        ]
    )


def random_truth(rng: np.random.Generator, config: FilterConfig, centre_m: FloatArray = ORIGIN) -> Truth:
    centre = Truth(
        make_pose(rotation=Rotation.random(rng=rng), translation_m=rng.normal(0, 5, 3)),
        (config.initial_velocity_sigma_m_s or 0.0) * rng.standard_normal(3),
        np.deg2rad(config.initial_rate_sigma_deg_s) * rng.standard_normal(3),
    )
    return at_point(centre, -centre_m)


@pytest.mark.parametrize("centre_m", [ORIGIN, CENTRE_M], ids=["about the origin", "about a point off it"])
@pytest.mark.parametrize("step_s", [1.0 / 15.0, 1.0])
def test_errors_and_innovations_are_as_large_as_the_filter_says(step_s: float, centre_m: FloatArray) -> None:
    rng, runs, steps = np.random.default_rng(7), 60, 12
    nees, nis = [], []
    for _ in range(runs):
        truth = random_truth(rng, PLAIN, centre_m)
        first = measured(truth, COVARIANCE, rng)
        state = start(first, COVARIANCE, 0, config=PLAIN, centre_of_mass_m=centre_m)
        for frame in range(1, steps + 1):
            truth = moved(truth, step_s, PLAIN, rng, centre_m)
            state = predict(state, round(frame * step_s * SECOND_NS), PLAIN)
            state, innovation, *_ = update(state, measured(truth, COVARIANCE, rng), COVARIANCE, config=PLAIN)
            nis.append(innovation)
        error = error_of(state, truth)
        nees.append(error @ np.linalg.solve(state.covariance, error))
    # means of chi-square with 12 and 6 degrees, within four sigma
    assert np.mean(nees) == pytest.approx(12.0, abs=4.0 * np.sqrt(2 * 12 / runs))
    assert np.mean(nis) == pytest.approx(6.0, abs=4.0 * np.sqrt(2 * 6 / (runs * steps)))


@pytest.mark.parametrize("centre_m", [ORIGIN, CENTRE_M], ids=["about the origin", "about a point off it"])
def test_a_long_prediction_of_a_fast_rotation_is_consistent_too(centre_m: FloatArray) -> None:
    rng, runs = np.random.default_rng(8), 300
    config = PLAIN.model_copy(update={"angular_acceleration_density_rad2_s3": 1e-8})
    covariance_12 = np.diag([0.01, 0.01, 0.01, 0.02, 0.01, 0.03, 0.01, 0.01, 0.01, 0.004, 0.008, 0.006]) ** 2
    nees = []
    for _ in range(runs):
        truth = Truth(make_pose(rotation=Rotation.random(rng=rng)), np.ones(3), np.array([0.4, -0.3, 0.5]))
        error = rng.multivariate_normal(np.zeros(12), covariance_12)
        state = FilterState(
            0,
            turned(error[3:6], error[:3], truth.pose),
            truth.velocity_m_s + error[6:9],
            truth.rate_rad_s + error[9:],
            covariance_12,
            centre_m,
        )
        later = predict(state, 4 * SECOND_NS, config)  # about 160 degrees
        error = error_of(later, moved(truth, 4.0, config, rng, centre_m))
        nees.append(error @ np.linalg.solve(later.covariance, error))
    assert np.mean(nees) == pytest.approx(12.0, abs=4.0 * np.sqrt(2 * 12 / runs))


def test_the_twist_of_a_spinning_target_is_found() -> None:
    rng, config = np.random.default_rng(9), FilterConfig()
    axis_T, rate_rad_s, velocity_m_s = (
        np.array([1.0, 0.0, 0.0]),
        np.deg2rad(5.0),
        np.array([0.0, 0.02, -0.25]),
    )
    attitude_0 = Rotation.from_euler("ZYX", [10.0, 80.0, 30.0], degrees=True)
    sigma = np.repeat([0.002, np.deg2rad(0.15)], 3)

    def pose_at(time_s: float) -> RigidTransform:
        spin = Rotation.from_rotvec(axis_T * rate_rad_s * time_s)
        return make_pose(
            rotation=attitude_0 * spin, translation_m=np.array([0, 0, 7.0]) + velocity_m_s * time_s
        )

    state = start(pose_at(0.0), np.diag(sigma**2), 0, config=config)
    for frame in range(1, 76):
        truth = Truth(pose_at(frame / 15.0), velocity_m_s, np.zeros(3))
        state = predict(state, round(frame / 15.0 * SECOND_NS), config)
        state, _, accepted, _ = update(
            state, measured(truth, np.diag(sigma**2), rng), np.diag(sigma**2), config=config
        )
        assert accepted
    odometry = to_odometry(state, frame_id="chaser", child_frame_id="target_estimate")
    assert np.rad2deg(np.linalg.norm(odometry.angular_rad_s - rate_rad_s * axis_T)) < 0.8
    assert np.linalg.norm(state.velocity_m_s - velocity_m_s) < 0.04


def tracked_state() -> FilterState:
    """Return a state with a twist and correlations, as after some frames."""
    rng = np.random.default_rng(3)
    truth = random_truth(rng, PLAIN)
    state = start(truth.pose, COVARIANCE, 0, config=PLAIN)
    for frame in range(1, 6):
        truth = moved(truth, 0.2, PLAIN, rng)
        state = predict(state, frame * SECOND_NS // 5, PLAIN)
        state = update(state, measured(truth, COVARIANCE, rng), COVARIANCE, config=PLAIN).state
    return state


def test_the_gate_rejects_outliers_and_leaves_the_state_alone() -> None:
    state = tracked_state()
    outlier = turned(np.array([0.0, 0.0, np.pi / 3]), np.zeros(3), state.T_chaser_target)
    rejected = update(state, outlier, COVARIANCE, config=FilterConfig())
    assert not rejected.accepted
    assert rejected.nis > FilterConfig().tuning.gate_nis
    assert rejected.state is state
    assert update(state, state.T_chaser_target, COVARIANCE, config=FilterConfig()).nis == pytest.approx(0.0)


def test_the_gate_lets_99_percent_of_good_measurements_pass() -> None:
    rng, state = np.random.default_rng(5), tracked_state()
    config = PLAIN.model_copy(update={"tuning": FilterConfig().tuning})
    innovation = state.covariance[:6, :6] + COVARIANCE
    errors = rng.multivariate_normal(np.zeros(6), innovation, size=800)
    accepted = [
        update(state, turned(error[3:], error[:3], state.T_chaser_target), COVARIANCE, config=config).accepted
        for error in errors
    ]
    assert np.mean(accepted) == pytest.approx(0.99, abs=4.0 * np.sqrt(0.01 * 0.99 / 800))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_measurement_without_a_finite_covariance_is_rejected(bad: float) -> None:
    state = tracked_state()
    outcome = update(state, state.T_chaser_target, np.full((6, 6), bad), config=FilterConfig())
    assert not outcome.accepted
    assert np.isnan(outcome.nis)
    assert outcome.state is state


def test_a_measurement_whose_covariance_is_not_one_is_rejected() -> None:
    state = tracked_state()
    pose = turned(np.zeros(3), np.full(3, 0.01), state.T_chaser_target)
    outcome = update(state, pose, -np.eye(6), config=FilterConfig())
    assert not outcome.accepted
    assert outcome.state is state


def test_floor_and_inflation_keep_the_filter_from_believing_too_much() -> None:
    config = FilterConfig(
        position_floor_m=0.002, attitude_floor_deg=0.15, tuning=FilterTuning(correlation_inflation=2.0)
    )
    state = start(make_pose(), np.zeros((6, 6)), 0, config=config)
    sigma = np.sqrt(np.diag(state.covariance))
    np.testing.assert_allclose(sigma[:6], np.sqrt(2.0) * np.repeat([0.002, np.deg2rad(0.15)], 3))


def test_an_estimate_does_not_depend_on_where_the_file_has_its_origin() -> None:
    config, scale = FilterConfig(), np.diag([0.01, 0.02, 0.01, 2e-4, 1e-4, 3e-4]) ** 2
    accelerated = [
        turned(np.full(3, 0.1 * s), np.array([0.0, 0.02, 0.03]) * s**2, make_pose()) for s in range(4)
    ]
    places = []
    for centre_m in (ORIGIN, CENTRE_M):
        state = None
        for number, centre in enumerate(accelerated):
            arm_m = rotation_of(centre).apply(centre_m)
            pose = turned(np.zeros(3), -arm_m, centre)
            from_centre = np.eye(6)
            from_centre[:3, 3:] = np.cross(np.eye(3), arm_m)
            covariance = from_centre @ scale @ from_centre.T
            if state is None:
                state = start(pose, covariance, 0, config=config, centre_of_mass_m=centre_m)
                continue
            state = predict(state, number * SECOND_NS, config)
            state = update(state, pose, covariance, config=config).state
        places.append((state.T_chaser_target.rotation, state.T_chaser_target.apply(centre_m)))
    (turn, place_m), (other_turn, other_place_m) = places
    assert np.rad2deg((turn * other_turn.inv()).magnitude()) < 0.005
    np.testing.assert_allclose(place_m, other_place_m, atol=1e-3)


def test_the_covariance_stays_symmetric_and_positive_definite() -> None:
    rng, config = np.random.default_rng(11), FilterConfig()
    truth = random_truth(rng, config)
    state = start(truth.pose, COVARIANCE, 0, config=config)
    stamp_ns = 0
    for _ in range(200):
        stamp_ns += int(rng.integers(0, 2 * SECOND_NS))
        state = predict(state, stamp_ns, config)
        scale = 10.0 ** rng.uniform(-6, 2)
        pose = turned(rng.normal(0, 0.01, 3), rng.normal(0, 0.01, 3), state.T_chaser_target)
        state = update(state, pose, COVARIANCE * scale, config=config).state
        np.testing.assert_array_equal(state.covariance, state.covariance.T)
        assert np.linalg.eigvalsh(state.covariance).min() > 0.0


@settings(deadline=None)
@given(
    step_rad=st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3),
    shift_m=st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=3),
)
def test_a_large_step_is_followed_where_the_prediction_is_not_trusted(
    step_rad: list[float], shift_m: list[float]
) -> None:
    state = tracked_state()
    vague = FilterState(
        state.stamp_ns, state.T_chaser_target, state.velocity_m_s, state.rate_rad_s, np.eye(12) * 1e4
    )
    pose = turned(np.array(step_rad), np.array(shift_m), state.T_chaser_target)
    followed, _, accepted, _ = update(vague, pose, COVARIANCE, config=FilterConfig())
    assert accepted
    turn = followed.T_chaser_target.rotation.inv() * pose.rotation
    assert turn.magnitude() < 1e-5
    np.testing.assert_allclose(followed.T_chaser_target.translation, pose.translation, atol=1e-5)
    # what is known afterwards is the measurement, in the chaser's axes whatever the step
    expected = 2.0 * (COVARIANCE + np.diag(np.repeat([0.002, np.deg2rad(0.15)], 3) ** 2))
    jacobian = np.eye(6)
    jacobian[3:, 3:] = left_jacobian(Rotation.from_rotvec(step_rad).as_rotvec())
    np.testing.assert_allclose(
        followed.covariance[:6, :6], jacobian @ expected @ jacobian.T, rtol=1e-3, atol=1e-8
    )


def test_prediction_follows_the_twist_and_refuses_to_go_back() -> None:
    state = tracked_state()
    later = predict(state, state.stamp_ns + 3 * SECOND_NS, PLAIN)
    expected = turned(3.0 * state.rate_rad_s, 3.0 * state.velocity_m_s, state.T_chaser_target)
    np.testing.assert_allclose(later.T_chaser_target.as_matrix(), expected.as_matrix(), atol=1e-12)
    with pytest.raises(StampOrderError, match="cannot be predicted back"):
        predict(later, state.stamp_ns, PLAIN)


def test_a_prediction_turns_the_target_about_its_centre_of_mass() -> None:
    rate_rad_s, centre_0_m = np.array([0.1, 0.0, 0.05]), np.array([1.0, 2.0, 30.0])
    arm_m = -CENTRE_M
    swinging = FilterState(
        0,
        make_pose(translation_m=centre_0_m + arm_m),
        np.cross(rate_rad_s, arm_m) + np.array([0.0, 0.0, -0.2]),
        rate_rad_s,
        np.eye(12),
        CENTRE_M,
    )
    later = predict(swinging, 5 * SECOND_NS, PLAIN)
    np.testing.assert_allclose(later.T_chaser_target.apply(CENTRE_M), centre_0_m - [0.0, 0.0, 1.0])


def test_two_short_predictions_are_one_long_one() -> None:
    state = tracked_state()
    half = predict(state, state.stamp_ns + SECOND_NS // 2, PLAIN)
    twice, once = (predict(each, state.stamp_ns + SECOND_NS, PLAIN) for each in (half, state))
    np.testing.assert_allclose(
        twice.T_chaser_target.as_matrix(), once.T_chaser_target.as_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(twice.covariance, once.covariance, rtol=0.0, atol=1e-6)


def test_the_published_twist_is_the_derivative_of_the_pose_in_child_axes() -> None:
    state, half_ns = tracked_state(), 1_000_000
    middle, after = (predict(state, state.stamp_ns + step * half_ns, PLAIN) for step in (1, 2))
    odometry = to_odometry(middle, frame_id="chaser", child_frame_id="target_estimate")
    assert (odometry.stamp_ns, odometry.frame_id) == (middle.stamp_ns, "chaser")
    R = middle.T_chaser_target.rotation.as_matrix()
    moved_m = after.T_chaser_target.translation - state.T_chaser_target.translation
    R_rate = (after.T_chaser_target.as_matrix() - state.T_chaser_target.as_matrix())[:3, :3] / 2e-3
    spin = R.T @ R_rate
    np.testing.assert_allclose(odometry.linear_m_s, R.T @ moved_m / 2e-3, atol=1e-8)
    np.testing.assert_allclose(odometry.angular_rad_s, [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-7)


def test_the_published_covariances_are_those_of_sampled_errors() -> None:
    rng, state = np.random.default_rng(13), tracked_state()
    state = FilterState(
        0,
        state.T_chaser_target,
        np.array([3.0, -2.0, 1.0]),
        np.array([2.0, 1.0, -3.0]),
        state.covariance * 1e-2,
    )
    odometry = to_odometry(state, frame_id="chaser", child_frame_id="target_estimate")
    twists = []
    for error in rng.multivariate_normal(np.zeros(12), state.covariance, size=4000):
        estimate = FilterState(
            0,
            turned(error[3:6], error[:3], state.T_chaser_target),
            state.velocity_m_s + error[6:9],
            state.rate_rad_s + error[9:],
            state.covariance,
        )
        R = estimate.T_chaser_target.rotation.as_matrix()
        twists.append(np.concatenate([R.T @ estimate.velocity_m_s, R.T @ estimate.rate_rad_s]))
    sampled = np.cov(np.array(twists).T)
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    np.testing.assert_allclose(odometry.twist_covariance / scale, sampled / scale, atol=0.1)
    np.testing.assert_array_equal(odometry.pose_covariance, state.covariance[:6, :6])


@settings(deadline=None)
@given(
    phi=st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3), scale=st.sampled_from([1.0, 1e-3, 1e-5, 0.0])
)
def test_the_left_jacobian_moves_a_small_turn_out_of_the_exponential(phi: list[float], scale: float) -> None:
    vector = scale * np.array(phi)
    for axis in np.eye(3):
        small = 1e-6 * axis
        moved_turn = Rotation.from_rotvec(vector + small) * Rotation.from_rotvec(vector).inv()
        np.testing.assert_allclose(moved_turn.as_rotvec() / 1e-6, left_jacobian(vector) @ axis, atol=1e-5)


@given(
    phi=st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3), scale=st.sampled_from([1.0, 1e-3, 1e-5, 0.0])
)
def test_the_exponential_is_scipys(phi: list[float], scale: float) -> None:
    vector = scale * np.array(phi)
    np.testing.assert_allclose(exponential(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)


def test_over_thousands_of_frames_the_attitude_stays_a_rotation() -> None:
    state = replace(tracked_state(), rate_rad_s=np.array([0.3, -0.2, 0.4]))
    for _ in range(3000):
        state = predict(state, state.stamp_ns + SECOND_NS // 45, PLAIN)
        state = update(state, state.T_chaser_target, COVARIANCE, config=PLAIN).state
    R = state.T_chaser_target.as_matrix()[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("step_s", [1.0 / 15.0, 1.0])
def test_the_angle_about_a_free_axis_is_neither_measured_nor_turned(step_s: float) -> None:
    rng, runs, steps = np.random.default_rng(9), 40, 15
    axis = np.array([0.0, 0.6, 0.8])
    alike = Equivalence.of([Symmetry(tuple(axis), 12, exact=True, continuous=True)])
    nees, nis = [], []
    for _ in range(runs):
        truth = random_truth(rng, PLAIN)
        state = start(measured(truth, COVARIANCE, rng), COVARIANCE, 0, config=PLAIN, alike=alike)
        for frame in range(1, steps + 1):
            truth = moved(truth, step_s, PLAIN, rng)
            before = state.T_chaser_target
            state = predict(state, round(frame * step_s * SECOND_NS), PLAIN)
            about = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi) * axis)
            seen = measured(truth, COVARIANCE, rng) * RigidTransform.from_rotation(about)
            state, innovation, accepted, _ = update(state, seen, COVARIANCE, config=PLAIN)
            assert accepted
            nis.append(innovation)
            turn = before.rotation.inv() * state.T_chaser_target.rotation
            assert abs(turn.as_rotvec() @ axis) < 0.05 * turn.magnitude()
        odometry = to_odometry(state, frame_id="chaser", child_frame_id="target_estimate")
        assert odometry.angular_rad_s @ axis == pytest.approx(0.0, abs=1e-9)
        sigma_rad_s = np.deg2rad(PLAIN.initial_rate_sigma_deg_s)
        assert axis @ odometry.twist_covariance[3:, 3:] @ axis == pytest.approx(sigma_rad_s**2, rel=0.1)
        along = odometry.pose.rotation.apply(axis)
        sigma_rad = np.sqrt(along @ odometry.pose_covariance[3:, 3:] @ along)
        assert np.degrees(sigma_rad) == pytest.approx(103.9, abs=0.1)
        same = make_pose(
            rotation=alike.nearest(truth.pose.rotation, odometry.pose.rotation),
            translation_m=truth.pose.translation,
        )
        error = error_of(state, replace(truth, pose=same))[:6]
        nees.append(error @ np.linalg.solve(odometry.pose_covariance, error))
    assert np.mean(nees) == pytest.approx(5.0, abs=4.0 * np.sqrt(2 * 5 / runs))
    assert np.mean(nis) == pytest.approx(5.0, rel=0.15)  # the unknown rate bends the axis' path


def test_of_a_sphere_the_position_alone_is_estimated() -> None:
    rng = np.random.default_rng(11)
    alike = Equivalence.of([Symmetry(axis, 24, exact=True) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))])
    state = start(
        make_pose(translation_m=[0.0, 0.0, 5.0]),
        COVARIANCE,
        0,
        config=PLAIN,
        alike=alike,
        centre_of_mass_m=np.ones(3),
    )
    for frame in range(1, 11):
        state = predict(state, frame * SECOND_NS, PLAIN)
        seen = make_pose(rotation=Rotation.random(rng=rng), translation_m=[0.0, 0.1 * frame, 5.0])
        state, nis, accepted, _ = update(state, seen, COVARIANCE, config=PLAIN)
        assert accepted, nis
    odometry = to_odometry(state, frame_id="chaser", child_frame_id="target_estimate")
    assert odometry.pose.translation == pytest.approx([0.0, 1.0, 5.0], abs=0.05)
    assert odometry.pose.rotation.magnitude() == pytest.approx(0.0)
    assert odometry.angular_rad_s == pytest.approx(np.zeros(3))
    np.testing.assert_allclose(odometry.pose_covariance[3:], np.eye(6)[3:] * np.pi**2 / 3.0, atol=1e-12)


def test_a_measured_twin_counts_as_the_pose_that_it_looks_like() -> None:
    symmetry = Symmetry((0.0, 0.0, 1.0), 6, exact=True)
    twin = RigidTransform.from_rotation(Rotation.from_rotvec([0.0, 0.0, np.pi / 3.0]))
    seen = turned(np.array([0.002, 0.001, -0.001]), np.zeros(3), make_pose(translation_m=[0.0, 0.0, 5.0]))
    state = start(seen, COVARIANCE, 0, config=PLAIN, alike=Equivalence.of([symmetry]))
    plain, other = (update(state, pose, COVARIANCE, config=PLAIN) for pose in (seen, seen * twin))
    assert other.nis == pytest.approx(plain.nis, abs=1e-9)
    np.testing.assert_allclose(
        other.state.T_chaser_target.as_matrix(), plain.state.T_chaser_target.as_matrix(), atol=1e-12
    )


def test_the_gate_of_five_degrees_of_freedom_is_as_wide_as_that_of_six() -> None:
    config = FilterConfig(
        position_floor_m=0.0, attitude_floor_deg=0.0, tuning=FilterTuning(correlation_inflation=1.0)
    )
    alike = Equivalence.of([Symmetry((0.0, 0.0, 1.0), 12, exact=True, continuous=True)])
    noise = np.diag(COVARIANCE.diagonal())
    free = start(make_pose(), noise, 0, config=config, alike=alike)
    for nis, passes in ((15.0, True), (15.2, False)):  # 99 % quantile: 15.09, of six 16.81
        far = make_pose(translation_m=[np.sqrt(2.0 * nis * noise[0, 0]), 0.0, 0.0])
        outcome = update(free, far, noise, config=config)
        assert outcome.nis == pytest.approx(nis)
        assert outcome.accepted is passes
