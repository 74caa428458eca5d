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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.arrays import FloatArray
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import PmdFrame

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
    ranges_m = np.stack([before.depth_m, after.depth_m]).astype(np.float64)
    ranges_m[~(np.isfinite(ranges_m) & (ranges_m > 0.0))] = np.inf
    changed, step_m = _changed(ranges_m)
    rows, columns = np.nonzero(changed)
    some = np.random.default_rng(0).permutation(rows.size)[:_MOST_PIXELS]
    behind = now = 0
    for row, column in zip(rows[some].tolist(), columns[some].tolist(), strict=True):
        own_m = ranges_m[:, row, column]
        between_m = own_m.mean() if np.isfinite(own_m).all() else own_m.min() + step_m[row, column]
        around = np.s_[
            max(row - _AROUND, 0) : row + _AROUND + 1, max(column - _AROUND, 0) : column + _AROUND + 1
        ]
        shade = np.asarray(after.amplitude[around], np.float64)
        is_near = _shows_near(
            float(after.amplitude[row, column]), shade, ranges_m[1][around] <= between_m, ~changed[around]
        )
        if is_near is not None:
            was_near = bool(own_m[0] <= between_m)
            behind, now = behind + (is_near == was_near), now + (is_near != was_near)
    return Votes(behind, now)


def _changed(ranges_m: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which pixels an outline has passed, and the least change of their range that counts, m.

    Args:
        ranges_m: ranges of two frames, infinite without one, shape (2, height, width).
    """
    measured = np.isfinite(ranges_m)
    both = measured.all(axis=0)
    moved_m = np.where(both, np.abs(np.diff(np.where(both, ranges_m, 0.0), axis=0)[0]), 0.0)
    usual_m = float(np.median(moved_m[both])) if both.any() else 0.0
    nearest_m = ranges_m.min(axis=0)
    step_m = np.maximum(_STEP * np.where(np.isfinite(nearest_m), nearest_m, 0.0), _NOISES * usual_m)
    return (measured[0] != measured[1]) | (moved_m > step_m), step_m


def _shows_near(
    amplitude: float, shade: FloatArray, near: NDArray[np.bool_], still: NDArray[np.bool_]
) -> bool | None:
    """Return whether an amplitude is that of the nearer surface beside it; None if it is not clear."""
    sides = [shade[still & side] for side in (near, ~near)]
    if min(side.size for side in sides) < _LEAST_BESIDE:
        return None
    middles = [float(np.median(side)) for side in sides]
    spread = sum(float(np.median(np.abs(side - middle))) for side, middle in zip(sides, middles, strict=True))
    if abs(middles[0] - middles[1]) <= _CLEAR * spread:
        return None
    return abs(amplitude - middles[0]) < abs(amplitude - middles[1])
