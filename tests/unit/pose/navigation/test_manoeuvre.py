"""A target that accelerates by more than the filter expects, seen once a second or fifteen times."""

from dataclasses import replace

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, View, good, registration, rig, tracking, turned
from scipy.spatial.transform import Rotation

from rpod_pose.belief import Belief
from rpod_pose.navigation.dynamics.chaser import Held
from rpod_pose.navigation.dynamics.free_motion import FreeMotion
from rpod_pose.navigation.dynamics.manoeuvre import needed
from rpod_pose.navigation.dynamics.torque_free import Inertia
from rpod_pose.navigation.filter import CALM, predict, start
from rpod_pose.navigation.history import History, apply
from rpod_pose.navigation.integrity.older import older_solutions
from rpod_pose.navigation.pose_measurement import Origin, PoseMeasurement, started
from rpod_pose.ports import ErrorParts
from rpod_schemas.config.estimator.filter import FilterConfig, FilterTuning
from rpod_schemas.config.estimator.integrity import IntegrityTuning
from rpod_schemas.config.sensor import AlertLimit
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import BeliefLevel, Mode

NOISE = np.repeat([0.01, 0.003], 3)


def swaying(time_s: float, amplitude_deg: float = 30.0, period_s: float = 11.0):
    """Return T_chaser_target: at most 17 deg/s and 10 deg/s2."""
    angle_deg = amplitude_deg * np.sin(2.0 * np.pi * (time_s - START_S) / period_s)
    return make_pose(
        rotation=Rotation.from_euler("y", angle_deg, degrees=True), translation_m=[0.0, 0.0, 3.5]
    )


def seen(pose, time_s: float, rng=None, **changes) -> View:
    found = registration(MOUNT.inv() * pose, **changes)
    if rng is not None:
        off = NOISE * rng.standard_normal(6)
        moved = make_pose(
            rotation=Rotation.from_rotvec(off[3:]) * found.T_sensor_target.rotation,
            translation_m=found.T_sensor_target.translation + off[:3],
        )
        found = replace(found, T_sensor_target=moved)
    return View(round(time_s * SECOND_NS), tracked=found, acquired=(found,))


def test_a_target_that_sways_by_ten_degrees_per_second_squared_is_tracked_once_a_second():
    made, rng, errors, factors = rig(pose=swaying(START_S)), np.random.default_rng(5), [], []
    for second in range(40):
        output = made.see(seen(swaying(START_S + second), START_S + second, rng))
        assert (output.status.accepted, output.status.mode) == (True, Mode.TRACKING)
        turn_rad, shift_m = pose_error(output.odometry.pose, swaying(START_S + second))
        errors.append(np.concatenate([shift_m, turn_rad]))
        covariance = output.odometry.pose_covariance
        factors.append(made.state.history.state.manoeuvre)
    assert max(factor.angular for factor in factors) > 10.0
    assert max(factor.acceleration for factor in factors) < 2.0
    assert np.sqrt(np.square(errors).mean(axis=0)).max() < 0.02
    assert np.sqrt(np.diag(covariance)).max() < 0.03


def test_the_filter_is_calm_again_after_the_manoeuvre():
    made = rig(pose=swaying(START_S))
    for second in range(14):
        made.see(seen(swaying(START_S + second), START_S + second))
    assert (
        made.see(seen(swaying(START_S + 14.0), START_S + 14)).status.evidence["angular_acceleration_factor"]
        > 1.0
    )
    for second in range(15, 26):  # it stops where it turns back
        assert made.see(seen(swaying(START_S + 14.0), START_S + second)).status.accepted
    assert made.state.history.state.manoeuvre == CALM


