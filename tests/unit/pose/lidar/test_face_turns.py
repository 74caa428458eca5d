"""A pose that is turned as the main faces of the target allow is compared with the right one."""

import numpy as np
import pytest
from lidar_scans import load, random_pose, scan_at, search
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.search.turns import Turns


@pytest.mark.parametrize("number", [0, 6])
def test_a_pose_turned_by_a_turn_of_the_faces_is_told_from_the_right_one(number):
    turn = Rotation.from_matrix(Turns.of(load("upper-stage")).further[number])
    T = random_pose(0)
    turned = T * RigidTransform.from_components(np.zeros(3), turn.inv())
    found = search("upper-stage").verify(scan_at(T, "upper-stage"), turned)
    angle_deg = np.degrees(turn.magnitude())
    assert found.belief.reason == f"the pose turned by {angle_deg:.0f} deg explains the scan better"


def test_turns_of_the_faces_that_others_replace_are_not_aligned_again():
    assert not len(Turns.of(load("envisat-bulky")).further)
    turns = Turns.of(load("upper-stage"))
    assert not turns.close(turns.further, turns.all, 10.0).any()
