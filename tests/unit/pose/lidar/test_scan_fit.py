"""The likelihood of a scan: its statistics at the truth, and what it says of other poses."""

from dataclasses import replace

import numpy as np
import pytest
from lidar_scans import LIDAR, load, off, random_pose, scan_at, scan_of, tracker
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from rpod_geometry.rays import cast
from rpod_pose.lidar.returns.detection import HALVES, RUNGS, STEEPNESS, detection, expected_shares
from rpod_pose.lidar.scan_fit import DRAWN_POWER, UPHILL_SIGMAS, ScanModel, uphill
from rpod_pose.lidar.scan_likelihood import HIT_MEAN, HIT_VARIANCE, PEAK, STEEPEST
from rpod_pose.lidar.scan_pattern import UNKNOWN_SIGMA_M
from rpod_pose.lidar.scan_registration import CHANCE
from rpod_pose.lidar.scan_view import ScanView, SeenScan
from rpod_pose.registration.brightness import albedos
from rpod_pose.registration.lie_group import PoseArrays, step_between, stepped
from rpod_pose.registration.surface_model import SurfaceModel
from rpod_pose.search.even_samples import steps_of
from rpod_schemas.config.lidar.search import ScanAcceptanceConfig, ScanModelConfig
from rpod_schemas.poses import make_pose, pose_of
from rpod_sim_sensor.lidar import LidarEmulator
from rpod_sim_sensor.worlds import world_of

BULKY, SLIM, MESH = "envisat-bulky", "envisat-slim", "envisat-mesh"
SCENES = [(BULKY, 20.0), (BULKY, 50.0), (SLIM, 20.0), (SLIM, 50.0), (MESH, 30.0)]


def parts(T):
    return T.rotation.as_matrix(), T.translation


def fitted(T, scan, target=BULKY):
    model, seen = tracker(target).model, tracker(target).view.seen(scan)
    return model.fit(seen, *parts(T)), seen


def reason_against(T, scan, target=BULKY):
    fit, seen = fitted(T, scan, target)
    return tracker(target).model.belief(seen, *parts(T), fit).reason


def drawn(T, *, half, target, view, generator):
    """Return a scan that a model expects: which rays return, by which sensor, and with what errors."""
    config, sigma_m = ScanModelConfig(), 0.025
    hits = cast(view.grid, target.triangles_m, T, cull_back_faces=True)
    met, face = hits.triangle >= 0, np.maximum(hits.triangle, 0)
    cosine = -(T.rotation.apply(target.normals)[face] * view.grid.directions).sum(axis=-1)
    ranges_m = np.where(met, hits.range_m, np.inf)
    echo = np.maximum(cosine * albedos(target)[face] * (config.least_range_m / ranges_m) ** 2, 1e-9)
    probability = config.surest_detection / (1.0 + (half / echo) ** STEEPNESS)
    returned = met & (generator.random(met.shape) < probability)
    scale_m = np.hypot(sigma_m, config.slack_sigmas * sigma_m / np.maximum(cosine, STEEPEST))
    range_m = np.where(returned, hits.range_m + scale_m * generator.standard_t(4, met.shape), 0.0)
    rays = np.flatnonzero(returned)
    points_m = (view.grid.directions * range_m[..., None]).reshape(-1, 3)[rays]
    return SeenScan(points_m, rays, range_m, view.grid)


def test_a_brighter_echo_is_detected_rather_than_a_dimmer_one_by_every_sensor():
    tables = detection(0.95, 0.02)
    assert tables.share.shape == (len(HALVES), RUNGS)
    assert (np.diff(tables.share, axis=1) >= 0.0).all()
    assert (np.diff(tables.share, axis=0) <= 0.0).all()
    np.testing.assert_allclose(tables.share[0], 0.95 * 0.98)
    shares = expected_shares(0.95)
    assert (np.diff(shares) >= 0.0).all()
    assert shares[-1] < 0.95


def test_the_moments_of_a_range_error_are_those_of_students_distribution():
    log_density = student.logpdf(student.rvs(4, size=400_000, random_state=1), 4)
    assert student.pdf(0.0, 4) == pytest.approx(PEAK)
    assert -log_density.mean() == pytest.approx(HIT_MEAN, abs=0.01)
    assert log_density.var() == pytest.approx(HIT_VARIANCE, abs=0.02)


