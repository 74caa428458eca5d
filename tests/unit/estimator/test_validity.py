"""When an estimate is valid: a robot must not move on a dead, frozen or contradicted input."""

from threading import Event

import numpy as np
import pytest

from rpod_estimator.frame_reader import Arrived
from rpod_estimator.validity import Beacon, Validity
from rpod_pose.navigation.state import Output
from rpod_runtime import BusClock, WallClock
from rpod_schemas.poses import make_pose
from rpod_schemas.types import EstimatorStatus, Mode, Odometry

SECOND_NS = 1_000_000_000


def result(number_s, *, sensor="pmd", mode=Mode.TRACKING, reason="", unusable=""):
    stamp_ns = round(number_s * SECOND_NS) + 1
    status = EstimatorStatus(
        stamp_ns=stamp_ns, frame_id="chaser", mode=mode, sensor=sensor, accepted=not reason, reason=reason
    )
    odometry = Odometry(
        stamp_ns=stamp_ns, frame_id="chaser", child_frame_id="target_estimate", pose=make_pose(),
        linear_m_s=np.zeros(3), angular_rad_s=np.zeros(3),
    )  # fmt: skip
    return Output(status, odometry if mode == Mode.TRACKING else None, unusable=unusable)


def fed(validity, *, period_s=1 / 16, frames=32, start_s=0.0, sensor="pmd", reason="", refused="", repeats=0):
    """Process frames; return the time of the last one."""
    for number in range(frames):
        now_s = start_s + number * period_s
        stamp_ns = round(now_s * SECOND_NS) + 1
        arrived = Arrived(sensor, stamp_ns, now_s, None, reason, refused, repeats and repeats + number)
        validity.take(result(now_s, sensor=sensor, reason=reason), arrived, now_s=now_s)
    return now_s


def at(validity, now_s):
    found = validity.at(now_s, round(now_s * SECOND_NS) + 1)
    assert found.valid == (not found.reason)
    return found


def test_an_estimate_is_valid_for_a_fifth_of_a_second_after_its_last_measurement():
    validity = Validity(0.2)
    last_s = fed(validity)
    assert at(validity, last_s + 0.19).valid
    assert at(validity, last_s + 0.19).age_s == pytest.approx(0.19)
    assert at(validity, last_s + 0.25).reason == "no new measurement was accepted for 0.25 s"
    assert validity.deadline_s() == pytest.approx(last_s + 0.2)


def test_a_track_without_an_accepted_measurement_is_told_as_such():
    validity = Validity(0.2)
    validity.take(result(5e4), now_s=5e4)
    assert at(validity, 5e4 + 1.0).reason == "no measurement was accepted yet"
    fed(validity, start_s=5e4, frames=1, reason="refused")
    assert at(validity, 5e4 + 1.0).reason == "no measurement was accepted yet"


def test_a_slow_sensor_has_one_and_a_half_of_its_periods():
    validity = Validity(0.2)
    last_s = fed(validity, period_s=1.0, frames=5)
    assert at(validity, last_s + 1.4).valid
    assert not at(validity, last_s + 1.6).valid


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"reason": "gate: nis 99"}, "no new measurement was accepted"),
        ({"repeats": 1}, "pmd is frozen: its last 9 frames are identical"),
    ],
    ids=["rejected", "frozen"],
)
def test_frames_that_support_nothing_new_do_not_keep_it_valid(how, words):
    validity = Validity(0.2)
    last_s = fed(validity)
    assert at(validity, fed(validity, start_s=last_s + 1 / 16, frames=2, **how)).valid
    now_s = fed(validity, start_s=last_s + 1 / 16, frames=8, **how)
    assert words in at(validity, now_s).reason


def test_a_frozen_sensor_makes_it_invalid_although_another_one_is_alive_and_a_dead_one_does_not():
    frozen, dead = Validity(0.2), Validity(0.2)
    for validity in (frozen, dead):
        fed(validity, sensor="lidar", period_s=1.0, frames=3)
        fed(validity, start_s=0.0, frames=33)
    fed(frozen, start_s=2.05, frames=8, repeats=1)
    assert "pmd is frozen" in at(frozen, 2.5).reason
    assert at(dead, 2.5).valid


