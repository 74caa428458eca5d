"""Which poses are the same modulo a target's exact symmetries."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_pose.search.turns import Turns, matrices
from rpod_schemas.arrays import FloatArray
from rpod_target import Equivalence

ORIGIN = np.zeros(3)
HALF = Rotation.from_euler("z", 180.0, degrees=True).as_matrix()
HALF_TURN = Turns(np.zeros((0, 3, 3)), 0, Equivalence(np.stack((np.eye(3), HALF))))


@dataclass(frozen=True, eq=False)
class Pose:
    R: FloatArray
    t: FloatArray


def attitude(angle_deg, axis="x"):
    return Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()


@pytest.mark.parametrize(("angle_deg", "close"), [(0.0, True), (9.9, True), (10.1, False), (180.0, False)])
def test_attitudes_within_the_angle_are_close(angle_deg, close):
    (row,) = HALF_TURN.close(attitude(30.0)[None], attitude(30.0 + angle_deg)[None], 10.0)
    assert row.tolist() == [close]


def test_an_exact_symmetry_is_no_difference():
    start = attitude(30.0)
    (row,) = HALF_TURN.close(start[None], np.stack((start @ HALF, HALF @ start)), 10.0)
    assert row.tolist() == [True, False]


def test_of_close_poses_the_best_remains():
    poses = [Pose(attitude(angle_deg), ORIGIN) for angle_deg in (0.0, 4.0, 50.0, 48.0)]
    twin = Pose(poses[2].R @ HALF, ORIGIN)
    assert HALF_TURN.distinct([*poses, twin], 10.0) == [poses[0], poses[2]]


def test_no_pose_is_close_to_none():
    assert matrices([]).shape == (0, 3, 3)
    assert HALF_TURN.close(attitude(0.0)[None], matrices([]), 10.0).shape == (1, 0)
    assert HALF_TURN.distinct([], 10.0) == []