def test_the_sigma_of_a_range_is_what_the_sensor_says_and_a_guess_where_it_says_nothing():
    view, surface = ScanView.of(LIDAR.azimuth_rad, LIDAR.elevation_rad), SurfaceModel.of(load(BULKY))

    def sigma_m(told_m, **config):
        parts = ScanModelConfig(**config), ScanAcceptanceConfig(), view, surface
        return ScanModel(*parts, sigma_range_m=told_m).sigma_range_m

    assert sigma_m(0.01) == 0.01
    assert sigma_m(0.0) == UNKNOWN_SIGMA_M
    assert sigma_m(0.01, sigma_range_m=0.03) == 0.03


@pytest.mark.parametrize("world", ["faint", "keen", "outliers", "exchanged", "specular", "noisy"])
@pytest.mark.parametrize("range_m", [20.0, 50.0])
def test_the_truth_is_never_contradicted_by_sensors_that_nobody_described(world, range_m):
    emulator = LidarEmulator(LIDAR, load(BULKY), seed=5, world=world_of(world))
    refused = 0
    for seed in range(20):
        T = random_pose(seed, range_m)
        refused += reason_against(T, scan_of(emulator.scan([T], frame=seed).points_m)) != ""
    assert refused <= 1


@pytest.mark.parametrize("half", [0.0, 0.3])
@pytest.mark.parametrize(("target", "range_m"), SCENES)
def test_scans_drawn_from_the_model_lack_nothing_but_chance(target, range_m, half):
    config = ScanModelConfig(clutter_share=1e-6)
    view = ScanView.of(LIDAR.azimuth_rad, LIDAR.elevation_rad)
    surface = SurfaceModel.of(load(target))
    model = ScanModel(config, ScanAcceptanceConfig(), view, surface, sigma_range_m=0.025)
    scores = []
    for seed in range(40):
        T, generator = random_pose(seed, range_m), np.random.default_rng((1, seed))
        seen = drawn(T, half=half, target=load(target), view=view, generator=generator)
        fit = model.fit(seen, *parts(T))
        scores.append(fit.deficit / fit.deviation)
    assert abs(np.mean(scores)) < 1.2
    assert 0.7 < np.std(scores) < 1.5


@pytest.mark.parametrize(("target", "range_m"), SCENES)
def test_the_truth_is_never_in_deficit_and_never_refused_on_the_sensors_scans(target, range_m):
    for seed in range(20):
        T = random_pose(seed, range_m)
        scan = scan_at(T, target, frame=seed)
        fit, seen = fitted(T, scan, target)
        assert fit.deficit <= 0.0
        assert fit.agreement.share > 0.9
        assert fit.agreement.agreeing >= 0.95 * seen.returns
        assert reason_against(T, scan, target) == ""


@pytest.mark.parametrize(("target", "range_m"), SCENES)
def test_a_wrong_attitude_lacks_several_units_a_return(target, range_m):
    for seed in range(20):
        T = random_pose(seed, range_m)
        scan = scan_at(T, target, frame=seed)
        wrong = make_pose(rotation=random_pose(1000 + seed).rotation, translation_m=T.translation)
        fit, seen = fitted(wrong, scan, target)
        assert fit.deficit > 3.0 * seen.returns
        assert "contradict the pose" in reason_against(wrong, scan, target)


@pytest.mark.parametrize(("target", "range_m"), [(BULKY, 20.0), (SLIM, 20.0), (MESH, 30.0)])
def test_the_truth_is_far_likelier_than_what_it_is_most_easily_mistaken_by(target, range_m):
    for seed in range(10):
        T = random_pose(seed, range_m)
        scan = scan_at(T, target, frame=seed)
        best = fitted(T, scan, target)[0].log_likelihood
        turned = [fitted(T * turn, scan, target)[0].log_likelihood for turn in load(target).turns()]
        assert max(turned) < best - 50.0


