"""Late measurements: applied at their own stamp, as if they had come in order."""

from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_pose.navigation.filter import FilterState, predict, start
from rpod_pose.navigation.history import History, apply
from rpod_pose.navigation.pose_measurement import PoseMeasurement
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import make_pose

CONFIG = FilterConfig(max_delay_s=1.0)
SECOND_NS = 1_000_000_000
COVARIANCE = np.diag(np.repeat([0.003, 0.004], 3) ** 2)


def measurement(time_s: float, *, offset_m: float = 0.0) -> PoseMeasurement:
    rng = np.random.default_rng([17, round(time_s * 1000)])
    return PoseMeasurement(
        stamp_ns=round(time_s * SECOND_NS),
        T_chaser_target=make_pose(
            rotation=Rotation.from_rotvec(np.array([0.09, 0.0, 0.0]) * time_s + rng.normal(0, 0.004, 3)),
            translation_m=np.array([offset_m, 0.0, 7.0 - 0.2 * time_s]) + rng.normal(0, 0.003, 3),
        ),
        covariance=COVARIANCE,
    )


def begun() -> History:
    first = measurement(0.0)
    return History(start(first.T_chaser_target, first.covariance, first.stamp_ns, config=CONFIG))


def after(*measurements: PoseMeasurement, config: FilterConfig = CONFIG) -> History:
    history = begun()
    for each in measurements:
        history = apply(history, each, config).history
    return history


def assert_same(one: FilterState, other: FilterState) -> None:
    assert one.stamp_ns == other.stamp_ns
    np.testing.assert_array_equal(one.T_chaser_target.as_matrix(), other.T_chaser_target.as_matrix())
    np.testing.assert_array_equal(one.velocity_m_s, other.velocity_m_s)
    np.testing.assert_array_equal(one.rate_rad_s, other.rate_rad_s)
    np.testing.assert_array_equal(one.covariance, other.covariance)


@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_any_order_of_arrival_gives_the_same_state_bit_for_bit(order: tuple[int, ...]) -> None:
    measurements = [measurement(time_s) for time_s in (0.2, 0.4, 0.7, 1.0)]
    assert_same(after(*(measurements[i] for i in order)).state, after(*measurements).state)


def test_an_outlier_among_them_changes_nothing_of_that() -> None:
    good, outlier, newest = measurement(0.2), measurement(0.5, offset_m=3.0), measurement(0.6)
    late = apply(after(good, newest), outlier, CONFIG)
    assert not late.accepted
    assert late.nis > CONFIG.tuning.gate_nis
    assert_same(late.history.state, after(good, outlier, newest).state)


def test_a_long_run_with_a_slow_late_sensor_is_that_in_order() -> None:
    camera = [measurement(k / 15.0) for k in range(1, 61)]
    lidar = [measurement(k + 0.0123) for k in range(4)]
    arrivals = sorted(
        [(m.stamp_ns + SECOND_NS // 50, m) for m in camera]
        + [(m.stamp_ns + SECOND_NS // 4, m) for m in lidar],
        key=lambda pair: pair[0],
    )
    in_order = sorted(camera + lidar, key=lambda each: each.stamp_ns)
    history, newest_ns = begun(), 0
    for _, each in arrivals:
        history = apply(history, each, CONFIG).history
        assert history.state.stamp_ns >= newest_ns
        newest_ns = history.state.stamp_ns
    assert_same(history.state, after(*in_order).state)


def test_a_measurement_that_comes_too_late_is_not_accepted_and_changes_nothing() -> None:
    history = after(measurement(0.5), measurement(2.0))
    late = apply(history, measurement(0.99), CONFIG)
    assert not late.accepted
    assert np.isnan(late.nis)
    assert late.history is history
    assert apply(history, measurement(1.01), CONFIG).accepted


def test_a_measurement_from_before_the_start_is_not_accepted() -> None:
    history = History(start(make_pose(), COVARIANCE, 5 * SECOND_NS, config=CONFIG))
    assert not apply(history, measurement(4.9), CONFIG).accepted


def test_only_the_past_that_late_measurements_need_is_kept() -> None:
    history = after(*(measurement(k / 15.0) for k in range(1, 91)))
    stamps_ns = [step.measurement.stamp_ns for step in history.steps]
    assert stamps_ns[0] >= history.state.stamp_ns - SECOND_NS
    assert len(stamps_ns) == 16
    assert history.origin.stamp_ns < stamps_ns[0]


def test_without_a_delay_no_late_measurement_is_applied_and_a_second_of_the_past_is_kept() -> None:
    config = FilterConfig(max_delay_s=1e-9)
    history = after(*(measurement(time_s) for time_s in (0.1, 0.2, 0.9, 1.1, 1.7)), config=config)
    assert not apply(history, measurement(1.65), config).accepted
    assert apply(history, measurement(1.7), config).accepted
    assert [round(step.measurement.stamp_ns / SECOND_NS, 1) for step in history.steps] == [0.9, 1.1, 1.7]


def test_the_state_without_the_newest_measurements_is_known_although_none_may_be_late() -> None:
    config = FilterConfig(max_delay_s=1e-9)
    history = after(measurement(0.1), measurement(0.2), measurement(0.3), config=config)
    for time_s, known in ((0.25, after(measurement(0.1), measurement(0.2))), (0.05, begun())):
        found = history.without_newest(round(time_s * SECOND_NS))
        assert found is not None
        assert_same(found, known.state)
    assert history.without_newest(-1) is None


def test_the_history_it_came_from_is_untouched() -> None:
    history = after(measurement(0.2), measurement(0.4))
    steps, state = history.steps, history.state
    apply(history, measurement(0.3), CONFIG)
    assert history.steps is steps
    assert history.state is state


def test_the_prediction_at_a_stamp_comes_from_what_was_measured_up_to_it() -> None:
    early, newest = measurement(0.4), measurement(0.8)
    history = after(early, newest)
    for time_s, known in ((0.0, begun()), (0.3, begun()), (0.6, after(early)), (0.9, history)):
        stamp_ns = round(time_s * SECOND_NS)
        predicted = history.at(stamp_ns, CONFIG)
        assert predicted is not None
        assert_same(predicted, predict(known.state, stamp_ns, CONFIG))
    assert after(newest, measurement(2.0)).at(round(0.9 * SECOND_NS), CONFIG) is None


def test_measurements_of_one_stamp_stay_in_the_order_of_arrival() -> None:
    one, other = measurement(0.5), measurement(0.5, offset_m=0.01)
    steps = after(measurement(0.7), one, other).steps
    assert [step.measurement for step in steps][:2] == [one, other]
