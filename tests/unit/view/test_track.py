import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_schemas.poses import make_pose, pose_error
from rpod_view.track import Track

S = 1_000_000_000


def moving(time_s: float) -> RigidTransform:
    """A constant velocity and a constant rate about a fixed axis."""
    return make_pose(
        rotation=Rotation.from_rotvec([0.0, 0.3 * time_s, 0.0]),
        translation_m=(0.1 * time_s, 0.0, 5.0 - time_s),
    )


def track(*times_s: float, gap_s: float = 0.1, reach_s: float = 0.1, **kept: int) -> Track:
    filled = Track(gap_s=gap_s, reach_s=reach_s, **kept)
    for time_s in times_s:
        filled.add(round(time_s * S), moving(time_s))
    return filled


def assert_is(found: RigidTransform | None, expected: RigidTransform) -> None:
    assert found is not None
    attitude_rad, position_m = pose_error(expected, found)
    np.testing.assert_allclose(np.concatenate([attitude_rad, position_m]), 0.0, atol=1e-9)


@pytest.mark.parametrize("time_s", [1.0, 1.04, 1.051, 1.12, 1.2])
def test_a_steady_motion_is_known_at_between_and_beyond_the_poses(time_s):
    assert_is(track(1.0, 1.04, 1.08, 1.12).at(round(time_s * S)), moving(time_s))


def test_nothing_is_known_before_the_first_pose_in_a_gap_and_far_beyond_the_last():
    known = track(1.0, 1.04, 1.3)
    for time_s in (0.99, 1.1, 1.41):
        assert known.at(round(time_s * S)) is None


def test_of_a_single_pose_no_motion_is_known():
    assert track(1.0).at(round(1.01 * S)) is None
    assert track().at(S) is None


def test_noise_of_the_last_poses_is_not_magnified():
    steady = track(*np.arange(0.0, 0.5, 0.02))
    noisy_m = moving(0.5).translation + np.array([0.001, 0.0, 0.0])
    steady.add(round(0.5 * S), make_pose(translation_m=noisy_m))
    found = steady.at(round(0.6 * S))
    assert found is not None
    assert abs(found.translation[0] - moving(0.6).translation[0]) < 0.0025


def test_stamps_that_do_not_rise_are_left_out_and_a_run_that_begins_again_is_followed():
    known = track(1.0, 1.04, 1.02)
    assert_is(known.at(round(1.02 * S)), moving(1.02))
    assert known.newest_ns == round(1.04 * S)
    late = track(100.0, 100.04)
    late.add(round(2.0 * S), moving(2.0))
    assert late.newest_ns == 2 * S
    assert late.at(100 * S) is None


def test_only_the_last_poses_are_kept():
    long = track(*np.arange(0.0, 10.0, 0.04), kept=50)
    assert long.at(0) is None
    assert long.at(long.newest_ns - S) is not None