def test_every_way_off_the_truth_is_less_likely():
    T = random_pose(3)
    scan = scan_at(T, frame=3)
    best = fitted(T, scan)[0].log_likelihood
    for way in np.vstack((np.eye(3), -np.eye(3))):
        for step in (
            make_pose(translation_m=0.2 * way),
            make_pose(rotation=Rotation.from_rotvec(np.deg2rad(3.0) * way)),
        ):
            assert fitted(T * step, scan)[0].log_likelihood < best - 20.0


@pytest.mark.parametrize("shift_m", [1.5, 4.0])
def test_the_rays_that_contradict_a_pose_are_marked(shift_m):
    T = random_pose(3)
    scan, wrong = scan_at(T, frame=3), T * make_pose(translation_m=(0.0, shift_m, 0.0))
    fit, seen = fitted(wrong, scan)
    belief = tracker().model.belief(seen, *parts(wrong), fit)
    hits = cast(tracker().view.grid, load(BULKY).triangles_m, wrong, cull_back_faces=True)
    met, measured = hits.triangle >= 0, seen.range_m > 0.0
    marked = belief.marks.marked
    assert (marked & measured).sum() == fit.agreement.inconsistent + fit.agreement.grazing
    assert marked[measured & ~met].all()
    assert not marked[~measured & ~met].any()
    assert (marked & ~measured).sum() == (met & ~measured).sum() > fit.agreement.missing >= 1.0


def test_a_scan_of_half_the_target_says_that_the_other_half_is_missing():
    T = random_pose(3)
    points_m = scan_at(T, frame=3).points_m.copy()
    whole, _ = fitted(T, scan_of(points_m))
    points_m[:, :20] = np.nan
    half, seen = fitted(T, scan_of(points_m))
    assert whole.agreement.missing < 20.0
    assert half.agreement.missing > 50.0
    assert half.agreement.inconsistent <= whole.agreement.inconsistent
    assert reason_against(T, scan_of(points_m)) == (
        f"does not explain the scan: of {seen.returns} returns {half.agreement.inconsistent} contradict "
        f"the pose, {half.agreement.missing:.0f} more are missing; most of them around azimuth "
        f"{marked_around(T, scan_of(points_m))} deg"
    )


def marked_around(T, scan):
    """Return the median direction of the marked rays, as the operator is told."""
    fit, seen = fitted(T, scan)
    marked = tracker().model.belief(seen, *parts(T), fit).marks.marked
    view = tracker().view
    row, column = (int(np.median(places) + 0.5) for places in np.nonzero(marked))
    azimuth, elevation = np.rad2deg((view.azimuth_rad[column], view.elevation_rad[row]))
    return f"{azimuth:.1f}, elevation {elevation:.1f}"


def test_returns_where_the_pose_predicts_none_all_contradict_it():
    T = make_pose(translation_m=(0.0, 0.0, -30.0))
    fit, seen = fitted(T, scan_at(random_pose(3)))
    assert (fit.agreement.agreeing, fit.agreement.inconsistent, fit.agreement.missing) == (
        0,
        seen.returns,
        0.0,
    )
    assert fit.agreement.share == 0.0
    assert fit.deficit > 0.0


def test_of_nothing_nothing_is_explained():
    fit, _ = fitted(make_pose(translation_m=(0.0, 0.0, -30.0)), scan_of(np.full((41, 41, 3), np.nan)))
    assert np.isnan(fit.agreement.share)
    assert fit.log_likelihood == pytest.approx(0.0, abs=40.0)


@pytest.mark.parametrize("seed", range(4))
def test_samples_give_the_mean_and_the_covariance_of_a_pose_near_a_rough_one(seed):
    T = random_pose(seed, 50.0)
    scan, rough = scan_at(T, SLIM, frame=seed), PoseArrays.of(off(T, 1.5, 0.3, seed))
    model, seen = tracker(SLIM).model, tracker(SLIM).view.seen(scan)
    found = model.posterior(seen, rough, np.diag([0.3**2] * 3 + [0.03**2] * 3))
    mean = stepped(rough, found.mean)
    assert model.fit(seen, *mean).log_likelihood > model.fit(seen, *rough).log_likelihood
    off_by = step_between(pose_of(*mean), T)
    assert off_by @ np.linalg.solve(found.covariance, off_by) < 22.5
    assert np.linalg.norm(off_by[:3]) < 0.2
    again = model.posterior(seen, rough, np.diag([0.3**2] * 3 + [0.03**2] * 3))
    np.testing.assert_array_equal(found.mean, again.mean)


