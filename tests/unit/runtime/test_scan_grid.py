"""Directions of a scanner's rays, inferred from its points."""

import numpy as np
import pytest

from rpod_runtime.sensor_data.scan_grid import GridInference, rows_are_elevation

AZIMUTH = np.radians(np.arange(-20.0, 20.5))
ELEVATION = np.radians(np.arange(-15.0, 15.5))
NOISE_RAD = 2e-4


def scan(azimuth=AZIMUTH, elevation=ELEVATION, *, half_m=1.5, at_m=10.0, seed=1):
    """Return the points of a square plate, (rows, columns, 3), NaN beside it; rows are elevations."""
    rng = np.random.default_rng(seed)
    el, az = np.meshgrid(elevation, azimuth, indexing="ij")
    el = el + rng.normal(0.0, NOISE_RAD, el.shape)
    az = az + rng.normal(0.0, NOISE_RAD, az.shape)
    rays = np.stack((np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)), axis=-1)
    with np.errstate(divide="ignore"):
        points = rays * (at_m / rays[..., 2:])
    hit = (np.abs(points[..., :2]) < half_m).all(axis=-1) & (rays[..., 2] > 0.0)
    return np.where(hit[..., None], points, np.nan).astype(np.float32)


def inferred(*scans):
    grid = GridInference()
    for points in scans:
        grid.add(points, 0.0)
    return grid.pattern


@pytest.mark.parametrize("half_m", [0.4, 1.5])
def test_the_orientation_is_seen_in_the_points(half_m):
    points = scan(half_m=half_m)
    assert rows_are_elevation(points) is True
    assert rows_are_elevation(points.transpose(1, 0, 2)) is False
    assert rows_are_elevation(np.full((5, 5, 3), np.nan, np.float32)) is None


@pytest.mark.parametrize("half_m", [0.8, 1.5])
def test_lines_without_returns_follow_from_those_with_returns(half_m):
    pattern = inferred(*(scan(half_m=half_m, seed=seed) for seed in range(3)))
    step = np.radians(1.0)
    assert np.abs(pattern.azimuth_rad - AZIMUTH).max() < 0.1 * step
    assert np.abs(pattern.elevation_rad - ELEVATION).max() < 0.1 * step


def test_a_pattern_that_has_not_changed_stays_the_same_object():
    grid = GridInference()
    grid.add(scan(), 0.0)
    first = grid.pattern
    grid.add(scan(seed=2), 0.0)
    assert grid.pattern is first


def test_a_turning_head_with_uneven_beams():
    azimuth = np.radians(np.arange(0.0, 360.0, 0.5))
    elevation = np.radians([-15.0, -11.0, -8.0, -6.0, -4.0, -2.0, 0.0, 3.0, 8.0, 15.0])
    room = np.stack([scan(azimuth, elevation, half_m=9.0, at_m=3.0)])[0]
    pattern = inferred(room)
    assert np.abs(np.angle(np.exp(1j * (pattern.azimuth_rad - azimuth)))).max() < np.radians(0.1)
    np.testing.assert_allclose(pattern.elevation_rad, elevation, atol=np.radians(0.1))


@pytest.mark.parametrize("shift", [0.0, 0.37])
def test_points_without_order_show_the_lines_on_which_they_lie(shift):
    azimuth = AZIMUTH + np.radians(shift)
    points = scan(azimuth).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    pattern = inferred(np.random.default_rng(3).permutation(points))
    step = np.radians(1.0)
    for lines, true in ((pattern.azimuth_rad, azimuth), (pattern.elevation_rad, ELEVATION)):
        assert np.median(np.diff(lines)) == pytest.approx(step, rel=0.02)
        nearest = true[np.abs(true[:, None] - lines).argmin(axis=0)]
        near = np.abs(lines) < np.radians(9.0)
        assert np.abs(lines - nearest)[near].max() < 0.1 * step
        assert lines[0] < np.radians(-12.0)
        assert lines[-1] > np.radians(12.0)


