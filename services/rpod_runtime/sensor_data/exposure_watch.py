"""Whether the amplitude of a camera is of the same exposure as its depth.

A driver that mixes up its buffers sends the amplitude of the exposure before under the stamp of the depth.
The edges of a moving target are then behind its ranges, and nothing in a single frame says so. Where the
depth of a pixel has changed from one frame to the next, an outline has passed. The amplitude of this pixel is
compared with those of the nearer and of the farther surface beside it: it shows on which side of the outline
the pixel was when the amplitude was taken.
"""

from collections import deque
from collections.abc import Collection
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import Float32Array, PmdFrame

_STEP, _NOISES = 0.03, 6.0
"""Least change of a range that shows an outline: a share of the range, and a multiple of the usual change."""
_AROUND = 4
"""Number of pixels to each side in which the surfaces beside an outline are sought."""
_LEAST_BESIDE = 4
"""Least number of pixels of each surface."""
_CLEAR = 3.0
"""Least difference of the surfaces' amplitudes, over their median absolute deviations together."""
_MOST_PIXELS = 120
"""Largest number of pixels of a pair of frames that are compared."""
_PAIRS = 40
"""Number of the newest pairs of frames that count."""
LEAST_VOTES = 50
"""Number of compared pixels from which they count."""
_MOST_BEHIND, _SIGMAS = 0.65, 3.0
"""Greatest share of pixels that show the frame before; greatest excess over a half, in standard deviations.
Pixels at an outline that does not move change by noise alone, and vote for both frames alike. Faint targets
have 40 to 50 %, moving ones 0 to 19 %; amplitudes of the frame before gave 73 to 100 %."""
_EVERY_S = 0.5
"""Time between two pairs of frames that are compared."""
_SUCCESSIVE = 1.5
"""Greatest time between two successive frames, over the least time between frames."""


class Votes(NamedTuple):
    """Number of pixels by the frame that their amplitude shows."""

    before: int
    now: int

    @property
    def suffice(self) -> bool:
        """Whether there are enough of them."""
        return self.before + self.now >= LEAST_VOTES

    @property
    def behind_share(self) -> float:
        """Share of pixels that show the frame before; 0 without any."""
        return self.before / max(self.before + self.now, 1)

    @property
    def is_behind(self) -> bool:
        """Whether most pixels show the frame before, and not by chance."""
        by_chance = 0.5 + _SIGMAS * 0.5 / sqrt(max(self.before + self.now, 1))
        return self.suffice and self.behind_share > max(_MOST_BEHIND, by_chance)


class ExposureWatch:
    """Compares pairs of successive frames of one camera, twice a second."""

    def __init__(self) -> None:
        self._last: PmdFrame | None = None
        self._least_ns = 0
        self._compared_ns = 0
        self._pairs: deque[Votes] = deque(maxlen=_PAIRS)

    def take(self, frame: PmdFrame) -> None:
        """Take the next frame."""
        last, self._last = self._last, frame
        if last is None or frame.amplitude is None or frame.stamp_ns <= last.stamp_ns:
            return
        step_ns = frame.stamp_ns - last.stamp_ns
        self._least_ns = min(self._least_ns or step_ns, step_ns)
        due = frame.stamp_ns - self._compared_ns >= _EVERY_S * NANOSECONDS
        if due and step_ns <= _SUCCESSIVE * self._least_ns and last.depth_m.shape == frame.depth_m.shape:
            self._compared_ns = frame.stamp_ns
            self._pairs.append(votes(last, frame))

    @property
    def text(self) -> str:
        """Fault that was found, with the remedy; empty if none is known."""
        total = summed(self._pairs)
        if not total.is_behind:
            return ""
        return (
            f"its amplitude is of the exposure before: so say {total.behind_share:.0%} of the pixels that an "
            "outline has passed; let its driver send images of one exposure, or leave that topic out"
        )


def summed(pairs: Collection[Votes]) -> Votes:
    """Return the votes of several pairs of frames together."""
    return Votes(sum(each.before for each in pairs), sum(each.now for each in pairs))