def test_a_pose_is_settled_where_no_pose_around_it_is_clearly_likelier():
    """At right poses, and not some standard deviations beside them, though the covariance is the same."""
    settled = {True: 0, False: 0}
    for seed in range(8):
        T = random_pose(seed, 30.0)
        seen = tracker(BULKY).view.seen(scan_at(T, frame=seed))
        right = tracker(BULKY).track(scan_at(T, frame=seed), T).T_sensor_target
        sigma = np.repeat((0.01, np.radians(0.1)), 3)
        for step in (np.zeros(6), 5.0 * sigma):
            pose = stepped(PoseArrays.of(right), step)
            is_settled = tracker(BULKY).model.is_settled(seen, pose, np.diag(sigma**2))
            settled[not step.any()] += is_settled
    assert settled[True] == 8
    assert settled[False] <= 1


def test_the_way_uphill_is_found_from_steps_that_are_not_likelier():
    """On a slope of 2 a sigma, none of the drawn steps is likelier by more than ``CHANCE``."""
    generator = np.random.default_rng(1)
    root = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]) @ (np.eye(6) + 0.2 * generator.normal(size=(6, 6)))
    covariance, slope = root @ root.T, generator.normal(size=6)
    slope *= 2.0 / np.linalg.norm(slope)
    steps = steps_of(covariance, DRAWN_POWER)
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), steps.T).T
    gains = whitened @ slope - 0.5 * (whitened**2).sum(axis=1)
    assert gains.max() <= CHANCE
    along = np.linalg.solve(np.linalg.cholesky(covariance), uphill(steps, gains).T).T
    np.testing.assert_allclose(along, np.outer(UPHILL_SIGMAS, slope / 2.0), atol=1e-3)


def test_the_mass_of_a_posterior_is_the_integral_of_its_likelihood():
    T = random_pose(0, 20.0)
    model, seen = tracker().model, tracker().view.seen(scan_at(T, frame=0))
    found = model.posterior(seen, PoseArrays.of(T), np.diag([0.01**2] * 3 + [0.001**2] * 3))
    log_likelihood = model.fit(seen, *stepped(PoseArrays.of(T), found.likeliest)).log_likelihood
    laplace = log_likelihood + 0.5 * np.linalg.slogdet(2.0 * np.pi * found.covariance)[1]
    assert found.log_mass == pytest.approx(laplace, abs=2.0)


def test_an_attitude_of_which_a_scan_tells_nothing_is_counted_once():
    seen = tracker().view.seen(scan_at(random_pose(0, 20.0), frame=0))
    hidden = replace(seen, range_m=np.full_like(seen.range_m, -1.0))
    rough = np.diag([0.01**2] * 3 + [1.0] * 3)
    found = tracker().model.posterior(hidden, PoseArrays.of(random_pose(0, 20.0)), rough)
    assert np.sqrt(np.trace(found.covariance[3:, 3:]) / 3.0) < np.pi


@pytest.mark.parametrize("world", ["documented", "outliers", "noisy"])
def test_neighbouring_residuals_are_alike_for_a_wrong_model_only(world):
    emulator = LidarEmulator(LIDAR, load(BULKY), seed=5, world=world_of(world))
    right, wrong = [], []
    for seed in range(6):
        T = random_pose(seed, 20.0)
        scan = scan_of(emulator.scan([T], frame=seed).points_m)
        model, seen = tracker(BULKY).model, tracker(BULKY).view.seen(scan)
        right.append(model.misfit(seen, *parts(T)))
        wrong.append(
            model.misfit(seen, *parts(make_pose(rotation=T.rotation, translation_m=1.01 * T.translation)))
        )

    def sigmas(told):
        return sum(each.value for each in told) / np.sqrt(sum(each.variance for each in told))

    assert sigmas(right) < 3.0
    assert sigmas(wrong) > 6.0