@pytest.mark.parametrize("rate_hz", [15.0, 45.0])
def test_a_fast_sensor_does_not_lag_behind_a_target_that_sways(rate_hz):
    """Each innovation is within the gate, but they agree with each other."""
    made, rng, normalised, factors = rig(pose=swaying(START_S)), np.random.default_rng(5), [], []
    for time_s in START_S + np.arange(0.0, 10.0, 1.0 / rate_hz):
        pose = swaying(time_s, amplitude_deg=8.0, period_s=9.0)
        output = made.see(seen(pose, time_s, rng))
        assert output.status.accepted, output.status.reason
        if time_s > START_S + 1.0 and output.odometry is not None:
            turn_rad, shift_m = pose_error(output.odometry.pose, pose)
            error = np.concatenate([shift_m, turn_rad])
            normalised.append(error @ np.linalg.solve(output.odometry.pose_covariance, error))
            factors.append(made.state.history.state.factors)
    assert np.mean(normalised) < 6.0
    assert max(factor.angular for factor in factors) > 3.0
    assert max(factor.acceleration for factor in factors) < 3.0
    assert factors[-1].angular < 30.0


def test_a_pose_that_no_allowed_acceleration_explains_is_refused_with_the_setting_to_change():
    made = tracking(rate_hz=1.0, until_s=START_S + 5.0)
    output = made.see(turned(START_S + 6.0, 19.0))
    assert not output.status.accepted
    reason = output.status.reason
    assert reason.startswith("gate: nis")
    assert "limit 16.8: 19.0 deg and " in reason
    assert "raise filter.angular_acceleration_density_rad2_s3 to " in reason
    assert "filter.acceleration_density" not in reason
    value = float(reason.rsplit(" ", 1)[1])
    config = made.navigator._settings.filter
    taught = tracking(
        rate_hz=1.0,
        until_s=START_S + 5.0,
        filter_config=config.model_copy(update={"angular_acceleration_density_rad2_s3": value}),
    )
    assert taught.see(turned(START_S + 6.0, 19.0)).status.accepted


def test_a_frame_that_does_not_prove_its_pose_changes_no_density():
    made = tracking(rate_hz=1.0, until_s=START_S + 5.0)
    view = turned(START_S + 6.0, 9.0)
    doubtful = replace(view.tracked, belief=Belief(BeliefLevel.DOUBTFUL, "few returns"))
    assert not made.see(replace(view, tracked=doubtful)).status.accepted
    assert made.state.history.state.manoeuvre == CALM
    assert made.see(turned(START_S + 7.0, 9.0)).status.accepted


@pytest.mark.parametrize("angle_deg", [3.0, 4.0])
def test_a_fast_sensor_waits_for_a_second_frame_where_no_allowed_acceleration_explains_the_first(angle_deg):
    made = tracking(until_s=START_S + 2.0)
    assert not made.see(turned(START_S + 2.1, angle_deg)).status.accepted
    assert made.state.history.state.manoeuvre == CALM


def pushed(time_s: float, period_s: float = 1.0):
    """Return T_chaser_target: 3 m/s2 and 60 deg/s2, whose sign changes each half period from the start on."""
    since_s = max(time_s - START_S - 1.0, 0.0)
    phase = (since_s / period_s + 0.25) % 1.0
    # the second integral of a square wave; each half period is a parabola that begins and ends at 0
    half, sign = (phase, 1.0) if phase < 0.5 else (phase - 0.5, -1.0)
    moved_s2 = sign * 0.5 * half * (half - 0.5) * period_s**2 + 0.03125 * period_s**2
    return make_pose(
        rotation=Rotation.from_euler("y", 60.0 * moved_s2, degrees=True),
        translation_m=[3.0 * moved_s2, 0.0, 3.5],
    )


def test_a_fast_sensor_follows_a_target_whose_acceleration_jumps():
    """Poses of 15 Hz: none is refused, as the gate did with every fourth, and the covariance holds."""
    made, rng, nees, proven = rig(pose=pushed(START_S)), np.random.default_rng(3), [], []
    for number in range(75):
        time_s = START_S + number / 15.0
        output = made.see(seen(pushed(time_s), time_s, rng))
        assert (output.status.accepted, output.status.mode) == (True, Mode.TRACKING)
        beside = made.state.history.state.steady
        proven.append(beside is not None and not beside.by_chance)
        turn_rad, shift_m = pose_error(output.odometry.pose, pushed(time_s))
        assert np.degrees(np.linalg.norm(turn_rad)) < 1.0
        error = np.concatenate([shift_m, turn_rad])
        nees.append(error @ np.linalg.solve(output.odometry.pose_covariance, error))
    assert np.mean(nees) < 6.0
    assert any(proven), "the poses after a refused one show that it was no chance"


