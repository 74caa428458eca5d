"""The steps that draw the target onto a scan, and the tracker made of them."""

import numpy as np
import pytest
from lidar_scans import (
    BULKY,
    LIDAR,
    errors,
    load,
    nees,
    off,
    random_pose,
    scan_at,
    scan_of,
    strange_scans,
    tracker,
)
from scipy.spatial.transform import Rotation

from rpod_campaign.engine.trial.poses import nees_of
from rpod_geometry.rays import RayGrid, cast
from rpod_pose.belief import worst_sigma
from rpod_pose.lidar.projective_icp import ProjectiveIcp
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.lidar.scan_registration import refined
from rpod_pose.registration.field_alignment import Points, field_aligned
from rpod_pose.registration.lie_group import PoseArrays, step_between, stepped
from rpod_schemas.config.lidar import LidarConfig, LidarNoiseConfig
from rpod_schemas.config.lidar.search import ProjectiveIcpConfig, ProjectiveIcpTuning
from rpod_schemas.poses import make_pose, pose_error, pose_of
from rpod_schemas.types import BeliefLevel, Source
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_target import load_target

SLIM, MESH = "envisat-slim", "envisat-mesh"
SCENES = [(BULKY, 20.0), (BULKY, 50.0), (SLIM, 20.0), (MESH, 30.0)]
STRANGE = [pytest.param(scan, id=name) for name, scan in strange_scans().items()]
EXACT = LidarConfig(noise=LidarNoiseConfig(sigma_range_m=0.0, sigma_pointing_rad=0.0, outlier_share=0.0))


@pytest.mark.parametrize(("target", "range_m"), SCENES)
def test_a_rough_pose_is_aligned_by_the_distance_field(target, range_m):
    off_deg, off_m = [], []
    for seed in range(12):
        T = random_pose(seed, range_m)
        seen, guess = tracker(target).view.seen(scan_at(T, target, frame=seed)), off(T, 15.0, 1.0, seed)
        R, t = field_aligned(
            Points.equal(seen.downsampled(128)),
            PoseArrays.of(guess),
            tracker(target).surface.coarse_field,
            np.geomspace(1.0, 0.15, 6),
        )
        angle_deg, distance_m = errors(T, pose_of(R, t))
        off_deg.append(angle_deg)
        off_m.append(distance_m)
    assert np.median(off_deg) < 1.0
    assert np.median(off_m) < 0.1
    assert np.mean(np.array(off_deg) < 5.0) > 0.8


@pytest.mark.parametrize(("target", "range_m"), SCENES)
def test_a_nearly_right_pose_is_finished_on_the_faces(target, range_m):
    for seed in range(12):
        T = random_pose(seed, range_m)
        seen, guess = tracker(target).view.seen(scan_at(T, target, frame=seed)), off(T, 2.0, 0.1, seed)
        registration = tracker(target).finish(seen, guess.rotation.as_matrix(), guess.translation)
        angle_deg, distance_m = errors(T, registration.T_sensor_target)
        assert angle_deg < 0.7
        assert distance_m < 0.3
        assert registration.inliers > 0.6 * seen.returns
        assert registration.cost_m2 < 0.05**2


@pytest.mark.parametrize(("target", "range_m", "seed"), [("telecom-satellite", 48.0, 2), (SLIM, 70.0, 3)])
def test_few_returns_give_the_mean_and_the_covariance_of_their_posterior(target, range_m, seed):
    T = random_pose(seed, range_m)
    found = tracker(target).track(scan_at(T, target, frame=seed), off(T, 1.0, 0.1, seed))
    for covariance in (found.covariance, found.parts.white + found.parts.of_model):
        assert nees_of(T, found.T_sensor_target, covariance, load(target)) < 16.8  # one of 100 is larger


def test_without_noise_the_error_is_about_the_sigma_that_is_told_at_most():
    for seed in range(6):
        T = random_pose(seed)
        found = tracker().track(scan_at(T, lidar=EXACT), off(T, 3.0, 0.2, seed))
        assert nees(T, found) < 3.0
        angle_deg, distance_m = errors(T, found.T_sensor_target)
        assert angle_deg < 0.03
        assert distance_m < 2e-3


def test_returns_beside_the_pattern_are_on_no_face():
    beside = scan_of(np.tile((15.0, 0.0, 20.0), (20, 1)))
    registration = tracker().track(beside, random_pose(3))
    assert registration.belief.reason == "0 returns on faces, 6 needed"
    assert registration.T_sensor_target is None