def test_another_mount_makes_it_invalid_at_once():
    validity = Validity(0.2)
    last_s = fed(validity)
    moved = {"reason": "other_setup: the mount has moved by 1.000 m", "refused": "other_setup"}
    now_s = fed(validity, start_s=last_s + 1 / 16, frames=1, **moved)
    assert at(validity, now_s).reason == "pmd: other_setup: the mount has moved by 1.000 m"
    assert at(validity, fed(validity, start_s=now_s + 1 / 16, frames=1)).valid


@pytest.mark.parametrize(
    "last",
    [
        {"repeats": 1},
        {"repeats": 4},
        {"reason": "other_setup: the mount has moved by 1.000 m", "refused": "other_setup"},
    ],
    ids=["one repetition", "frozen", "contradicted"],
)
def test_a_sensor_that_is_switched_off_does_not_keep_the_estimates_of_another_one_invalid(last):
    validity = Validity(0.2)
    last_s = fed(validity, sensor="pmd")
    off_s = fed(validity, sensor="pmd", start_s=last_s + 1 / 16, frames=1, **last)
    assert at(validity, fed(validity, sensor="lidar", start_s=off_s + 0.1, frames=8)).valid


def test_an_estimate_whose_own_covariance_is_beyond_the_alert_limit_is_not_valid():
    validity = Validity(0.2)
    last_s = fed(validity)
    vague = "sigma of the attitude 4.0 deg, alert limit 3 deg"
    validity.take(result(last_s + 0.06, unusable=vague), now_s=last_s + 0.06)
    assert at(validity, last_s + 0.06).reason == vague
    assert at(validity, last_s + 0.3).reason == "no new measurement was accepted for 0.30 s"
    assert at(validity, fed(validity, start_s=last_s + 0.06)).valid


def test_what_is_not_tracked_is_not_valid():
    validity = Validity(0.2)
    assert at(validity, 0.0).reason == "the target is not tracked: ACQUIRING"
    last_s = fed(validity)
    validity.take(result(last_s, mode=Mode.LOST), now_s=last_s)
    assert at(validity, last_s).reason == "the target is not tracked: LOST"


def test_the_end_of_validity_is_told_by_a_thread_of_its_own():
    validity, told, ended = Validity(0.05), [], Event()

    def tell(message):
        told.append(message)
        if "no new measurement" in message.reason:
            ended.set()

    with Beacon(validity, tell, WallClock()) as beacon:
        now_s = beacon.now_s()
        validity.take(result(0.0), Arrived("pmd", 1, now_s, None), now_s=now_s)
        assert ended.wait(10.0)
    assert told[-1].reason == "the estimator has ended"


def test_where_time_comes_from_the_bus_no_thread_tells_anything():
    told = []
    with Beacon(Validity(0.05), told.append, BusClock()) as beacon:
        assert beacon.now_s() == 0.0
    assert told == []


def test_where_time_comes_from_the_bus_the_age_counts_to_the_newest_stamp_whatever_the_clock_says():
    validity, clock = Validity(0.2), BusClock()
    with Beacon(validity, print, clock) as beacon:
        for number in range(10, 16):
            reason = "" if number < 13 else "no"
            arrived = Arrived("pmd", number * SECOND_NS // 10, 0.0, None, reason)
            told = beacon.take(result(number / 10, reason=reason), arrived)
            assert told.age_s == pytest.approx(max(number - 12, 0) / 10, abs=1e-6)
            assert told.valid == (number < 15), told.reason
    assert clock.now_ns() == 0


def test_after_a_clock_was_set_back_and_a_reset_the_age_is_that_of_the_new_stamps():
    validity = Validity(0.2)
    fed(validity, start_s=5_000.0)
    last_s = fed(validity, start_s=100.0)
    assert at(validity, last_s + 0.1).age_s == pytest.approx(0.1)