def test_frames_that_leave_one_axis_open_show_an_acceleration_about_the_others():
    """A face that fills the image tells nothing of the turn about its normal, but the rest as before."""
    made, rng, open_rad = rig(pose=pushed(START_S)), np.random.default_rng(3), 1.8
    told = "the attitude is undetermined"
    for number in range(75):
        time_s = START_S + number / 15.0
        view = seen(pushed(time_s), time_s, rng, covariance=np.diag([1e-4] * 3 + [1e-5, 1e-5, open_rad**2]))
        if number > 3:
            belief = replace(view.tracked.belief, undetermined=told)
            view = replace(view, tracked=replace(view.tracked, belief=belief))
        output = made.see(view)
        assert output.status.accepted, output.status.reason


def test_a_pose_that_its_frame_does_not_prove_confirms_no_refused_one():
    made = tracking(until_s=START_S + 2.0)
    assert not made.see(turned(START_S + 2.1, 5.0)).status.accepted
    view = turned(START_S + 2.2, 5.0)
    doubtful = replace(view.tracked, belief=Belief(BeliefLevel.DOUBTFUL, "few edges"))
    assert not made.see(replace(view, tracked=doubtful)).status.accepted
    assert made.see(turned(START_S + 2.3, 5.0)).status.accepted


def test_a_first_motion_beyond_the_priors_names_the_prior():
    made = rig()
    made.see(good(START_S))
    assert "raise filter.initial_rate_sigma_deg_s to a third of the largest rate" in (
        made.see(turned(START_S + 0.5, 15.0)).status.reason
    )


LASTING_RAD = np.radians(0.1)
PARTS = ErrorParts(
    white=np.diag(NOISE**2),
    of_sensor=np.zeros((6, 6)),
    of_image=np.diag([1e-6] * 3 + [LASTING_RAD**2] * 3),
    image_turn_rad=np.radians(0.5),
    of_model=np.diag([1e-6] * 3 + [LASTING_RAD**2] * 3),
)
"""Noise of a frame, and errors that last: as large as a third of the lag behind the target below."""
CONSIDERED = FilterConfig(errors="considered")


@pytest.mark.parametrize("lasting_deg", [0.1, 0.3])
def test_errors_that_last_do_not_hide_that_the_estimate_lags_behind_the_target(lasting_deg):
    """An estimate takes them over, so that they are not in its innovations. Their size hid the lag before."""
    of_model = np.diag([1e-8] * 3 + [np.radians(lasting_deg) ** 2] * 3)
    parts = ErrorParts.lasting_model(np.diag(np.repeat([0.003, 0.003], 3) ** 2), of_model)
    made, errors_deg, factors = rig(pose=swaying(START_S), filter_config=CONSIDERED), [], []
    for time_s in START_S + np.arange(0.0, 9.0, 1.0 / 15.0):
        pose = swaying(time_s, amplitude_deg=8.0, period_s=9.0)
        output = made.see(seen(pose, time_s, parts=parts))
        if time_s > START_S + 2.0:
            turn_rad, _ = pose_error(output.odometry.pose, pose)
            errors_deg.append(np.degrees(np.linalg.norm(turn_rad)))
            factors.append(made.state.history.state.lag.angular)
    assert max(factors) > 3.0
    assert np.sqrt(np.mean(np.square(errors_deg))) < 0.15


def drawn(rng, covariance):
    return rng.multivariate_normal(np.zeros(6), covariance)