@pytest.mark.parametrize(("columns", "offset_deg"), [(1024, 0.0), (2048, 0.0), (1024, 1.4), (2000, 0.9)])
def test_a_head_that_turns_all_around_in_a_room_shows_its_lines_without_order(columns, offset_deg):
    """Beams of some heads are beside each other, so that their azimuths differ from ring to ring."""
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    elevation = np.radians(np.linspace(-22.5, 22.5, 64))
    el, az = np.meshgrid(elevation, azimuth, indexing="ij")
    az = az + np.radians(offset_deg) * np.sin(5.0 * np.arange(64))[:, None]
    rays = np.stack((np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)), axis=-1)
    points = (6.0 * rays / np.abs(rays).max(axis=-1, keepdims=True)).reshape(-1, 3)  # walls, floor, ceiling
    pattern = inferred(points.astype(np.float32))
    step = np.median(np.diff(azimuth))
    assert 0.3 * step < np.median(np.diff(pattern.azimuth_rad)) < 1.5 * step
    nearest = np.abs(elevation[:, None] - pattern.elevation_rad).min(axis=1)
    assert nearest.max() < 0.1 * np.median(np.diff(elevation))
    assert pattern.azimuth_rad.size * pattern.elevation_rad.size <= 2**18


def on_a_plate(azimuth, elevation):
    """Return the points of a plate 5 m ahead, shape (N, 3)."""
    points = np.stack((np.tan(azimuth), np.tan(elevation) / np.cos(azimuth), np.ones_like(azimuth)), axis=-1)
    return (5.0 * points).astype(np.float32)


@pytest.mark.parametrize("count", [30, 300, 3_000])
@pytest.mark.parametrize("seed", range(3))
def test_points_at_random_get_as_many_cells_as_they_are(count, seed):
    """Lines that 300 points seem to form would be nine times too dense."""
    azimuth, elevation = np.random.default_rng(seed).uniform(-0.2, 0.2, (2, count))
    pattern = inferred(on_a_plate(azimuth, elevation))
    apart = 0.4 / np.sqrt(count)
    for lines in (pattern.azimuth_rad, pattern.elevation_rad):
        assert 0.7 * apart < np.median(np.diff(lines)) < 1.3 * apart
    assert inferred(on_a_plate(azimuth, elevation)[:2]) is None


def test_a_rosette_gets_cells_as_wide_as_the_gaps_between_its_loops():
    angle = np.linspace(0.0, 12.0 * np.pi, 12_000)
    radius = 0.2 * np.cos(2.618 * angle)
    pattern = inferred(on_a_plate(radius * np.cos(angle), radius * np.sin(angle)))
    along = np.median(np.hypot(*np.diff((radius * np.cos(angle), radius * np.sin(angle)))))
    assert np.median(np.diff(pattern.azimuth_rad)) > 3.0 * along


def test_rings_whose_azimuths_differ_get_the_step_within_a_ring():
    step, rng = np.radians(0.4), np.random.default_rng(6)
    elevation = np.radians(np.linspace(-8.0, 8.0, 9))
    azimuth = np.arange(-0.2, 0.2, step) + rng.uniform(0.0, step, (9, 1))
    pattern = inferred(on_a_plate(azimuth.ravel(), np.repeat(elevation, azimuth.shape[1])))
    assert np.median(np.diff(pattern.azimuth_rad)) == pytest.approx(step, rel=0.01)
    assert np.abs(pattern.elevation_rad[:, None] - elevation).min(axis=0).max() < 1e-4


def test_points_that_no_scanner_sends_are_no_end():
    rng, plate = np.random.default_rng(5), scan()
    strange = {
        "no points": np.zeros((0, 3)),
        "infinite": np.full((41, 41, 3), np.inf),
        "huge": rng.choice((-3e38, 3e38), (41, 41, 3)),
        "zero": np.zeros((41, 41, 3)),
        "tiny": np.full((41, 41, 3), 1e-30),
        "one place": np.tile((0.0, 0.0, 20.0), (50, 1)),
        "a column": np.column_stack((np.zeros(60), np.linspace(-5.0, 5.0, 60), np.full(60, 20.0))),
        "without order": rng.normal(0.0, 9.0, (41, 41, 3)),
        "behind": -plate,
        "two rows": plate[15:17],
    }
    for name, points in strange.items():
        grid = GridInference()
        for cloud in (points, points.reshape(-1, 3)):
            if cloud.ndim == 3:
                grid.learn_rows(cloud.astype(np.float32))
                grid.add(grid.in_order(cloud.astype(np.float32)), 0.0)
            grid.add(cloud.astype(np.float32), 0.0)
            if cloud.ndim == 3:
                rows_are_elevation(cloud.astype(np.float32))
        assert grid.pattern is None or np.isfinite(grid.pattern.azimuth_rad).all(), name
