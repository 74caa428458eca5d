"""The acquisition in scans: what is found, what is ambiguous, and what is never taken for the target."""

from functools import cache

import numpy as np
import pytest
from lidar_scans import (
    BULKY,
    DENSE,
    LIDAR,
    emulator,
    errors,
    load,
    off,
    random_pose,
    scan_at,
    scan_of,
    search,
    strange_scans,
    tracker,
)
from scipy.spatial.transform import RigidTransform, Rotation

from rpod_pose.lidar import acquire
from rpod_pose.lidar.scan_search import Pose
from rpod_pose.ports import Outcome
from rpod_pose.search.turns import Turns
from rpod_schemas.config.lidar import LidarConfig, LidarNoiseConfig
from rpod_schemas.poses import make_pose
from rpod_sim_sensor.lidar import LidarEmulator

SLIM, MESH = "envisat-slim", "envisat-mesh"
STRANGE = [pytest.param(scan, id=name) for name, scan in strange_scans().items()]
SYMMETRIC = {"rocket-stage": (10.0, 8), "hexagonal-body": (5.0, 12)}
"""Ranges, and how many poses look alike."""


@cache
def found(seed, range_m=20.0, target=BULKY):
    return search(target).acquire(scan_at(random_pose(seed, range_m), target, frame=seed))


def assert_accepted(acquisition, T, *, angle_deg=1.0, distance_m=0.15):
    assert acquisition.outcome is Outcome.ACCEPTED, acquisition.belief.reason
    off_deg, off_m = errors(T, acquisition.pose)
    assert off_deg < angle_deg
    assert off_m < distance_m


@pytest.mark.parametrize(
    ("target", "range_m"), [(BULKY, 20.0), (BULKY, 50.0), (SLIM, 20.0), (SLIM, 50.0), (MESH, 30.0)]
)
def test_any_attitude_is_found_in_a_single_scan(target, range_m):
    for seed in range(20):
        acquisition = found(seed, range_m, target)
        assert_accepted(acquisition, random_pose(seed, range_m))
        assert acquisition.begins_track
        assert acquisition.belief.reason == ""
        assert not any(rival.exact for rival in acquisition.belief.rivals)
        assert acquisition.templates >= 900


HARD = [
    (BULKY, 30.0, 11, 1633, (0.6151030, 0.3539230, 0.6110514, -0.3507177)),
    (SLIM, 30.0, 11, 152, (0.6088292, 0.4069013, 0.5579402, -0.3904625)),
    (BULKY, 50.0, 12, 337, (0.7137261, -0.6990946, -0.0074552, -0.0424985)),
    (SLIM, 30.0, 12, 9, (-0.0666932, 0.0848480, 0.7681588, 0.6310982)),
]
"""Scans whose faces lead astray what their outline tells: target, range, noise's seed and frame, attitude."""


@pytest.mark.parametrize(("target", "range_m", "seed", "frame", "quaternion"), HARD)
def test_what_only_the_outline_tells_decides_between_rivals(target, range_m, seed, frame, quaternion):
    T = make_pose(rotation=Rotation.from_quat(quaternion), translation_m=(0.0, 0.0, range_m))
    emulator = LidarEmulator(LIDAR, load(target), seed=seed)
    acquisition = search(target).acquire(scan_of(emulator.scan([T], frame=frame).points_m))
    assert_accepted(acquisition, T, angle_deg=3.0, distance_m=0.3)


def test_what_is_found_is_described_in_full():
    for seed in range(5):
        acquisition = found(seed)
        assert acquisition.registration.explained_share > 0.9
        assert sum(hypothesis.weight for hypothesis in acquisition.hypotheses) == pytest.approx(1.0)
        assert errors(acquisition.pose, acquisition.hypotheses[0].pose)[0] < 1.0
        np.testing.assert_allclose(
            acquisition.covariance, acquisition.covariance.T, atol=1e-12 * acquisition.covariance.max()
        )
        assert np.linalg.eigvalsh(acquisition.covariance)[0] > 0.0


