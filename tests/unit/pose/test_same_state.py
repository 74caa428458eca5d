"""Attitudes with angles of joints that show the same surface."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_pose.belief import Angle
from rpod_pose.search.same_state import State, are_same
from rpod_target import NO_SYMMETRY, Equivalence, Symmetry

AXES = {"drive": np.array([0.0, 1.0, 0.0])}
START = Rotation.from_euler("ZYX", [30.0, 35.0, 160.0], degrees=True)


def state(turn: Rotation, angle_deg: float, sigma_deg: float = 0.0) -> State:
    return State((START * turn).as_matrix(), {"drive": Angle(*np.deg2rad([angle_deg, sigma_deg]))})


@pytest.mark.parametrize(
    ("name", "axis", "same_deg", "other_deg"),
    [("x", (1.0, 0.0, 0.0), -33.0, 33.0), ("y", (0.0, 1.0, 0.0), 33.0, -33.0)],
    ids=["across the joint's axis", "about the joint's axis"],
)
def test_a_half_turn_of_a_symmetrical_target_is_the_same_at_the_angle_to_which_it_turns_the_joint(
    name, axis, same_deg, other_deg
):
    alike = Equivalence.of([Symmetry(axis, 2, exact=True)])
    turn = Rotation.from_euler(name, 180.0, degrees=True)
    one = state(Rotation.identity(), 33.0)
    at = {"alike": alike, "axes": AXES, "within_rad": np.deg2rad(5.0)}
    assert are_same(one, state(turn, same_deg), **at)
    assert not are_same(one, state(turn, other_deg), **at)
    assert not are_same(one, state(turn, same_deg), **{**at, "alike": NO_SYMMETRY})


def test_a_turn_that_moves_the_axis_elsewhere_makes_nothing_the_same():
    alike = Equivalence.of([Symmetry((0.0, 0.0, 1.0), 4, exact=True)])
    quarter = Rotation.from_euler("z", 90.0, degrees=True)
    one, other = state(Rotation.identity(), 0.0), state(quarter, 0.0)
    assert not are_same(one, other, alike=alike, axes=AXES, within_rad=np.deg2rad(5.0))


def test_angles_are_the_same_within_their_standard_deviations():
    at = {"alike": NO_SYMMETRY, "axes": AXES, "within_rad": np.deg2rad(5.0)}
    none = Rotation.identity()
    assert are_same(state(none, 0.0, 20.0), state(none, 30.0, 20.0), **at)
    assert not are_same(state(none, 0.0, 2.0), state(none, 30.0, 2.0), **at)
