import numpy as np
import pytest
from lidar_scans import LIDAR, random_pose, scan_at, scan_of
from scipy.spatial.transform import Rotation

from rpod_geometry.rays import RayGrid, cast
from rpod_pose.lidar.scan_pattern import ScanPattern
from rpod_pose.lidar.scan_view import ScanView, spacing_rad
from rpod_pose.lidar.single_scan import acquire
from rpod_runtime.sensor_data.scan_grid import GridInference
from rpod_schemas.poses import make_pose
from rpod_target import load_target

VIEW = ScanView.of(LIDAR.azimuth_rad, LIDAR.elevation_rad)
SCAN = scan_at(random_pose(3))


def returned_m(scan):
    points_m = scan.points_m.reshape(-1, 3)
    return points_m[np.isfinite(points_m).all(axis=1)]


def assert_same(one, other):
    np.testing.assert_array_equal(one.range_m, other.range_m)
    order, other_order = np.argsort(one.rays), np.argsort(other.rays)
    np.testing.assert_array_equal(one.rays[order], other.rays[other_order])
    np.testing.assert_array_equal(one.points_m[order], other.points_m[other_order])


def test_an_organised_scan_keeps_its_returns_on_their_own_rays():
    seen = VIEW.seen(SCAN)
    returned = np.isfinite(SCAN.points_m).all(axis=-1)
    assert seen.returns == returned.sum()
    np.testing.assert_array_equal(seen.range_m > 0.0, returned)
    np.testing.assert_array_equal(seen.rays, np.flatnonzero(returned))
    along_m = VIEW.grid.directions.reshape(-1, 3)[seen.rays] * seen.range_m.flat[seen.rays][:, None]
    np.testing.assert_allclose(along_m, seen.points_m, atol=2e-3)  # the error of pointing


@pytest.mark.parametrize("seed", range(3))
def test_an_unorganised_scan_is_sorted_onto_the_same_rays(seed):
    shuffled_m = np.random.default_rng(seed).permutation(returned_m(SCAN))
    assert_same(VIEW.seen(scan_of(shuffled_m)), VIEW.seen(SCAN))


def test_a_pattern_may_run_in_any_order():
    back = ScanView.of(LIDAR.azimuth_rad[::-1].copy(), LIDAR.elevation_rad[::-1].copy())
    seen = back.seen(scan_of(returned_m(SCAN)))
    np.testing.assert_array_equal(seen.range_m, VIEW.seen(SCAN).range_m[::-1, ::-1])


def test_a_point_beside_the_pattern_belongs_to_no_ray():
    beside_m = np.array([[15.0, 0.0, 20.0], [0.0, -15.0, 20.0], [0.0, 0.0, -20.0], [0.0, 0.0, 20.0]])
    seen = VIEW.seen(scan_of(beside_m))
    assert (seen.rays[:3] == -1).all()
    assert np.count_nonzero(seen.range_m) == 1
    assert seen.range_m.flat[seen.rays[3]] == 20.0
    assert seen.returns == 4


def test_returns_beside_the_rays_are_the_rays_themselves():
    """The rays of a scan that never repeats are where its returns are, and between them nothing is known."""
    x, y = np.random.default_rng(2).uniform(-2.0, 2.0, (2, 60))
    points_m = np.stack((x, y, np.full_like(x, 20.0)), axis=-1)
    seen = VIEW.seen(scan_of(points_m))
    directions = points_m / np.linalg.norm(points_m, axis=1, keepdims=True)
    np.testing.assert_allclose(seen.grid.directions.reshape(-1, 3)[seen.rays], directions, atol=1e-6)
    assert np.unique(seen.rays).size == 60
    row, column = np.divmod(seen.rays, LIDAR.azimuth_rad.size)
    assert (seen.range_m[row + 1, column] != 0.0).all()
    assert seen.range_m[0, 0] == 0.0


@pytest.mark.parametrize("kind", ["random", "rings"])
def test_a_pose_is_found_by_rays_that_no_pattern_repeats(kind):
    """Three scans of a mock-up at 5 m, noise 6 mm; with fixed rays none at random was accepted."""
    target, found = load_target("mockup"), []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        truth = make_pose(rotation=Rotation.random(rng=rng), translation_m=(0.1, -0.1, 5.0))
        azimuth, elevation = rng.uniform(-0.25, 0.25, (2, 1_600))
        if kind == "rings":
            elevation = np.repeat(np.linspace(-0.25, 0.25, 40), 40)
            azimuth = (np.arange(40) / 80.0 - 0.25 + rng.uniform(0.0, 1.0 / 80.0, (40, 1))).ravel()
        rays = RayGrid(np.stack((np.tan(azimuth), np.tan(elevation), np.ones(1_600)))[:, None])
        rays = RayGrid(rays.components / np.linalg.norm(rays.components, axis=0))
        range_m = cast(rays, target.triangles_m, truth).range_m
        points_m = ((range_m + rng.normal(0.0, 0.006, range_m.shape))[..., None] * rays.directions)[
            np.isfinite(range_m)
        ]
        grid = GridInference()
        grid.add(points_m.astype(np.float32), 0.0)
        sensor = grid.pattern.model_copy(update={"sigma_range_m": 0.006})
        acquisition = acquire(scan_of(points_m), target, sensor)
        off = truth.inv() * acquisition.pose
        assert np.degrees(off.rotation.magnitude()) < 0.5
        assert np.linalg.norm(off.translation) < 0.01
        found.append(str(acquisition.outcome))
    assert found.count("accepted") >= 2