@pytest.mark.parametrize("target", SYMMETRIC)
def test_a_symmetric_target_is_ambiguous_and_one_of_its_hypotheses_is_right(target):
    range_m, alike = SYMMETRIC[target]
    for seed in range(8):
        acquisition, T = found(seed, range_m, target), random_pose(seed, range_m)
        assert acquisition.outcome is Outcome.AMBIGUOUS
        assert all(rival.exact for rival in acquisition.belief.rivals)
        assert acquisition.begins_track
        reason = f"{alike} poses cannot be distinguished because of the target's symmetry"
        assert acquisition.belief.reason == reason
        hypotheses = acquisition.hypotheses
        assert len(hypotheses) == alike
        assert sum(hypothesis.weight for hypothesis in hypotheses) == pytest.approx(1.0)
        off_deg = [errors(T, hypothesis.pose)[0] for hypothesis in hypotheses]
        assert sum(np.array(off_deg) < 3.0) == 1
        assert errors(T, hypotheses[int(np.argmin(off_deg))].pose)[1] < 0.1


@pytest.mark.parametrize("scan", STRANGE)
def test_no_scan_raises_and_none_that_is_strange_is_believed(scan):
    acquisition = search().acquire(scan)
    assert acquisition.outcome is Outcome.FAILED
    assert acquisition.belief.reason
    assert acquisition.hypotheses == ()
    assert not acquisition.begins_track


@pytest.mark.parametrize(
    ("shown", "expected", "range_m"),
    [
        ("mockup", BULKY, 8.0),
        ("rocket-stage", BULKY, 20.0),
        (SLIM, BULKY, 20.0),
        (BULKY, SLIM, 20.0),
        (BULKY, MESH, 20.0),
    ],
)
def test_another_object_is_not_taken_for_the_target(shown, expected, range_m):
    for seed in range(2):
        scan = scan_at(random_pose(seed, range_m), shown, frame=seed)
        acquisition = search(expected).acquire(scan)
        assert acquisition.outcome is Outcome.FAILED
        assert f"of {len(scan.returns_m)} returns" in acquisition.belief.reason
        assert not acquisition.begins_track


@pytest.mark.parametrize(("seed", "range_m"), [(0, 20.0), (3, 20.0), (2, 50.0), (4, 50.0)])
def test_an_unorganised_scan_gives_what_the_organised_one_does(seed, range_m):
    T, organised = random_pose(seed, range_m), found(seed, range_m)
    points_m = scan_at(T, frame=seed).returns_m
    loose = search().acquire(scan_of(points_m))
    np.testing.assert_array_equal(loose.pose.as_matrix(), organised.pose.as_matrix())
    np.testing.assert_array_equal(loose.covariance, organised.covariance)
    assert_accepted(search().acquire(scan_of(np.random.default_rng(seed).permutation(points_m))), T)


def test_the_same_scan_gives_the_same_result_bit_for_bit():
    for seed, range_m, target in [(1, 20.0, BULKY), (6, 50.0, SLIM), (2, 10.0, "rocket-stage")]:
        scan = scan_at(random_pose(seed, range_m), target, frame=seed)
        one, other = found(seed, range_m, target), search(target).acquire(scan)
        np.testing.assert_array_equal(one.pose.as_matrix(), other.pose.as_matrix())
        np.testing.assert_array_equal(one.covariance, other.covariance)
        assert [h.weight for h in one.hypotheses] == [h.weight for h in other.hypotheses]
        assert (one.outcome, one.belief.reason, one.templates) == (
            other.outcome,
            other.belief.reason,
            other.templates,
        )


@pytest.mark.parametrize(("target", "range_m"), [(BULKY, 20.0), (SLIM, 50.0), (MESH, 30.0)])
def test_a_right_pose_is_judged_right_and_refined(target, range_m):
    for seed in range(5):
        T = random_pose(seed, range_m)
        verified = search(target).verify(scan_at(T, target, frame=seed), off(T, 2.0, 0.1, seed))
        assert_accepted(verified, T)


