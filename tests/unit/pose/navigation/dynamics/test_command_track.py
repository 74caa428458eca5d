"""Commanded accelerations: how they are integrated, and what follows where none holds or none is executed."""

from dataclasses import replace

import numpy as np
import pytest

from free_flight.course import AT_THEIR_WORD, Course, fly
from rpod_motion.thrust import Thrusters
from rpod_pose.navigation.dynamics.chaser import Held
from rpod_pose.navigation.dynamics.command_track import Commanded, CommandTrack
from rpod_pose.navigation.dynamics.free_motion import THRUST_ERRORS, FreeMotion
from rpod_pose.navigation.dynamics.options import evidence_of
from rpod_pose.navigation.dynamics.slewing import CHASER_TURNS, COMMAND_DOUBTED, doubts, told
from rpod_pose.navigation.filter import Block, FilterState, predict
from rpod_schemas.config.base import check
from rpod_schemas.config.estimator.dynamics import CommandTuning, DynamicsConfig
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.config.motion import CommandErrorConfig, ImuNoiseConfig
from rpod_schemas.errors import ConfigurationError
from rpod_schemas.poses import make_pose
from rpod_schemas.topics import CHASER
from rpod_schemas.types import Command
from rpod_target import load_target

BEGIN_NS, SECOND_NS = 10**18, 10**9
ALONG = np.array([0.02, 0.0, 0.01])
TURNING = Held(np.eye(3), 0.04)
"""An attitude held in the frame of a fast orbit: a chaser that turns at 2.3 deg/s."""
THRUST = Course(
    load_target("mockup"), 5.0, {"target": "torque_free"}, scans_hz=3.0, tracked_s=30.0, approach_m=2.0,
    thrusts=True, commands=CommandErrorConfig(), filter=AT_THEIR_WORD,
)  # fmt: skip


def command(after_s, acceleration=ALONG, variance=0.0):
    stamp_ns = BEGIN_NS + round(after_s * SECOND_NS)
    return Command(stamp_ns=stamp_ns, frame_id=CHASER, acceleration_m_s2=acceleration, variance=variance)


def commanded(*commands, turning=None):
    track = CommandTrack()
    assert all(track.take(each) for each in commands)
    return Commanded(turning or Held(), track, CommandTuning())


def over(chaser, begin_s, end_s):
    return chaser.step(*(BEGIN_NS + round(each * SECOND_NS) for each in (begin_s, end_s)))


def test_a_command_holds_until_the_next_one():
    step = over(commanded(command(0.0), command(0.5, np.zeros(3))), 0.0, 1.0)
    np.testing.assert_allclose(step.speed_m_s, 0.5 * ALONG, rtol=1e-12)
    np.testing.assert_allclose(step.way_m, (0.125 + 0.25) * ALONG, rtol=1e-12)
    np.testing.assert_allclose(step.unforced, 0.0, atol=1e-12)


def test_a_command_whose_square_is_zero_in_double_precision_is_none():
    step = over(commanded(command(0.0, np.array([1e-200, 0.0, 0.0]))), 0.0, 0.5)
    assert np.isfinite(step.way_by_bias).all()
    assert not step.speed_by_bias.any()


def test_a_command_holds_for_a_second_at_most():
    step = over(commanded(command(0.0)), -0.5, 3.0)
    np.testing.assert_allclose(step.speed_m_s, ALONG, rtol=1e-12)
    assert step.unforced[2] == pytest.approx(2.5)


def test_without_a_command_the_acceleration_is_unknown():
    step = over(commanded(), 0.0, 2.0)
    assert not step.speed_m_s.any()
    assert step.unforced[2] == pytest.approx(2.0)


def test_two_steps_are_one_step():
    """The parts in which one attitude is used differ, so that the sum differs by little."""
    thrusts = [command(0.1 * each, np.array([0.01, 0.002 * each, 0.0])) for each in range(20)]
    chaser = commanded(*thrusts, turning=TURNING)
    one, other, whole = (over(chaser, *span) for span in ((0.0, 0.73), (0.73, 1.9), (0.0, 1.9)))
    for field in ("speed_m_s", "speed_by_bias"):
        sum_ = getattr(one, field) + one.turn.T @ getattr(other, field)
        np.testing.assert_allclose(sum_, getattr(whole, field), atol=2e-3 * np.abs(sum_).max())
    way = one.way_m + 1.17 * one.speed_m_s + one.turn.T @ other.way_m
    np.testing.assert_allclose(way, whole.way_m, atol=2e-3 * np.abs(way).max())
    assert one.force_noise[2] + other.force_noise[2] == pytest.approx(whole.force_noise[2])


