"""Frames of which only a part is new: lines of an earlier frame that stand in a newer one, to the bit.

A transfer that was cut, or a buffer that is sent while it is written, leaves rows of an image, or columns
of a scan, of an earlier exposure. Such a frame shows the target in two places at once, and no pose of it is
right. Noise is never identical, so a line that repeats was not measured at the frame's stamp.

Coarse units and a sensor with little noise make values equal by chance. How often this happens is counted
in the lines that are new. A value after one that repeats counts alone there: without noise, equal values
stand in long runs.
"""

from collections import deque
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.types import SensorFrame

_FRAMES = 32
"""Earlier frames that are compared: drivers and frame grabbers have 2 to 16 buffers in a ring."""
_LEAST_EVIDENCE = float(-np.log(1e-12))
"""Negative logarithm of the probability with which the lines would be equal by chance. At 45 Hz it is one
false refusal in 700 years."""
_MOST_SHARE = 0.05
"""Largest share of a frame's values that may repeat in a frame that is used, such as those of a dead row. It
moves a pose by at most this share of the motion: by 1.5 mm of the default alert limit of 30 mm."""


@dataclass(frozen=True)
class _Lines:
    """Lines of one frame: digest of each (empty without a value), and the number of its values."""

    digests: tuple[bytes, ...]
    sizes: NDArray[np.int64]


class RepeatedLines:
    """Compares the frames of one sensor with its last ones, by rows and by columns."""

    def __init__(self) -> None:
        self._names = ("rows", "columns")
        self._earlier: tuple[deque[_Lines], ...] = (deque(maxlen=_FRAMES), deque(maxlen=_FRAMES))
        self._last = np.zeros((0, 0), np.float32)

    def found(self, data: SensorFrame) -> tuple[str, bool]:
        """Take a frame; return what of it is not new, or "", and whether the frame must not be used for it.

        Frames without rows and columns are not compared. A change of the size starts anew.
        """
        image = data.range_image_m
        if image is None or image.shape != self._last.shape:
            for each in self._earlier:
                each.clear()
        if image is None:
            return "", False
        texts = []
        for axis, (name, earlier) in enumerate(zip(self._names, self._earlier, strict=True)):
            turned = np.ascontiguousarray(image if axis == 0 else image.T)
            lines = _lines_of(turned)
            if earlier and (again := self._again(lines, turned, axis)) is not None:
                texts.append((*again, name))
            earlier.appendleft(lines)
        self._last = image
        if not texts:
            return "", False
        share, number, back, name = max(texts)
        of_what = "the frame before" if back == 1 else f"the frame {back} before it"
        text = (
            f"{number} of its {name} ({share:.0%} of its values) are those of {of_what}, to the bit: a "
            "transfer was cut, or a buffer was sent while it was written; look at the driver's buffers, and "
            "at the link to the device"
        )
        return text, share > _MOST_SHARE

    def _again(self, lines: _Lines, image: NDArray[np.float32], axis: int) -> tuple[float, int, int] | None:
        """Return the share of values that repeat, the number of lines, and how many frames before."""
        earlier = self._earlier[axis]
        chance = _chance(image, self._last if axis == 0 else self._last.T, _equal(lines, earlier[0]))
        tried = np.log(len(lines.sizes) * _FRAMES)  # lines, and frames with which each is compared
        best: tuple[float, int, int] | None = None
        for back, before in enumerate(earlier, 1):
            same = _equal(lines, before)
            evidence = np.maximum(-np.log(chance) * lines.sizes[same] - tried, 0.0)
            if evidence.sum() > _LEAST_EVIDENCE:
                share = float(lines.sizes[same].sum() / lines.sizes.sum())
                if best is None or share > best[0]:
                    best = share, int(same.sum()), back
        return best


def _lines_of(image: NDArray[np.float32]) -> _Lines:
    sizes = np.count_nonzero(image, axis=1)
    return _Lines(
        tuple(
            blake2b(line.data, digest_size=8).digest() if size else b""
            for line, size in zip(image, sizes, strict=True)
        ),
        sizes,
    )


def _equal(lines: _Lines, others: _Lines) -> NDArray[np.bool_]:
    """Return which lines have values and equal those of another frame, shape (lines,)."""
    pairs = zip(lines.digests, others.digests, strict=True)
    return np.array([bool(one) and one == other for one, other in pairs])


def _chance(image: NDArray[np.float32], last: NDArray[np.float32], repeated: NDArray[np.bool_]) -> float:
    """Return how often a value equals that of the frame before where its neighbour in the line does.

    It is counted in lines that do not repeat as a whole, with one pair of either kind added.
    """
    new, old = image[~repeated], last[~repeated]
    measured = (new > 0.0) & (old > 0.0)
    same = measured & (new == old)
    tried = int(np.count_nonzero(same[:, :-1] & measured[:, 1:]))
    return (np.count_nonzero(same[:, :-1] & same[:, 1:]) + 1) / (tried + 2)