def test_the_sum_of_innovations_is_as_large_as_its_covariance_says_beside_errors_that_last():
    """A filter that only considers errors does not leave its innovations independent."""
    config = FilterConfig(
        errors="considered", acceleration_density_m2_s3=1e-9, angular_acceleration_density_rad2_s3=1e-9,
        initial_velocity_sigma_m_s=0.01, initial_rate_sigma_deg_s=2.0, tuning=FilterTuning(gate_nis=1e9),
    )  # fmt: skip
    step_s, squares = 0.1, []
    for seed in range(60):
        rng, history = np.random.default_rng(seed), None
        rate_rad_s = np.radians(config.initial_rate_sigma_deg_s) * rng.standard_normal(3)
        velocity_m_s = config.initial_velocity_sigma_m_s * rng.standard_normal(3)
        of_image, of_model = drawn(rng, PARTS.of_image), drawn(rng, PARTS.of_model)
        for number in range(25):
            time_s = number * step_s
            kept = np.exp(-np.linalg.norm(rate_rad_s) * step_s / PARTS.image_turn_rad)
            of_image = kept * of_image + np.sqrt(1.0 - kept**2) * drawn(rng, PARTS.of_image)
            turn = Rotation.from_rotvec(rate_rad_s * time_s)
            off = np.kron(np.eye(2), turn.as_matrix()) @ (of_image + of_model) + drawn(rng, PARTS.white)
            place_m = np.array([0.0, 0.0, 4.0]) + velocity_m_s * time_s + off[:3]
            pose = make_pose(rotation=Rotation.from_rotvec(off[3:]) * turn, translation_m=place_m)
            measured = PoseMeasurement(
                round(time_s * SECOND_NS), pose, np.eye(6), Origin("pmd", make_pose(), PARTS), alone=True
            )
            if history is None:
                history = History(started(measured, config=config))
            else:
                history = apply(history, measured, config).history
        found = history.state.sums[1]
        squares.append(found.difference @ np.linalg.solve(found.covariance, found.difference))
    # the mean of 60 values of chi-squared with 3 degrees of freedom has a standard deviation of 0.32
    assert 1.8 < np.mean(squares) < 4.2


def test_a_sum_of_innovations_fades_while_frames_prove_nothing():
    made = tracking(until_s=START_S + 2.0, alert=AlertLimit(attitude_deg=90.0, position_m=5.0))
    assert made.state.history.state.sums[1].weights > 5.0
    for number in range(1, 9):
        view = good(START_S + 2.0 + 0.6 * number)
        doubtful = replace(view.tracked, belief=Belief(BeliefLevel.DOUBTFUL, "few edges"))
        assert made.see(replace(view, tracked=doubtful)).status.accepted
    assert made.state.history.state.sums[1].weights < 0.1


