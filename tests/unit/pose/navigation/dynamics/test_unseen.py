"""A target that accelerates in a direction which its frames leave open."""

from dataclasses import replace

import numpy as np
import pytest
from navigator_rig import MOUNT, SECOND_NS, START_S, View, registration, rig
from scipy.spatial.transform import Rotation

from rpod_pose.navigation.filter import UNSEEN, predict
from rpod_schemas.config.estimator.filter import FilterConfig
from rpod_schemas.poses import make_pose, pose_error
from rpod_schemas.types import Mode

HZ = 15.0
MEASURED = np.repeat([1e-3, 1e-3], 3) ** 2
OPEN = np.array([*MEASURED[:5], 1.8**2])
"""Variances of a frame, chaser axes, and of one that does not tell the turn about z."""


def shaken(time_s: float):
    """Return T_chaser_target: from one second on 3 m/s2 along x, and 60 deg/s2 about z."""
    moved_s2 = 0.5 * max(time_s - START_S - 1.0, 0.0) ** 2
    return make_pose(
        rotation=Rotation.from_euler("z", 60.0 * moved_s2, degrees=True),
        translation_m=[3.0 * moved_s2, 0.0, 3.5],
    )


def seen(made, time_s: float, *, is_open: bool, told: bool) -> View:
    """Return a frame at the true pose, or where a direction is open at the predicted turn."""
    pose, stamp_ns = shaken(time_s), round(time_s * SECOND_NS)
    if is_open:
        there = predict(made.state.history.state, stamp_ns, FilterConfig()).T_chaser_target
        pose = make_pose(rotation=there.rotation, translation_m=pose.translation)
    R = np.kron(np.eye(2), MOUNT.rotation.as_matrix())
    found = registration(MOUNT.inv() * pose, covariance=R.T @ np.diag(OPEN if is_open else MEASURED) @ R)
    belief = replace(found.belief, undetermined="the attitude is undetermined" if is_open and told else "")
    found = replace(found, belief=belief)
    return View(stamp_ns, tracked=found, acquired=(found,))


def shake(*, open_from_s: float, until_s: float, open_until_s: float = np.inf, told: bool = True):
    """Return the rig after a shake, with mode, error and standard deviation of the turn in each frame."""
    made, rows = rig(pose=shaken(START_S)), []
    for number in range(round(until_s * HZ)):
        since_s = number / HZ
        is_open = open_from_s <= since_s < open_until_s
        output = made.see(seen(made, START_S + since_s, is_open=is_open, told=told))
        assert output.status.accepted, output.status.reason
        turn_rad, _ = pose_error(output.odometry.pose, shaken(START_S + since_s))
        sigma_rad = np.sqrt(output.odometry.pose_covariance[5, 5])
        rows.append((output.status.mode, np.linalg.norm(turn_rad), sigma_rad))
    return made, rows


def test_what_no_frame_measures_may_accelerate_like_what_the_frames_show():
    """The turn is 7.5 deg within half a second, and nothing shows it but the target's other motion."""
    _, rows = shake(open_from_s=0.8, until_s=1.6)
    assert max(error for _, error, _ in rows) > np.radians(6.0)
    assert all(error < 3.3 * sigma for _, error, sigma in rows)


@pytest.mark.parametrize("told", [True, False])
def test_a_track_coasts_while_an_open_direction_is_unknown_beyond_the_alert_limit(told):
    """The method of a LIDAR does not tell that a direction is open, but its covariance does."""
    _, rows = shake(open_from_s=0.8, open_until_s=1.6, until_s=2.5, told=told)
    modes = [mode for mode, _, _ in rows]
    tracked = [error for mode, error, _ in rows if mode == Mode.TRACKING]
    assert max(tracked) < np.radians(3.0)
    assert modes[0] == modes[-1] == Mode.TRACKING
    assert Mode.COASTING in modes[round(1.3 * HZ) : round(1.6 * HZ)]
    assert Mode.LOST not in modes


def test_a_calm_track_coasts_where_the_covariance_of_its_frames_leaves_a_turn_open():
    """A frame that is vague in all directions alike, but within 10 deg, leaves none open."""
    for sigma_deg, mode in ((12.0, Mode.COASTING), (8.0, Mode.TRACKING)):
        made, pose = rig(pose=shaken(START_S)), MOUNT.inv() * shaken(START_S)
        found = registration(pose, covariance=np.diag([*MEASURED[:3], *[np.radians(sigma_deg) ** 2] * 3]))
        for number in range(30):
            stamp_ns = round((START_S + number / HZ) * SECOND_NS)
            output = made.see(View(stamp_ns, tracked=found, acquired=(found,)))
        assert output.status.accepted
        assert output.unusable
        assert output.status.mode == mode


def test_where_frames_leave_nothing_open_no_unseen_acceleration_is_assumed():
    made, rows = shake(open_from_s=np.inf, until_s=1.5)
    assert {mode for mode, _, _ in rows} == {Mode.TRACKING}
    assert UNSEEN not in made.state.history.state.places()


def test_a_calm_target_with_an_open_direction_has_no_unseen_acceleration():
    made, rows = shake(open_from_s=0.5, until_s=1.0)
    assert UNSEEN not in made.state.history.state.places()
    assert max(sigma for _, _, sigma in rows) < np.radians(1.0)


def test_the_block_ends_with_the_frames_that_leave_a_direction_open():
    during, _ = shake(open_from_s=0.8, until_s=1.4)
    assert UNSEEN in during.state.history.state.places()
    afterwards, _ = shake(open_from_s=0.8, open_until_s=1.4, until_s=1.6)
    assert UNSEEN not in afterwards.state.history.state.places()