@pytest.mark.parametrize(("target", "range_m"), SCENES)
def test_a_scan_is_tracked_from_five_degrees_and_thirty_centimetres(target, range_m):
    for seed in range(15):
        T = random_pose(seed, range_m)
        scan = scan_at(T, target, frame=seed)
        registration = tracker(target).track(scan, off(T, 5.0, 0.3, seed))
        angle_deg, distance_m = errors(T, registration.T_sensor_target)
        assert angle_deg < 0.7
        assert distance_m < 0.25
        assert registration.belief.reason == ""
        assert registration.source == Source.LIDAR
        assert registration.explained_share > 0.9
        assert registration.inlier_share > 0.8
        assert registration.inliers <= len(scan.returns_m)


@pytest.mark.parametrize(("target", "range_m"), SCENES)
def test_the_errors_are_what_the_covariance_says(target, range_m):
    squares, scaled = [], []
    for seed in range(60):
        T = random_pose(seed, range_m)
        registration = tracker(target).track(scan_at(T, target, frame=seed), off(T, 3.0, 0.2, seed))
        turn = registration.T_sensor_target.rotation * T.rotation.inv()
        error = np.concatenate((registration.T_sensor_target.translation - T.translation, turn.as_rotvec()))
        squares.append(error @ np.linalg.solve(registration.covariance, error))
        scaled.append(error / np.sqrt(np.diag(registration.covariance)))
    assert 2.5 < np.median(squares) < 8.0  # chi-squared with 6 degrees of freedom has 5.35
    assert np.mean(np.array(squares) > 16.8) < 0.06  # its 99 %
    assert np.abs(np.median(scaled, axis=0)).max() < 0.5


def test_the_covariance_is_symmetric_and_positive_definite():
    for target, range_m in SCENES:
        for seed in range(5):
            T = random_pose(seed, range_m)
            covariance = tracker(target).track(scan_at(T, target, frame=seed), T).covariance
            np.testing.assert_allclose(covariance, covariance.T, atol=1e-12 * np.abs(covariance).max())
            assert np.linalg.eigvalsh(covariance)[0] > 0.0


@pytest.mark.parametrize("range_m", [29.0, 40.0])
def test_where_the_faces_leave_a_motion_open_the_outline_determines_it(range_m):
    errors_m, normalised = [], []
    for seed in range(12):
        T = make_pose(
            rotation=Rotation.from_rotvec((0.002 * seed, 0.003, 0.01 * seed)),
            translation_m=(0.07 * seed, -0.04 * seed, range_m),
        )
        found = tracker().track(scan_at(T, frame=seed), off(T, 0.5, 0.1, seed))
        sigma_m = np.sqrt(np.linalg.eigvalsh(found.covariance[:3, :3])[-1])
        assert sigma_m < 0.25 * np.deg2rad(1.0) * range_m  # of the distance of two rays on the target
        errors_m.append(errors(T, found.T_sensor_target)[1])
        normalised.append(nees(T, found))
    assert np.sqrt(np.mean(np.square(errors_m))) < 0.15 * np.deg2rad(1.0) * range_m
    assert np.median(normalised) < 8.0


def test_a_plate_larger_than_the_field_of_view_is_free_to_slide_and_says_so():
    T = make_pose(rotation=Rotation.from_rotvec((np.pi / 2, 0.0, 0.0)), translation_m=(0.0, 0.0, 4.5))
    points_m = scan_at(T).points_m
    seen = tracker().view.seen(scan_of(points_m))
    assert seen.cut_off
    found = tracker().finish(seen, T.rotation.as_matrix(), T.translation)
    assert np.isfinite(found.covariance).all()
    assert np.sqrt(np.linalg.eigvalsh(found.covariance[:3, :3])[-1]) <= 1.01 * load(BULKY).radius_m


def test_a_pose_that_slid_along_faces_until_a_return_met_none_is_found_by_the_outline():
    # the faces end 0.1 m beside the truth, with a sigma of 5 mm and 20 units of 411 less likely
    T = make_pose(
        rotation=Rotation.from_quat([0.754701, 0.072413, -0.018118, -0.651809]),
        translation_m=[0.0, 0.0, 29.0],
    )
    start = make_pose(
        rotation=Rotation.from_rotvec([0.003632, 0.003769, -0.000132]) * T.rotation,
        translation_m=T.translation + np.array([-0.00709, -0.03726, 0.03258]),
    )
    points_m = LidarEmulator(LIDAR, load(BULKY), seed=31).scan([T], frame=77).points_m
    found = tracker().track(scan_of(points_m), start)
    assert errors(T, found.T_sensor_target)[1] < 0.03
    assert nees(T, found) < 16.8