@pytest.mark.parametrize(("target", "range_m"), [(BULKY, 20.0), (SLIM, 50.0), (MESH, 30.0)])
def test_a_pose_turned_by_half_a_turn_is_judged_wrong_and_told_by_how_much(target, range_m):
    for seed in range(5):
        T = random_pose(seed, range_m)
        scan = scan_at(T, target, frame=seed)
        for turn in load(target).turns():
            verified = search(target).verify(scan, T * turn)
            assert verified.outcome is Outcome.FAILED
            assert verified.belief.reason in {
                f"the pose turned by {deg} deg explains the scan better" for deg in (179, 180)
            }
            assert errors(T, verified.pose)[0] > 170.0


def test_a_pose_beside_the_target_or_a_scan_of_nothing_is_judged_wrong():
    T = random_pose(2)
    for z_m in (-20.0, 500.0):
        verified = search().verify(scan_at(T), make_pose(translation_m=(0.0, 0.0, z_m)))
        assert verified.outcome is Outcome.FAILED
        assert verified.belief.reason
    nothing = search().verify(scan_of(np.full((41, 41, 3), np.nan)), T)
    assert (nothing.outcome, nothing.belief.reason) == (Outcome.FAILED, "0 returns, 6 needed")


def test_a_pose_in_the_sensor_itself_is_judged_wrong():
    assert search().verify(scan_at(random_pose(2)), make_pose()).outcome is Outcome.FAILED


@pytest.mark.parametrize(("target", "range_m"), [(BULKY, 20.0), (SLIM, 50.0), (MESH, 30.0)])
def test_around_a_rough_pose_fewer_attitudes_are_enough(target, range_m):
    for seed in range(5):
        T = random_pose(seed, range_m)
        near = search(target).near(scan_at(T, target, frame=seed), off(T, 25.0, 1.0, seed))
        assert_accepted(near, T)
        assert 0 < near.templates < 100


def test_a_dense_pattern_is_thinned_to_search_and_refined_in_full():
    for seed in range(4):
        T = random_pose(seed, 40.0)
        acquisition = search(lidar=DENSE).acquire(scan_at(T, frame=seed, lidar=DENSE))
        assert_accepted(acquisition, T, angle_deg=0.1, distance_m=0.01)


def test_a_scan_that_took_its_time_is_found_with_the_bend_that_a_tumbling_target_gives_it():
    skewed = LidarConfig(motion="skewed")
    for seed in range(6):
        T, rate_rad_s = random_pose(seed), np.deg2rad(4.0) * np.random.default_rng(seed).normal(size=3)
        poses = [
            RigidTransform.from_components(
                T.translation, Rotation.from_rotvec(rate_rad_s * time_s) * T.rotation
            )
            for time_s in skewed.pose_times_s()
        ]
        scan = scan_of(LidarEmulator(skewed, load(BULKY), seed=1).scan(poses, frame=seed).points_m)
        assert_accepted(search().acquire(scan), T)


def test_gross_outliers_do_not_hide_the_target():
    noisy = LidarConfig(noise=LidarNoiseConfig(gross_outlier_share=0.04))
    for seed in range(6):
        T = random_pose(seed)
        assert_accepted(search().acquire(scan_at(T, frame=seed, lidar=noisy)), T)


def test_a_return_at_zero_is_none():
    points_m = scan_at(random_pose(3), frame=3).points_m
    zeros = scan_of(np.where(np.isnan(points_m), 0.0, points_m))
    assert_accepted(search().acquire(zeros), random_pose(3))


@pytest.mark.parametrize(
    "place_m",
    [
        (2.0, -1.0, 80.0),
        (-3.0, -3.0, 8.0),
        (1.0, 2.0, 2000.0),
        (1e9, 1e9, 1e9),
    ],
)
def test_a_single_return_from_elsewhere_does_not_hide_the_target(place_m):
    for seed in range(4):
        T = random_pose(seed)
        points_m = scan_at(T, frame=seed).points_m.copy()
        points_m[np.unravel_index(np.flatnonzero(np.isnan(points_m[..., 0]))[0], (41, 41))] = place_m
        assert_accepted(search().acquire(scan_of(points_m)), T)