def votes(before: PmdFrame, after: PmdFrame) -> Votes:
    """Return which frame the later one's amplitude shows, by the pixels that an outline has passed.

    Args:
        before: a frame.
        after: the next frame of the same size, with an amplitude.
    """
    assert after.amplitude is not None  # noqa: S101 - the caller's condition
    changed, least_m = _changed(before.depth_m, after.depth_m)
    rows, columns = np.nonzero(changed)
    some = np.random.default_rng(0).permutation(rows.size)[:_MOST_PIXELS]
    rows, columns = rows[some], columns[some]
    own_m = np.stack([_ranges(frame.depth_m[rows, columns]) for frame in (before, after)])
    nearest_m, farther_m = own_m.min(axis=0), own_m.max(axis=0)
    edge_m = nearest_m + np.maximum(_STEP * nearest_m, least_m)
    between_m = np.where(np.isfinite(farther_m), own_m.mean(axis=0), edge_m)
    near = _ranges(_around(after.depth_m, rows, columns, 0.0)) <= between_m[:, None]
    still = _around(~changed, rows, columns, False)
    shade = _around(after.amplitude, rows, columns, 0).astype(np.float64)
    shows_near, is_clear = _shows_near(after.amplitude[rows, columns].astype(np.float64), shade, near, still)
    was_near = own_m[0] <= between_m
    behind = int(np.count_nonzero(is_clear & (shows_near == was_near)))
    return Votes(behind, int(np.count_nonzero(is_clear)) - behind)


def _around(
    image: NDArray[Any], rows: NDArray[np.int64], columns: NDArray[np.int64], beyond: float
) -> NDArray[Any]:
    """Return the pixels around each of N pixels, shape (N, P); ``beyond`` stands outside of the image."""
    size = 2 * _AROUND + 1
    padded = np.pad(image, _AROUND, constant_values=beyond)
    return sliding_window_view(padded, (size, size))[rows, columns].reshape(len(rows), size * size)


def _ranges(depth_m: Float32Array) -> FloatArray:
    """Return the ranges of pixels, m, of any shape; infinite without one."""
    return np.where(_is_measured(depth_m), depth_m, np.inf).astype(np.float64)


def _is_measured(depth_m: Float32Array) -> NDArray[np.bool_]:
    return np.isfinite(depth_m) & (depth_m > 0.0)


def _changed(before_m: Float32Array, after_m: Float32Array) -> tuple[NDArray[np.bool_], float]:
    """Return which pixels an outline has passed, and the least change of any range that counts, m.

    A change also has to be ``_STEP`` of the range.

    Args:
        before_m: depth of a frame, shape (height, width).
        after_m: depth of the next one, same shape.
    """
    measured = _is_measured(before_m), _is_measured(after_m)
    both = measured[0] & measured[1]
    one_m, other_m = before_m[both].astype(np.float64), after_m[both].astype(np.float64)
    moved_m = np.abs(other_m - one_m)
    least_m = _NOISES * float(np.median(moved_m)) if moved_m.size else 0.0
    changed: NDArray[np.bool_] = measured[0] != measured[1]
    changed[both] = moved_m > np.maximum(_STEP * np.minimum(one_m, other_m), least_m)
    return changed, least_m


def _shows_near(
    amplitude: FloatArray, shade: FloatArray, near: NDArray[np.bool_], still: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return whether amplitudes are those of the nearer surfaces beside them, and whether this is clear.

    Args:
        amplitude: amplitudes of N pixels, shape (N,).
        shade: amplitudes around each of them, shape (N, P).
        near: which of these pixels are of the nearer surface, same shape.
        still: which of them no outline has passed, same shape.
    """
    sides = still & near, still & ~near
    middles = [_medians(shade, side) for side in sides]
    spreads = [
        _medians(np.abs(shade - middle[:, None]), side) for side, middle in zip(sides, middles, strict=True)
    ]
    enough = np.minimum(*(np.count_nonzero(side, axis=1) for side in sides)) >= _LEAST_BESIDE
    with np.errstate(invalid="ignore"):  # surfaces without a pixel
        is_clear = enough & (np.abs(middles[0] - middles[1]) > _CLEAR * (spreads[0] + spreads[1]))
        return np.abs(amplitude - middles[0]) < np.abs(amplitude - middles[1]), is_clear


def _medians(values: FloatArray, used: NDArray[np.bool_]) -> FloatArray:
    """Return the median of the used values of each row, shape (N, P) to (N,); infinite without any."""
    ordered = np.sort(np.where(used, values, np.inf), axis=1)
    count, row = np.count_nonzero(used, axis=1), np.arange(len(ordered))
    middle: FloatArray = 0.5 * (ordered[row, np.maximum(count - 1, 0) // 2] + ordered[row, count // 2])
    return middle
