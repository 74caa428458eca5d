"""Scans of turning heads whose rows look aside, each by an angle of its own."""

import numpy as np
import pytest

from rpod_runtime.sensor_data.scan_grid import GridInference, angles_of, rows_are_elevation

TURN = np.linspace(np.pi, -np.pi, 1024, endpoint=False)
LASERS = np.radians(np.linspace(13.0, -15.0, 32))
IN_FOUR = np.tile(np.radians([4.23, 1.41, -1.42, -4.24]), 8)
"""Azimuths like those of Ouster's lasers."""
UNEVEN = np.tile(np.radians([3.26, -1.1, 5.4, -4.9, 0.2, 2.2, -3.3, 1.0]), 4)
"""Azimuths like those of Hesai's lasers, which are no whole columns."""
NOISE_RAD = 2e-4


def scan(azimuth, aside, *, half_m, seed=0, missing=0.0, without=np.nan):
    """Return the points of a square plate in 6 m, (32, columns, 3), as a head with these lasers sends it."""
    rng = np.random.default_rng(seed)
    el, az = np.meshgrid(LASERS, azimuth, indexing="ij")
    az = az + aside[:, None] + rng.normal(0.0, NOISE_RAD, az.shape)
    rays = np.stack((np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)), axis=-1)
    ahead = rays[..., 2] > 0.01
    points = rays * (6.0 / np.where(ahead, rays[..., 2], 1.0))[..., None]
    hit = ahead & (np.abs(points[..., :2]) < half_m).all(axis=-1) & (rng.random(el.shape) >= missing)
    return np.where(hit[..., None], points, without).astype(np.float32)


def learned(scans):
    """Return what was inferred from scans, and the last one in order."""
    grid, ordered = GridInference(), None
    for points in scans:
        grid.learn_rows(points)
        ordered = grid.in_order(points)
        grid.add(ordered, 0.1)
    return grid, ordered


HEADS = {
    "a turn": (TURN, IN_FOUR, 3.0),
    "a turn, half as many columns": (TURN[::2], IN_FOUR, 3.0),
    "no whole columns": (TURN[::-1], UNEVEN, 3.0),
    "a sector": (np.radians(np.arange(-25.0, 25.0, 0.35)), IN_FOUR, 1.2),
    "a narrow sector": (np.radians(np.arange(6.0, -6.0, -0.18)), UNEVEN, 0.4),
}


@pytest.mark.parametrize("without", [np.nan, 0.0])
@pytest.mark.parametrize("head", HEADS)
def test_each_return_lies_on_its_ray_of_the_pattern(head, without):
    azimuth, aside, half_m = HEADS[head]
    scans = [scan(azimuth, aside, half_m=half_m, seed=n, missing=0.2, without=without) for n in range(3)]
    grid, ordered = learned(scans)
    step = abs(azimuth[1] - azimuth[0])
    seen, elevation, returned = angles_of(ordered)
    assert np.count_nonzero(returned) == np.count_nonzero(angles_of(scans[-1])[2])
    rows, columns = np.nonzero(returned)
    expected = grid.pattern.azimuth_rad[columns] + grid.pattern.row_azimuth_rad[rows]
    off = np.abs(np.angle(np.exp(1j * (seen[returned] - expected))))
    assert np.quantile(off, 0.99) < 4.0 * NOISE_RAD
    assert off.max() < 0.3 * step
    assert np.abs(elevation[returned] - grid.pattern.elevation_rad[rows]).max() < 1e-4
    assert np.abs(grid.pattern.row_azimuth_rad).max() < 0.6 * step


def test_neighbours_in_the_scan_are_neighbours_in_the_world():
    _, ordered = learned([scan(TURN, IN_FOUR, half_m=3.0)])
    azimuth, _, returned = angles_of(ordered)
    both = returned[1:] & returned[:-1]
    assert np.count_nonzero(both) > 1000
    assert np.abs(np.diff(azimuth, axis=0)[both]).max() < 1.1 * abs(TURN[1] - TURN[0])


def test_cells_that_no_ray_of_a_sector_measured_tell_nothing():
    azimuth, aside, half_m = HEADS["a sector"]
    points = scan(azimuth, aside, half_m=half_m)
    grid, ordered = learned([points])
    unknown = np.isinf(ordered).all(axis=-1)
    assert np.count_nonzero(~unknown) == points[..., 0].size
    times = grid.in_order(np.zeros(points.shape[:2], np.float32))
    np.testing.assert_array_equal(np.isnan(times), unknown)


@pytest.mark.parametrize("half_m", [0.15, 0.4, 3.0])
def test_the_orientation_of_staggered_rows_is_seen_also_on_a_small_plate(half_m):
    points = scan(TURN, IN_FOUR, half_m=half_m)
    assert rows_are_elevation(points) is True
    assert rows_are_elevation(points.transpose(1, 0, 2)) is False


def test_a_pattern_whose_rows_are_known_stays_the_same_object():
    grid, _ = learned([scan(TURN, IN_FOUR, half_m=3.0)])
    before = grid.pattern
    for seed in range(1, 15):
        grid.learn_rows(scan(TURN, IN_FOUR, half_m=2.0, seed=seed))
        grid.add(grid.in_order(scan(TURN, IN_FOUR, half_m=2.0, seed=seed)), 0.1)
    assert grid.pattern is before


@pytest.mark.parametrize("jitter_steps", [0.0, 0.1])
def test_rows_that_are_not_staggered_stay_where_they_are(jitter_steps):
    step = abs(TURN[1] - TURN[0])
    aside = jitter_steps * step * np.random.default_rng(2).normal(size=32).clip(-2.0, 2.0)
    points = scan(TURN, aside, half_m=2.0)
    grid, ordered = learned([points])
    assert ordered is points
    assert grid.pattern.row_azimuth_rad is None
    assert not grid.aside_rad


def test_a_head_that_changes_its_mode_is_learned_anew():
    grid, _ = learned([scan(TURN, IN_FOUR, half_m=3.0), scan(TURN[::2], IN_FOUR, half_m=3.0)])
    assert grid.pattern.azimuth_rad.shape == (512,)
    assert grid.pattern.row_azimuth_rad.shape == (32,)