def test_a_model_that_states_its_own_noise_is_not_said_to_be_raised():
    """Without torque no angular acceleration is raised; that of the position has its least factor."""
    config, pose = FilterConfig(), make_pose(translation_m=[0.0, 0.0, 5.0])
    known = np.diag(np.repeat([1e-3, 1e-3], 3) ** 2)
    begun = start(pose, known, 0, config=config)
    model = FreeMotion(Held(), Inertia(np.diag([1.0, 2.0, 3.0])), angular_acceleration_density_rad2_s3=1e-11)
    calm = replace(begun, model=model, covariance=1e-6 * np.eye(12))
    off = make_pose(rotation=Rotation.from_rotvec([0.1, 0.0, 0.0]), translation_m=[0.2, 0.0, 5.0])
    measured = PoseMeasurement(SECOND_NS // 2, off, known, alone=True)
    predicted = predict(calm, measured.stamp_ns, config)
    factors = needed(calm, predicted, measured, config)
    assert factors.angular == 1.0
    assert 1.0 < factors.acceleration < 1e4
    assert calm.may_be_raised == (True, False)


def test_a_turn_that_no_acceleration_explains_leaves_the_factor_of_the_position_known():
    """A half turn within a 45th of a second, beside a place that is where it was predicted."""
    config, pose, known = FilterConfig(), make_pose(translation_m=[0.0, 0.0, 5.0]), np.diag(NOISE**2)
    calm = replace(start(pose, known, 0, config=config), covariance=1e-6 * np.eye(12))
    half_turn = make_pose(rotation=Rotation.from_rotvec([0.0, 3.1, 0.0]), translation_m=pose.translation)
    measured = PoseMeasurement(round(SECOND_NS / 45.0), half_turn, known, alone=True)
    factors = needed(calm, predict(calm, measured.stamp_ns, config), measured, config)
    assert factors == (1.0, np.inf)


STATED = ErrorParts.lasting_model(np.diag(NOISE**2), np.zeros((6, 6)))


def steady(number: int, rng, turned_deg: float = 0.0, rate_hz: float = 15.0) -> PoseMeasurement:
    """Return a pose of a steady spin, with noise as stated, turned by an angle."""
    time_s, off = number / rate_hz, NOISE * rng.standard_normal(6)
    turn = Rotation.from_rotvec(off[3:]) * Rotation.from_rotvec([0.0, turned_deg, 0.0], degrees=True)
    pose = make_pose(
        rotation=turn * Rotation.from_rotvec([5.0 * time_s, 0.0, 0.0], degrees=True),
        translation_m=np.array([0.0, 0.0, 7.0 - 0.25 * time_s]) + off[:3],
    )
    stamp_ns = round(time_s * SECOND_NS)
    return PoseMeasurement(stamp_ns, pose, np.diag(NOISE**2), Origin("pmd", make_pose(), STATED), alone=True)


def test_a_refusal_by_chance_raises_the_densities_for_a_few_frames():
    """The gate refuses one pose in a hundred. Each began a manoeuvre that kept itself up for seconds."""
    rng, history, raised = np.random.default_rng(1), None, []
    for number in range(700):
        measured = steady(number, rng, rate_hz=45.0)
        if history is None:
            history = History(started(measured, config=CONSIDERED))
            continue
        history = apply(history, measured, CONSIDERED).history
        raised.append(history.state.manoeuvre.angular > 10.0)
    assert 0.0 < np.mean(raised[45:]) < 0.04


def test_a_single_wrong_pose_leaves_nothing_in_the_track_that_followed_it():
    """It is turned by 1 deg, which an acceleration of a mission may do: the track follows it at first."""
    with_it = History(started(steady(0, np.random.default_rng(3)), config=CONSIDERED))
    without, rng = with_it, np.random.default_rng(4)
    for number in range(1, 105):
        wrong = number == 90
        measured = steady(number, rng, turned_deg=1.0 if wrong else 0.0)
        applied = apply(with_it, measured, CONSIDERED)
        with_it = applied.history
        if wrong:
            assert applied.accepted
            assert with_it.state.manoeuvre.angular > 10.0
        else:
            without = apply(without, measured, CONSIDERED).history
    assert with_it.state.manoeuvre == CALM
    assert np.allclose(with_it.state.covariance, without.state.covariance, rtol=1e-9, atol=0.0)
    assert np.allclose(with_it.state.rate_rad_s, without.state.rate_rad_s, rtol=1e-9)


def test_the_solution_without_the_newest_frames_weighs_whether_a_pose_was_refused_by_chance():
    """The frames that decide are among the newest ones. A mission turns by 1.2 deg in this time."""
    history = History(started(steady(0, np.random.default_rng(3)), config=CONSIDERED))
    rng = np.random.default_rng(4)
    for number in range(1, 95):
        measured = steady(number, rng, turned_deg=1.0 if number == 90 else 0.0)
        history = apply(history, measured, CONSIDERED).history
    tuning = IntegrityTuning()
    accelerating, calm = older_solutions(history, history.state, CONSIDERED, tuning)
    assert accelerating.probability + calm.probability == pytest.approx(tuning.group_share)
    assert 0.0 < accelerating.probability < calm.probability
    worst_deg = [
        np.degrees(np.sqrt(np.linalg.eigvalsh(x.covariance[3:, 3:])[-1])) for x in (accelerating, calm)
    ]
    assert worst_deg[1] < 0.4 < worst_deg[0] < 1.4