def test_a_target_that_turns_is_followed_from_scan_to_scan():
    T = estimate = random_pose(5)
    for frame in range(10):
        T = off(T, 4.0, 0.1, 7)
        registration = tracker().track(scan_at(T, frame=frame), estimate)
        assert registration.belief.reason == ""
        estimate = registration.T_sensor_target
        assert errors(T, estimate)[0] < 0.5


def test_gross_outliers_do_not_pull():
    T = random_pose(4)
    noisy = LidarConfig(noise=LidarNoiseConfig(gross_outlier_share=0.1))
    registration = tracker().track(scan_at(T, frame=4, lidar=noisy), off(T, 3.0, 0.2, 4))
    assert errors(T, registration.T_sensor_target)[0] < 0.5
    assert registration.inlier_share < 0.95


def test_a_prediction_that_is_quite_wrong_is_told_by_the_tracker_itself():
    for seed in range(20):
        T = random_pose(seed)
        registration = tracker().track(scan_at(T, frame=seed), off(T, 90.0, 1.0, seed))
        reason = registration.belief.reason
        if not reason:  # found in spite of it
            attitude_rad, _ = pose_error(T, registration.T_sensor_target)
            assert np.degrees(np.linalg.norm(attitude_rad)) < 1.0
        else:
            assert "contradict the pose" in reason or "returns on faces" in reason


@pytest.mark.parametrize("seed", range(3))
def test_organised_or_not_a_scan_is_registered_bit_for_bit_the_same(seed):
    T = random_pose(seed)
    scan = scan_at(T, frame=seed)
    one, again, loose = (
        tracker().track(data, off(T, 5.0, 0.3, seed)) for data in (scan, scan, scan_of(scan.returns_m))
    )
    for other in (again, loose):
        np.testing.assert_array_equal(
            one.T_sensor_target.as_matrix(), other.T_sensor_target.as_matrix(), strict=True
        )
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_a_tracker_may_do_without_the_steps_from_afar():
    T, config = random_pose(2), ProjectiveIcpConfig(tuning=ProjectiveIcpTuning(coarse_steps=0))
    near = ProjectiveIcp(config, load(BULKY), ScanPattern.of(LIDAR.info()))
    registration = near.track(scan_at(T), off(T, 1.0, 0.05, 2))
    assert errors(T, registration.T_sensor_target)[0] < 0.3
    assert registration.iterations == config.tuning.fine_steps


@pytest.mark.parametrize("scan", STRANGE)
@pytest.mark.parametrize("z_m", [20.0, 0.0, -20.0, 1e5])
def test_no_scan_raises_and_none_that_is_strange_is_believed(scan, z_m):
    registration = tracker().track(scan, make_pose(translation_m=(0.0, 0.0, z_m)))
    assert registration.belief.reason
    assert registration.source == Source.LIDAR


def test_a_return_at_zero_is_none():
    T = random_pose(3)
    points_m = scan_at(T, frame=3).points_m
    zeros = scan_of(np.where(np.isnan(points_m), 0.0, points_m))
    one, other = (tracker().track(scan, off(T, 3.0, 0.2, 3)) for scan in (scan_of(points_m), zeros))
    np.testing.assert_array_equal(one.T_sensor_target.as_matrix(), other.T_sensor_target.as_matrix())


def test_too_few_returns_are_told():
    few = scan_of(scan_at(random_pose(0)).returns_m[:5])
    assert tracker().track(few, random_pose(0)).belief.reason == "5 returns, 6 needed"


def test_turns_of_a_nearly_round_body_are_found_or_called_undetermined():
    beliefs = []
    for seed in range(24):
        T = random_pose(seed, 50.0 + 20.0 * (seed % 2))
        found = tracker("upper-stage").track(scan_at(T, "upper-stage", frame=seed), off(T, 5.0, 0.3, seed))
        if found.T_sensor_target is None:
            continue
        angle_deg, _ = errors(T, found.T_sensor_target)
        sigma_deg = np.degrees(worst_sigma(found.covariance[3:, 3:]))
        assert angle_deg < 5.0 * max(sigma_deg, 0.5), seed
        if found.belief.level is BeliefLevel.ACCEPTED:
            assert angle_deg < 5.0, seed
        beliefs.append(found.belief)
    doubtful = [belief.reason for belief in beliefs if belief.level is BeliefLevel.DOUBTFUL]
    assert 0 < len(doubtful) < len(beliefs) / 3
    assert all("turn about the axis is undetermined" in reason for reason in doubtful)