@pytest.mark.parametrize(("silent_s", "thrusts_s"), [(3.0, 0.0), (0.0, 2.0)])
def test_the_covariance_after_a_gap_is_that_of_many_short_steps(silent_s, thrusts_s):
    """No command or a thrust at the begin of a gap moves the target until its end."""
    times_s = np.arange(silent_s, 20.0, 0.5)
    chaser = commanded(*(command(each, ALONG if each < thrusts_s else np.zeros(3)) for each in times_s))
    one = many = FilterState(
        stamp_ns=BEGIN_NS,
        T_chaser_target=make_pose(translation_m=[0.0, 0.0, 5.0]),
        velocity_m_s=np.zeros(3),
        rate_rad_s=np.zeros(3),
        covariance=1e-16 * np.eye(16),
        blocks=(Block(THRUST_ERRORS, np.zeros(4), np.zeros(4)),),
        model=FreeMotion(
            chaser, acceleration_density_m2_s3=1e-14, angular_acceleration_density_rad2_s3=1e-16
        ),
    )
    for number in range(1, 201):
        many = predict(many, BEGIN_NS + number * SECOND_NS // 10, FilterConfig())
    one = predict(one, many.stamp_ns, FilterConfig())
    np.testing.assert_allclose(one.covariance[:12, :12], many.covariance[:12, :12], rtol=1e-6, atol=1e-12)


def test_a_turning_chaser_thrusts_along_its_own_axes():
    step = over(commanded(*(command(0.5 * each) for each in range(4)), turning=TURNING), 0.0, 2.0)
    times_s = (np.arange(2000) + 0.5) / 1000.0
    turns = [TURNING.turn(0, round(each * SECOND_NS)) for each in times_s]
    np.testing.assert_allclose(step.speed_m_s, 0.001 * sum(turn.T @ ALONG for turn in turns), rtol=1e-3)


def test_the_derivatives_are_those_of_the_executed_acceleration():
    errors, sigma = np.array([0.5, -0.3, 0.8, 0.2]), 1e-4
    step = over(commanded(command(0.0, variance=sigma**2), turning=TURNING), 0.0, 0.8)
    e = ALONG / np.linalg.norm(ALONG)
    executed = ALONG + sigma * (errors[0] * e + np.cross(errors[1:], e))
    wrong = over(commanded(command(0.0, executed), turning=TURNING), 0.0, 0.8)
    np.testing.assert_allclose(
        step.speed_m_s + step.speed_by_bias @ errors, wrong.speed_m_s, rtol=1e-9, atol=1e-15
    )
    np.testing.assert_allclose(step.way_m + step.way_by_bias @ errors, wrong.way_m, rtol=1e-9, atol=1e-15)


def test_a_command_that_is_not_newer_is_not_used():
    track = CommandTrack()
    assert track.take(command(1.0))
    assert not track.take(command(1.0))
    assert not track.take(command(0.5))
    assert not track.covers(BEGIN_NS)  # the period is not known yet
    assert track.is_known(BEGIN_NS + round(1.9 * SECOND_NS))
    assert not track.is_known(BEGIN_NS + round(2.1 * SECOND_NS))
    assert track.take(command(1.2))
    assert track.covers(BEGIN_NS + round(1.3 * SECOND_NS))
    track.forget()
    assert track.take(command(0.5))


def test_thrust_in_a_gap_is_known_by_the_commands():
    found = [fly(replace(THRUST, dynamics={"target": "torque_free", "command": {}}), seed) for seed in (1, 2)]
    without = fly(THRUST, 1)
    assert without.position_m > 5.0 * found[0].position_m
    assert all(each.position_m < 0.15 and each.nees < 20.0 for each in found)
    assert found[0].sigma_m < 0.3
    assert "thrust_errors_sigma" in evidence_of(found[0].state)


def test_commands_that_are_not_executed_are_doubted_and_told(monkeypatch):
    """The valves stay shut, so that the chaser drifts."""
    monkeypatch.setattr(Thrusters, "command", lambda _, __, time_s: command(time_s, ALONG))
    course = replace(
        THRUST, thrusts=False, approach_m=0.3, gap_s=0.0, dynamics={"target": "torque_free", "command": {}}
    )
    found = fly(course, 1)
    assert doubts(found.state) == (CHASER_TURNS, COMMAND_DOUBTED)
    assert evidence_of(found.state)[COMMAND_DOUBTED] == 1.0
    assert "guidance/command" in told(doubts(found.state))
    assert found.tracked_m < 0.02


def test_a_gyro_stays_in_use_while_commands_are_doubted(monkeypatch):
    """The valves of a slewing chaser stay shut; without its gyro it would be 4 to 8 deg off after 10 s."""
    monkeypatch.setattr(Thrusters, "command", lambda _, __, time_s: command(time_s, ALONG))
    dynamics = {"target": "torque_free", "imu": {}, "command": {}}
    course = replace(
        THRUST, thrusts=False, slews=True, approach_m=0.3, gap_s=10.0, imu=ImuNoiseConfig(), dynamics=dynamics
    )
    found = fly(course, 1)
    assert doubts(found.state) == (COMMAND_DOUBTED,)
    assert "gyro" in told(doubts(found.state))
    assert {"gyro_bias_rad_s", COMMAND_DOUBTED} <= set(evidence_of(found.state))
    assert "thrust_errors" not in evidence_of(found.state)
    assert found.attitude_deg < 0.5
    assert found.sigma_deg < 0.5
    assert found.nees < 17.0


def test_commands_that_are_right_again_are_used_again(monkeypatch):
    """The valves open after 40 s; a minute later the commands are believed."""
    right = Thrusters.command

    def told(self, stamp_ns, time_s):
        return right(self, stamp_ns, time_s) if time_s > 40.0 else command(time_s)

    monkeypatch.setattr(Thrusters, "command", told)
    course = replace(
        THRUST, thrusts=False, approach_m=0.3, tracked_s=125.0, gap_s=0.0, imu=ImuNoiseConfig(),
        dynamics={"target": "torque_free", "imu": {}, "command": {}},
    )  # fmt: skip
    assert doubts(fly(replace(course, tracked_s=35.0), 1).state) == (COMMAND_DOUBTED,)
    found = fly(course, 1)
    assert doubts(found.state) == ()
    assert "thrust_errors_sigma" in evidence_of(found.state)


def test_two_sources_of_one_acceleration_are_refused():
    both = {"command": {}, "imu": {"acceleration_bias_sigma_m_s2": 1e-4}}
    with pytest.raises(ConfigurationError, match="leave out command, or imu"):
        check(DynamicsConfig, both, source="here")
