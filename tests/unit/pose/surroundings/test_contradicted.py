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
from rpod_pose.search.turns import Turns
from rpod_pose.surroundings.contradicted import ROUNDS, supported, with_likely
from rpod_schemas.poses import make_pose
from rpod_schemas.types import BeliefLevel, Source

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


def turned(log, level=BeliefLevel.ACCEPTED):
    """Return an accepted pose after the comparison with its half turn, of a log likelihood relative to it."""
    accepted = found(Belief(level=level, needed_weight=0.99))
    pose = make_pose(rotation=TURN, translation_m=POSE.translation)
    other = replace(accepted.registration, T_sensor_target=pose)
    exact = cached_target("mockup").equivalence
    return accepted, with_likely(accepted, [accepted.registration, other], np.array([0.0, log]), exact)


def test_an_accepted_pose_without_a_likely_near_symmetry_is_passed_on():
    accepted, result = turned(-20.0)
    assert result is accepted


def test_a_near_symmetry_that_the_whole_frame_shows_takes_the_place_of_an_accepted_pose():
    _, result = turned(20.0)
    assert result.begins_track
    assert close(result.pose, make_pose(rotation=TURN, translation_m=POSE.translation))


def test_a_near_symmetry_that_is_about_as_likely_leaves_the_pose_ambiguous():
    _, result = turned(-1.0)
    assert result.outcome is Outcome.AMBIGUOUS
    assert close(result.pose, POSE)
    assert "turned by 180 deg" in result.belief.refusal


def test_a_near_symmetry_of_the_right_pose_gives_way_to_it_among_other_things():
    cell = PopulationCell("mockup", "lidar", "acquisition", (200.0, 300.0), surroundings="laboratory")
    methods, taken = population.measured(cell, 3, 0)
    scan, target, tracker = taken.measurement, cached_target("mockup"), methods.tracker
    turn = Turns.of(target).all[0]
    wrong = tracker.track_among(
        scan,
        make_pose(
            rotation=taken.truth.rotation * Rotation.from_matrix(turn), translation_m=taken.truth.translation
        ),
    )
    assert wrong.begins_track
    assert errors(taken.truth, wrong.T_sensor_target, target)[0] > 30.0
    accepted = Acquisition(replace(wrong, belief=replace(wrong.belief, needed_weight=0.99)))
    result = methods.acquirer._compared(scan, tracker.frames.image(scan, fine=True), accepted)
    assert result.begins_track
    assert errors(taken.truth, result.pose, target)[0] < 3.0