DRUM = """
name: drum
mass_kg: 100.0
materials: {paint: {reflectivity: 0.5, diffuse: 0.4, f0: 0.02, roughness: 0.3}}
parts:
  - {name: drum, shape: prism, sides: 64, circumradius_m: 1.0, length_m: 1.0, material: paint}
  - name: box
    shape: box
    size_m: [0.2, 0.4, 0.3]
    material: paint
    T_target_part: {translation_m: [1.1, 0.4, 0.0]}
distance_field: {spacing_m: 0.05, margin_m: 0.5}
symmetries: [{axis: [1.0, 0.0, 0.0], order: 12, continuous: true}]
"""


def test_facets_in_many_returns_do_not_tell_the_turn_of_a_round_body(tmp_path):
    """The box that tells the turn is hidden, so that only the 64 facets are left."""
    (tmp_path / "drum.yaml").write_text(DRUM)
    target = load_target(tmp_path / "drum.yaml", cache=tmp_path)
    T = make_pose(rotation=Rotation.from_euler("y", -50.0, degrees=True), translation_m=(0.0, 0.0, 5.0))
    scan = scan_of(LidarEmulator(LIDAR, target, seed=5).scan([T], frame=1).points_m)
    icp = ProjectiveIcp(ProjectiveIcpConfig(), target, ScanPattern.of(LIDAR.info()))
    turned = T * make_pose(rotation=Rotation.from_euler("x", 6.0, degrees=True))
    found = icp.track(scan, turned)
    assert len(scan.returns_m) > 300
    assert errors(T, found.T_sensor_target)[0] > 5.0  # one facet
    assert np.degrees(worst_sigma(found.covariance[3:, 3:])) > 5.0
    assert found.belief.level is BeliefLevel.DOUBTFUL


def test_returns_from_the_edge_of_a_beam_do_not_pull_the_pose():
    """Beams of 3 mrad, 40 x 40 rays, mock-up at 5 m: three scans: with thin rays the mean NEES was 28."""
    assert np.mean([nees_of_wide_beams(seed) for seed in range(3)]) < 10.0


def nees_of_wide_beams(seed):
    """Return the NEES of a tracked pose."""
    target, rng, half_rad = load_target("mockup"), np.random.default_rng(seed), 1.5e-3
    truth = make_pose(rotation=Rotation.random(rng=rng), translation_m=(0.1, -0.1, 5.0))
    lines = np.linspace(-0.3, 0.3, 40)
    grid = RayGrid.azimuth_elevation(lines, lines)
    ranges_m = [cast(grid, target.triangles_m, truth).range_m]
    for angle in np.arange(6) * np.pi / 3.0:
        x, y = half_rad * np.cos(angle), half_rad * np.sin(angle)
        turned = RayGrid.azimuth_elevation(lines + x, lines + y)
        ranges_m.append(cast(turned, target.triangles_m, truth).range_m)
    met = np.isfinite(ranges_m).sum(axis=0) >= 2
    middle_m = np.where(np.isfinite(ranges_m[0]), ranges_m[0], np.sort(ranges_m, axis=0)[1])
    range_m = np.where(met, middle_m + rng.normal(0.0, 0.01, met.shape), np.nan)
    pattern = ScanPattern(lines, lines, sigma_range_m=0.01)
    scan = scan_of(range_m[..., None] * grid.directions)
    found = ProjectiveIcp(ProjectiveIcpConfig(), target, pattern).track(scan, truth)
    assert found.begins_track
    assert np.isfinite(ranges_m[0]).sum() < met.sum()
    return nees(truth, found)


@pytest.mark.parametrize("target", [BULKY, MESH])
def test_a_registration_beside_its_optimum_starts_anew_from_a_likelier_pose(target):
    """Where no alignment reaches the likelier pose, the registration is not sure, and samples follow."""
    method, settled = tracker(target), []
    for seed in range(4):
        T = random_pose(seed, 20.0)
        seen = method.view.seen(scan_at(T, target, frame=seed))
        problem = method._problem(seen)
        right = refined(problem, PoseArrays.of(T), seen.range_m, method.model.assumed, method._reach)
        sigma = np.sqrt(np.diag(np.linalg.inv(right.information)))
        pose = stepped(right.pose, 6.0 * sigma * np.random.default_rng(seed).choice((-1.0, 1.0), 6))
        beside = right._replace(pose=pose, statistics=method.model._statistics(seen, pose))
        found, sure = method._settled(seen, problem, beside)
        settled.append(sure)
        step = step_between(pose_of(*right.pose), pose_of(*found.pose))
        assert step @ right.information @ step < 0.5 * 36.0
        assert found.statistics.agreement.log_likelihood > beside.statistics.agreement.log_likelihood + 3.0
    assert sum(settled) >= 3
