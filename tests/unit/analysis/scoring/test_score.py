import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_analysis.scoring.score import (
    NEES_95,
    Errors,
    Track,
    find_errors,
    find_nees,
    interpolate,
)
from rpod_target import NO_SYMMETRY, Equivalence, Symmetry

MS = 1_000_000
R_CHASER_SENSOR = Rotation.from_euler("ZYX", [30.0, -20.0, 100.0], degrees=True)
TURN_RAD_S = np.array([0.3, -0.2, 0.1])
VELOCITY_M_S = np.array([0.05, -0.02, 0.1])


def poses_at(stamp_ns):
    """A steady turn and a straight line, for which interpolation is exact."""
    time_s = np.asarray(stamp_ns)[:, None] * 1e-9
    rotation = Rotation.from_euler("ZYX", [10.0, 20.0, 30.0], degrees=True) * Rotation.from_rotvec(
        time_s * TURN_RAD_S
    )
    return RigidTransform.from_components(np.array([0.5, -0.3, 6.0]) + time_s * VELOCITY_M_S, rotation)


def truth_every(step_ms, *, until_ms=1000, without_ms=()):
    stamp_ns = np.array([t * MS for t in range(0, until_ms + 1, step_ms) if t not in without_ms], np.int64)
    return Track(stamp_ns, poses_at(stamp_ns))


def estimates_with(stamp_ns, *, attitude_rad=(0.0, 0.0, 0.0), in_sensor_m=(0.0, 0.0, 0.0)):
    stamp_ns = np.asarray(stamp_ns, np.int64)
    true = poses_at(stamp_ns)
    rotation = true.rotation * Rotation.from_rotvec(np.asarray(attitude_rad))
    translation = true.translation + R_CHASER_SENSOR.apply(np.asarray(in_sensor_m))
    return Track(stamp_ns, RigidTransform.from_components(translation, rotation))


def errors_of(estimates, truth, covariance=None, alike=NO_SYMMETRY):
    n = len(estimates)
    return find_errors(
        estimates,
        truth,
        covariance=np.zeros((n, 6, 6)) if covariance is None else covariance,
        R_chaser_sensor=Rotation.concatenate([R_CHASER_SENSOR] * n) if n else R_CHASER_SENSOR,
        alike=alike,
    )[0]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle_rad", [1e-9, -0.02, 0.5, 3.0])
