"""Tests of poses that other things in a part of a frame contradict."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod_campaign.engine.trial.poses import errors
from rpod_campaign.engine.trial.targets import cached_target
from rpod_campaign.population import trial as population
from rpod_campaign.population.trial import PopulationCell
from rpod_pose.belief import Belief, Rival, contradicted
from rpod_pose.ports import Acquisition, Outcome, Registration
from rpod_pose.surroundings.contradicted import ROUNDS, supported
from rpod_schemas.poses import make_pose
from rpod_schemas.types import Source

TURN = Rotation.from_rotvec((0.0, 0.0, np.pi))
POSE = make_pose(translation_m=(0.0, 0.0, 5.0))
WRONG = replace(contradicted("returns of an arm"), needed_weight=0.99)


def found(belief):
    return Acquisition(Registration(Source.LIDAR, T_sensor_target=POSE, belief=belief, covariance=np.eye(6)))


def close(pose, other):
    return np.allclose(pose.as_matrix(), other.as_matrix())


def judged(first, whole, *, after=None, likely=True):
    """Return what ``supported`` makes of an acquisition, and the number of searches."""
    searches = []

    def search(registration):
        searches.append(registration)
        return after or first

    registration = replace(first.registration, belief=whole)
    return supported(first, lambda _pose: registration, search, close, likely=likely), len(searches)


def test_a_pose_that_only_a_part_contradicts_is_accepted_after_a_search_in_what_it_leaves():
    result, searches = judged(found(WRONG), Belief())
    assert result.begins_track
    assert searches == 1


def test_a_rival_from_that_search_leaves_the_pose_ambiguous():
    rival = Rival("turned by 180 deg", make_pose(rotation=TURN, translation_m=(0.0, 0.0, 5.0)), -1.0)
    result, _ = judged(found(replace(WRONG, rivals=(rival,))), Belief())
    assert result.outcome is Outcome.AMBIGUOUS
    assert not result.begins_track


def test_a_pose_that_the_whole_frame_contradicts_too_stays_refused():
    first = found(WRONG)
    result, searches = judged(first, contradicted("a detail is not explained"))
    assert result is first
    assert searches == ROUNDS


def test_a_pose_is_judged_in_what_it_leaves_itself():
    first, other = found(WRONG), make_pose(rotation=TURN, translation_m=(0.0, 0.0, 5.0))
    better = replace(first, registration=replace(first.registration, T_sensor_target=other))
    track = lambda pose: Registration(Source.LIDAR, T_sensor_target=pose, covariance=np.eye(6))  # noqa: E731
    result = supported(first, track, lambda _left: better, close, likely=True)
    assert result.begins_track
    assert result.pose is other


def test_a_pose_that_explains_less_than_the_first_one_stays_refused():
    first = found(WRONG)
    first = replace(first, registration=replace(first.registration, inliers=159))
    fewer = replace(first.registration, belief=Belief(), inliers=90)
    assert supported(first, lambda _pose: fewer, lambda _left: first, close, likely=True) is first


def test_in_an_unlikely_part_such_a_pose_is_not_searched_for_again():
    _, searches = judged(found(WRONG), contradicted("a detail is not explained"), likely=False)
    assert searches == 0


def test_a_contradicted_pose_without_known_rivals_is_not_judged():
    first = found(replace(WRONG, needed_weight=1.0))
    result, searches = judged(first, Belief())
    assert result is first
    assert searches == 0


def test_an_accepted_pose_is_passed_on():
    first = found(Belief())
    assert judged(first, contradicted("no"))[0] is first


@pytest.mark.parametrize(("name", "trial"), [("random-derive-62-5", 2)])
def test_a_body_beside_a_stand_and_on_an_arm_is_found(name, trial):
    cell = PopulationCell(name, "lidar", "acquisition", (30.0, 500.0), surroundings="laboratory")
    methods, taken = population.measured(cell, 62, trial)
    result = methods.acquirer.acquire(taken.measurement)
    assert result.begins_track
    attitude_deg, position_m = errors(taken.truth, result.pose, cached_target(name))
    assert attitude_deg is not None
    assert position_m is not None
    assert attitude_deg < 0.1
    assert position_m < 0.01
