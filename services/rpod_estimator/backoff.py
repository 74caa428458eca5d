"""Limit of unsuccessful searches: if the target is not in view, not every frame is searched.

After ``PATIENCE_S`` of unsuccessful searches, searches take at most a tenth of the time. This ends with the
first frame whose content differs from that of the frames without the target. The module knows no bus and no
clock; times are seconds of one monotonic clock.
"""

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import SensorFrame

PATIENCE_S = 10.0
"""Time of unsuccessful searches after which they are limited."""
SHARE = 0.1
"""Largest share of the time that limited searches take."""
_BLOCKS = 12
"""Number of blocks along each side of an image whose content is compared."""
_LEAST_SHARE = 0.3
"""Least share of measured pixels in a block whose mean range is compared; the mean of a few stray pixels is
noise."""
_DIRECTIONS = 48
"""Number of directions along each side of the image of a scan without rows and columns, over 180 deg."""
_REMEMBERED = 32
"""Number of recent frames that define the scene without the target."""
_DIFFERENT_BLOCKS = 3
"""Least number of changed blocks in a frame that counts as different."""
_MARGIN, _MARGIN_RANGES = 0.1, 0.5
"""Least change of a changed block, beyond the range of its values in the remembered frames: a constant, and a
share of the width of this range. For normal noise and 32 frames, the share sets the limit at four sigma."""


class Backoff:
    """Decides which frames of a sensor are searched."""

    def __init__(self) -> None:
        self._since_s: float | None = None
        self._seen: deque[FloatArray] = deque(maxlen=_REMEMBERED)
        self._next_s = 0.0
        self.pause_s = 0.0
        """Time between two searches, s; 0 while every frame is searched."""

    def is_paused(self, frame: SensorFrame, now_s: float) -> bool:
        """Return whether a frame is not searched, because it looks like the frames without the target."""
        if not self.pause_s:
            return False
        if self._differs(content(frame)):
            self.end()
            return False
        return now_s < self._next_s

    def take(self, frame: SensorFrame, *, began_s: float, now_s: float) -> None:
        """Note an unsuccessful search in a frame, which lasted from ``began_s`` to ``now_s``."""
        self._since_s = began_s if self._since_s is None else self._since_s
        seen = content(frame)
        if self._seen and self._seen[-1].shape != seen.shape:  # another image size, or another kind of scan
            self._seen.clear()
        self._seen.append(seen)
        if now_s - self._since_s >= PATIENCE_S:
            self.pause_s = (now_s - began_s) / SHARE
            self._next_s = began_s + self.pause_s

    def end(self) -> None:
        """Search every frame again: something has changed."""
        self._since_s, self.pause_s = None, 0.0
        self._seen.clear()

    def _differs(self, now: FloatArray) -> bool:
        seen = self._seen
        if not seen or seen[-1].shape != now.shape:
            return True
        low, high = np.min(seen, axis=0), np.max(seen, axis=0)
        margin = _MARGIN + _MARGIN_RANGES * (high - low)
        return int(((now < low - margin) | (now > high + margin)).any(axis=-1).sum()) >= _DIFFERENT_BLOCKS


def content(frame: SensorFrame) -> FloatArray:
    """Return the coarse content of a frame, shape (blocks, 2).

    For each block it is the share of measured pixels, and the mean logarithm of their ranges, or 0 if the
    share is too small. A scan without rows and columns is sorted into an image of directions.
    """
    range_m = _image(frame)
    rows, columns = (max(1, side // _BLOCKS) for side in range_m.shape)
    kept = range_m[: rows * (range_m.shape[0] // rows), : columns * (range_m.shape[1] // columns)]
    blocks = kept.reshape(kept.shape[0] // rows, rows, kept.shape[1] // columns, columns).swapaxes(1, 2)
    flat = blocks.reshape(-1, rows * columns)
    known = np.isfinite(flat) & (flat > 0.0)
    count = known.sum(axis=1)
    share = count / flat.shape[1]
    logs = np.log(np.where(known, flat, 1.0)).sum(axis=1) / np.maximum(count, 1)
    return np.column_stack([share, np.where(share >= _LEAST_SHARE, logs, 0.0)])


def _image(frame: SensorFrame) -> NDArray[Any]:
    if frame.images:
        return np.asarray(frame.images[0].values, np.float32)
    if frame.range_image_m is not None:
        return frame.range_image_m
    returns_m = frame.returns_m
    up, right = (np.arctan2(returns_m[:, axis], returns_m[:, 2]) for axis in (1, 0))
    sums, counts = (
        np.histogram2d(up, right, bins=_DIRECTIONS, range=[[-np.pi / 2, np.pi / 2]] * 2, weights=weights)[0]
        for weights in (np.linalg.norm(returns_m, axis=1), None)
    )
    return np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
