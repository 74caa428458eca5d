"""Unsuccessful searches are limited, and begin again with the first frame that shows something else."""

import numpy as np
import pytest

from rpod_estimator.backoff import Backoff
from rpod_schemas.types import Camera, LidarScan, PmdFrame

CAMERA = Camera(width=88, height=72, fx=90.0, fy=90.0, cx=43.5, cy=35.5)
SEARCH_S = 0.4


def pmd(rng, *, target=False, wall=True):
    """A noisy wall or nothing but stray pixels, and a body in front of it."""
    depth_m = np.full((72, 88), 6.0) + 0.03 * rng.standard_normal((72, 88))
    depth_m[rng.random((72, 88)) < (0.1 if wall else 0.9)] = np.nan
    if not wall:
        depth_m *= rng.uniform(0.1, 1.2, depth_m.shape)
    if target:
        depth_m[20:40, 30:50] = 4.0
    image = depth_m.astype(np.float32)
    return PmdFrame(stamp_ns=1, frame_id="pmd", depth_m=image, amplitude=None, camera=CAMERA)


def lidar(rng, *, target=False, wall=True):
    azimuth, elevation = np.meshgrid(np.linspace(-0.3, 0.3, 40), np.linspace(-0.3, 0.3, 40))
    range_m = (20.0 if wall else np.nan) + 0.05 * rng.standard_normal(azimuth.shape)
    if target:
        range_m[10:25, 10:25] = 15.0
    ray = np.stack([np.sin(azimuth), np.sin(elevation), np.cos(azimuth)], axis=-1)
    points_m = (range_m[..., None] * ray).astype(np.float32)
    return LidarScan(stamp_ns=1, frame_id="lidar", points_m=points_m)


class Search:
    """A stream at 15 Hz in which each search takes ``SEARCH_S``."""

    def __init__(self, frame, **scene):
        self.backoff, self.now_s, self.searches_s = Backoff(), 0.0, []
        self._frame, self._scene, self._rng = frame, scene, np.random.default_rng(1)

    def arrive(self, *, accepted=False, **scene):
        """Let a frame arrive; return whether it was searched."""
        self.now_s += 1 / 15
        data = self._frame(self._rng, **(self._scene | scene))
        if self.backoff.is_paused(data, self.now_s):
            return False
        began_s, self.now_s = self.now_s, self.now_s + SEARCH_S
        self.searches_s.append(began_s)
        if accepted:
            self.backoff.end()
        else:
            self.backoff.take(data, began_s=began_s, now_s=self.now_s)
        return True

    def until(self, end_s, **how):
        while self.now_s < end_s:
            self.arrive(**how)
        return self


@pytest.mark.parametrize("frame", [pmd, lidar])
@pytest.mark.parametrize("wall", [True, False])
def test_after_ten_seconds_in_vain_searches_take_a_tenth_of_the_time(frame, wall):
    search = Search(frame, wall=wall).until(60.0)
    before = [begun for begun in search.searches_s if begun < 10.0]
    assert len(before) >= 20
    assert SEARCH_S * (len(search.searches_s) - len(before)) <= 0.105 * 50.0
    assert search.backoff.pause_s == pytest.approx(10 * SEARCH_S)


@pytest.mark.parametrize("frame", [pmd, lidar])
def test_the_first_frame_that_differs_is_searched_and_so_are_those_after_it(frame):
    search = Search(frame).until(30.0)
    while search.arrive():
        pass
    assert search.arrive(target=True)
    assert all(search.arrive(target=True) for _ in range(15))


def test_a_found_target_and_a_reset_end_the_rest():
    search = Search(pmd).until(30.0)
    while not search.arrive(accepted=True):
        pass
    assert search.backoff.pause_s == 0.0
    search.until(60.0)
    assert search.backoff.pause_s
    search.backoff.end()
    assert search.arrive()


def test_a_stream_whose_frames_change_their_size_is_compared_with_the_newest_ones_only():
    rng = np.random.default_rng(3)
    rows = [lidar(rng) for _ in range(4)]
    alone = [scan.model_copy(update={"points_m": scan.returns_m}) for scan in rows]
    backoff = Backoff()
    for number, scan in enumerate((*rows, *alone)):
        backoff.take(scan, began_s=2.0 * number, now_s=2.0 * number + SEARCH_S)
    assert backoff.pause_s > 0.0
    assert backoff.is_paused(alone[0], 14.5)
    assert not backoff.is_paused(rows[0], 14.5), "another kind of scan is searched"