def test_a_turn_about_a_target_axis_comes_back_as_that_turn(axis, angle_rad):
    turn = np.eye(3)[axis] * angle_rad
    errors = errors_of(estimates_with([100 * MS, 333 * MS], attitude_rad=turn), truth_every(4))
    np.testing.assert_allclose(errors.attitude_rad, [turn, turn], atol=1e-12)
    np.testing.assert_allclose(errors.position_m, 0.0, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_shift_along_a_sensor_axis_comes_back_as_that_shift(axis):
    shift = np.eye(3)[axis] * 0.07
    errors = errors_of(estimates_with([101 * MS], in_sensor_m=shift), truth_every(4))
    np.testing.assert_allclose(errors.position_m, [shift], atol=1e-12)
    np.testing.assert_allclose(errors.attitude_rad, 0.0, atol=1e-9)


@given(time_ns=st.integers(0, 1000 * MS))
@settings(max_examples=50, deadline=None)
def test_truth_between_its_samples_lies_on_the_great_arc_and_the_straight_line(time_ns):
    poses, known = interpolate(truth_every(4), np.array([time_ns]))
    expected = poses_at([time_ns])
    assert known.all()
    assert (poses.rotation.inv() * expected.rotation).magnitude() < 1e-12
    np.testing.assert_allclose(poses.translation, expected.translation, atol=1e-12)


def test_a_gap_of_eight_milliseconds_is_scored_and_a_longer_one_is_not():
    truth = truth_every(4, without_ms=(104, 204, 208))
    stamps = np.array([104, 106, 201, 204, 207, 212]) * MS
    errors = errors_of(estimates_with(stamps), truth)
    np.testing.assert_array_equal(errors.scored, [True, True, False, False, False, True])


def test_a_sample_of_truth_at_the_stamp_is_enough_whatever_lies_around_it():
    truth = truth_every(100)
    np.testing.assert_array_equal(interpolate(truth, np.array([100, 150]) * MS)[1], [True, False])


def test_truth_is_not_extrapolated_beyond_its_ends():
    truth = truth_every(4, until_ms=100)
    _, known = interpolate(truth, np.array([-1, 0, 100 * MS, 100 * MS + 1]))
    np.testing.assert_array_equal(known, [False, True, True, False])


def test_truth_that_came_twice_or_out_of_order_is_sorted():
    truth = truth_every(4)
    order = np.random.default_rng(1).permutation(np.tile(np.arange(len(truth)), 2))
    shuffled = Track(truth.stamp_ns[order], truth.poses[order])
    poses, known = interpolate(shuffled, np.array([507 * MS]))
    assert known.all()
    np.testing.assert_allclose(poses.translation, poses_at([507 * MS]).translation, atol=1e-12)


def test_without_truth_nothing_is_scored():
    nothing = Track(np.zeros(0, np.int64), poses_at(np.zeros(0)))
    errors = errors_of(estimates_with([0, MS]), nothing)
    assert not errors.scored.any()
    assert np.isnan(errors.nees).all()


def test_without_estimates_there_are_no_errors():
    assert not errors_of(estimates_with(np.zeros(0)), truth_every(4)).scored.size


def test_nees_of_errors_drawn_from_the_covariance_is_chi_squared():
    random = np.random.default_rng(7)
    mixing = random.normal(size=(6, 6)) * np.array([[0.01], [0.02], [0.05], [0.1], [0.002], [0.03]])
    covariance = mixing @ mixing.T
    error = random.normal(size=(4000, 6)) @ mixing.T
    nees = find_nees(error, np.tile(covariance, (4000, 1, 1)))
    assert nees.mean() == pytest.approx(6.0, abs=0.25)
    assert (nees <= NEES_95[6]).mean() == pytest.approx(0.95, abs=0.015)


def test_nees_takes_attitude_errors_in_the_fixed_axes_of_the_frame():
    """A turn about the target's x is certain there and uncertain elsewhere: only the axes tell."""
    stamp_ns = np.array([100 * MS])
    R = poses_at(stamp_ns).rotation.as_matrix()[0]
    in_target = np.diag([1e-4, 1.0, 1.0])
    covariance = np.eye(6)[None] * 1.0
    covariance[0, 3:, 3:] = R @ in_target @ R.T
    errors = errors_of(estimates_with(stamp_ns, attitude_rad=(0.03, 0.0, 0.0)), truth_every(4), covariance)
    assert errors.nees[0] == pytest.approx(0.03**2 / 1e-4, rel=1e-6)


def test_nees_takes_positions_in_the_axes_of_the_frame_not_the_sensors():
    covariance = np.eye(6)[None] * 1.0
    axes = R_CHASER_SENSOR.as_matrix()
    covariance[0, :3, :3] = axes @ np.diag([1.0, 1.0, 1e-4]) @ axes.T
    estimates = estimates_with([100 * MS], in_sensor_m=(0.0, 0.0, 0.02))
    assert errors_of(estimates, truth_every(4), covariance).nees[0] == pytest.approx(4.0, rel=1e-6)


@pytest.mark.parametrize(
    ("symmetry", "turn_rad"),
    [(Symmetry((0, 0, 1), 2, exact=True), np.pi), (Symmetry((0, 0, 1), 2, exact=True, continuous=True), 0.8)],
)
def test_errors_and_nees_are_against_the_nearest_equivalent_attitude(symmetry, turn_rad):
    alike, off = Equivalence.of([symmetry]), Rotation.from_rotvec([0.02, 0.0, 0.0])
    turned = (off * Rotation.from_rotvec([0.0, 0.0, turn_rad])).as_rotvec()
    covariance = np.diag([1e-4] * 3 + [1e-4] * 3)[None]
    estimates = estimates_with([100 * MS], attitude_rad=turned)
    errors = errors_of(estimates, truth_every(4), covariance, alike)
    assert (errors.angle_rad[0], errors.nees[0]) == (pytest.approx(0.02), pytest.approx(4.0))
    assert errors.nees_dof == alike.dof == (5 if symmetry.continuous else 6)
    assert errors_of(estimates, truth_every(4), covariance).angle_rad[0] > 0.7


@pytest.mark.parametrize("covariance", [np.zeros((6, 6)), np.ones((6, 6)), np.full((6, 6), np.nan)])
def test_a_covariance_that_is_none_gives_no_nees(covariance):
    assert np.isnan(find_nees(np.ones((1, 6)), covariance[None])).all()


def test_off_target_begins_beyond_ten_degrees_or_thirty_centimetres():
    turns = np.deg2rad([[9.9, 0, 0], [0, 10.1, 0], [0, 0, 0], [0, 0, 0]])
    shifts = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0.31], [0.2, 0.2, 0]])
    errors = Errors(turns, shifts, np.full(4, np.nan))
    np.testing.assert_array_equal(errors.off_target, [False, True, True, False])