def test_what_is_not_finite_did_not_return():
    points_m = SCAN.points_m.copy()
    lost = np.flatnonzero(np.isfinite(points_m[..., 0]))[:4]
    for ray, component, value in zip(lost, (0, 1, 2, 0), (np.inf, -np.inf, np.nan, np.inf), strict=True):
        points_m.reshape(-1, 3)[ray, component] = value
    assert VIEW.seen(scan_of(points_m)).returns == VIEW.seen(SCAN).returns - len(lost)


@pytest.mark.parametrize("stride", [2, 3, 7])
def test_a_thinned_scan_is_what_the_thinned_pattern_saw(stride):
    thin = SCAN.points_m[::stride, ::stride]
    assert_same(VIEW.seen(SCAN).every(stride), VIEW.every(stride).seen(scan_of(thin)))


def test_a_scan_without_every_second_row_is_thinned_to_the_others():
    points_m = SCAN.points_m.copy()
    points_m[::2] = np.nan
    seen = VIEW.seen(scan_of(points_m))
    first = seen.first(2)
    assert first[0] == 1
    thin = points_m[first[0] :: 2, first[1] :: 2]
    assert_same(seen.every(2, first), VIEW.every(2, first).seen(scan_of(thin)))
    assert VIEW.seen(SCAN).first(2) == (0, 0)


@pytest.mark.parametrize("turns", [-1, 1])
def test_azimuths_may_count_from_any_turn(turns):
    turned = ScanView.of(LIDAR.azimuth_rad + 2.0 * np.pi * turns, LIDAR.elevation_rad)
    np.testing.assert_array_equal(
        turned.seen(scan_of(returned_m(SCAN))).rays, VIEW.seen(scan_of(returned_m(SCAN))).rays
    )


def test_a_point_beside_the_pattern_is_thinned_away():
    seen = VIEW.seen(scan_of([[15.0, 0.0, 20.0], [0.0, 0.0, 20.0]]))
    assert seen.every(2).returns == 1


def test_a_scan_is_cut_off_where_an_outermost_ray_returned():
    points_m = SCAN.points_m.copy()
    points_m[[0, -1]] = points_m[:, [0, -1]] = np.nan
    assert not VIEW.seen(scan_of(points_m)).cut_off
    points_m[-1, 7] = (1.0, 2.0, 20.0)
    assert VIEW.seen(scan_of(points_m)).cut_off


@pytest.mark.parametrize("count", [10, 64, 10**6])
def test_points_are_thinned_to_about_the_number_asked_for(count):
    seen = VIEW.seen(SCAN)
    assert len(seen.downsampled(count)) == pytest.approx(min(count, seen.returns), rel=0.25)


def test_the_spacing_is_the_typical_one_and_that_of_a_single_line_a_degree():
    assert spacing_rad(LIDAR.azimuth_rad) == pytest.approx(np.deg2rad(1.0))
    assert spacing_rad(np.array([0.3])) == pytest.approx(np.deg2rad(1.0))
    assert spacing_rad(np.array([0.3, 0.1, -0.1])) == pytest.approx(0.2)


def staggered():
    """Return the azimuths by which rows are beside the columns, half a column at most, and their view."""
    beside_rad = np.linspace(-0.5, 0.5, LIDAR.elevation_rad.size) * spacing_rad(LIDAR.azimuth_rad)
    return beside_rad, ScanView.of(LIDAR.azimuth_rad, LIDAR.elevation_rad, beside_rad)


def test_points_are_sorted_onto_the_rays_of_rows_that_are_beside_the_columns():
    _, view = staggered()
    seen = view.seen(scan_of(20.0 * view.grid.directions.reshape(-1, 3)))
    np.testing.assert_array_equal(seen.rays, np.arange(seen.rays.size))
    half = view.every(2)
    np.testing.assert_allclose(half.grid.directions, view.grid.directions[::2, ::2])


def test_patterns_are_equal_if_their_rays_and_noise_are():
    beside_rad, _ = staggered()
    patterns = [
        ScanPattern(LIDAR.azimuth_rad, LIDAR.elevation_rad),
        ScanPattern(LIDAR.azimuth_rad, LIDAR.elevation_rad, 0.02),
        ScanPattern(LIDAR.azimuth_rad, LIDAR.elevation_rad, row_azimuth_rad=beside_rad),
        ScanPattern(LIDAR.azimuth_rad[1:], LIDAR.elevation_rad),
    ]
    for n, one in enumerate(patterns):
        again = ScanPattern(one.azimuth_rad.copy(), one.elevation_rad, one.sigma_range_m, one.row_azimuth_rad)
        assert [again == other for other in patterns] == [n == m for m in range(len(patterns))]


def test_a_target_is_cut_off_at_the_outermost_rays_that_measured():
    points_m = np.full((*VIEW.shape, 3), np.nan, np.float32)
    points_m[:, :2] = np.inf  # no ray measured there
    points_m[10, 10] = 0.0, 0.0, 20.0
    assert not VIEW.seen(scan_of(points_m)).cut_off
    points_m[10, 2] = -5.0, 0.0, 20.0
    assert VIEW.seen(scan_of(points_m)).cut_off