def test_a_target_that_the_field_of_view_cuts_off_is_found():
    for seed in range(6):
        attitude = random_pose(seed).rotation
        T = make_pose(rotation=attitude, translation_m=(3.0, -2.0, 18.0))
        scan = scan_at(T, frame=seed)
        returned = np.isfinite(scan.points_m[..., 0])
        assert returned[[0, -1]].any() or returned[:, [0, -1]].any()
        assert_accepted(search().acquire(scan), T)


def test_the_turns_that_a_target_may_be_mistaken_by_are_distinct():
    # of the stage, half turns across its axis are all one by its exact symmetry
    for target, exact, declared in [(BULKY, 1, 3), ("mockup", 1, 5), ("rocket-stage", 8, 1)]:
        turns = Turns.of(load(target))
        assert len(turns.exact.turns) == exact
        assert turns.declared == declared
        every = Rotation.from_matrix(turns.all)
        known = Rotation.concatenate([Rotation.from_matrix(turns.exact.turns), every])
        for k, turn in enumerate(every):
            apart = (known.inv() * turn).magnitude()
            assert np.delete(apart, len(turns.exact.turns) + k).min() > 1e-3


def test_one_call_acquires_what_a_configured_search_does():
    for seed in (0, 3):
        T = random_pose(seed, 30.0)
        scan = scan_at(T, frame=seed)
        one, other = acquire(scan, load(BULKY), LIDAR.info()), search().acquire(scan)
        assert_accepted(one, T)
        np.testing.assert_array_equal(one.pose.as_matrix(), other.pose.as_matrix())


@pytest.mark.parametrize("seed", range(4))
def test_what_a_few_returns_leave_undetermined_is_not_believed(seed):
    acquisition = search().acquire(scan_at(random_pose(seed, 150.0), frame=seed))
    assert not acquisition.begins_track
    assert acquisition.belief.insufficient or acquisition.belief.reason


@pytest.mark.parametrize("target", ["mockup", "hexagonal-body"])
def test_from_a_few_returns_a_pose_is_believed_only_if_it_is_right_and_else_it_is_among_the_hypotheses(
    target,
):
    listed = 0
    for seed in range(10):
        T = random_pose(seed, 12.0)
        acquisition = search(target).acquire(scan_at(T, target, frame=seed))
        off_deg = [errors(T, hypothesis.pose)[0] for hypothesis in acquisition.hypotheses]
        if acquisition.begins_track:
            assert min(off_deg) < 10.0
        listed += min(off_deg) < 10.0
    assert listed >= 9


def test_of_two_poses_that_explain_a_scan_alike_the_less_exact_one_is_more_probable():
    fit = tracker().model.fit(
        tracker().view.seen(scan_at(random_pose(0))), np.eye(3), np.array((0.0, 0.0, 20.0))
    )
    exact, vague = (Pose(np.eye(3), np.zeros(3), fit, scale * np.eye(6)) for scale in (1e6, 1e4))
    assert vague.log_mass(10.0) - exact.log_mass(10.0) == pytest.approx(3.0 * np.log(100.0), abs=0.01)
    nothing = Pose(np.eye(3), np.zeros(3), fit, np.zeros((6, 6)))
    assert np.isfinite(nothing.log_mass(10.0))


@pytest.mark.parametrize("seed", [0, 5])
def test_a_pose_begins_no_track_where_the_target_fills_the_view_and_the_scan_is_unlikely(seed):
    name = "random-derive-65-4"
    turn = Rotation.random(rng=np.random.default_rng(seed))
    T = make_pose(rotation=turn, translation_m=(0.0, 0.0, 0.75 * load(name).radius_m))
    found = search(name).acquire(scan_of(emulator(name).scan([T], frame=1).points_m))
    assert np.linalg.norm(found.pose.translation - T.translation) > 1.0
    assert not found.begins_track
    assert "the target extends beyond the field of view" in found.belief.refusal
