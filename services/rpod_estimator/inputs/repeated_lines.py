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
    """Lines of one frame: digest of each, 0 for one without a value, and the number of its values."""

    digests: NDArray[np.uint64]
    sizes: NDArray[np.int64]


class RepeatedLines:
    """Compares the frames of one sensor with its last ones: images by rows, scans by columns too."""

    def __init__(self) -> None:
        self._earlier: dict[str, deque[_Lines]] = {
            "rows": deque(maxlen=_FRAMES),
            "columns": deque(maxlen=_FRAMES),
        }
        self._last = np.zeros((0, 0), np.float32)

    def found(self, data: SensorFrame) -> tuple[str, bool]:
        """Take a frame; return what of it is not new, or "", and whether the frame must not be used for it.

        Frames without rows and columns are not compared. A change of the size starts anew.
        """
        image = data.range_image_m
        if image is None or image.shape != self._last.shape:
            for each in self._earlier.values():
                each.clear()
        if image is None:
            return "", False
        found = [self._taken("rows", image, self._last)]
        if data.lens is None:  # an imager is read out by rows
            found.append(self._taken("columns", image.T, self._last.T))
        self._last = image
        share, number, back, name = max(found)
        if not number:
            return "", False
        of_what = "the frame before" if back == 1 else f"the frame {back} before it"
        text = (
            f"{number} of its {name} ({share:.0%} of its values) are those of {of_what}, to the bit: a "
            "transfer was cut, or a buffer was sent while it was written; look at the driver's buffers, and "
            "at the link to the device"
        )
        return text, share > _MOST_SHARE

    def _taken(
        self, name: str, image: NDArray[np.float32], last: NDArray[np.float32]
    ) -> tuple[float, int, int, str]:
        """Return the share of values that repeat, the number of lines, how many frames before, and the name.

        The lines are the rows of the images, shape (lines, values), and are kept for later frames.
        """
        lines, earlier = _lines_of(np.ascontiguousarray(image)), self._earlier[name]
        before = list(earlier)
        earlier.appendleft(lines)
        if not before or not lines.sizes.any():
            return 0.0, 0, 0, name
        same = (np.stack([each.digests for each in before]) == lines.digests) & (lines.sizes > 0)
        if not same.any() or same[0][lines.sizes > 0].all():  # all of the frame before: no part is new
            return 0.0, 0, 0, name
        tried = np.log(len(lines.sizes) * _FRAMES)  # lines, and frames with which each is compared
        surprise = -np.log(_chance(image, last, same[0]))
        evidence = same @ np.maximum(surprise * lines.sizes - tried, 0.0)
        values = np.where(evidence > _LEAST_EVIDENCE, same @ lines.sizes, 0)
        back = int(np.argmax(values))
        number = int(same[back].sum()) if values[back] else 0
        return float(values[back] / lines.sizes.sum()), number, back + 1, name


def _lines_of(image: NDArray[np.float32]) -> _Lines:
    sizes = np.count_nonzero(image, axis=1)
    digests = b"".join(
        blake2b(line, digest_size=8).digest() if size else bytes(8)
        for line, size in zip(image, sizes.tolist(), strict=True)
    )
    return _Lines(np.frombuffer(digests, np.uint64), sizes)


def _chance(image: NDArray[np.float32], last: NDArray[np.float32], repeated: NDArray[np.bool_]) -> float:
    """Return how often a value equals that of the frame before where its neighbour in the line does.

    It is counted in lines that do not repeat as a whole, with one pair of either kind added.
    """
    new, old = image[~repeated], last[~repeated]
    measured = (new > 0.0) & (old > 0.0)
    same = measured & (new == old)
    tried = int(np.count_nonzero(same[:, :-1] & measured[:, 1:]))
    return (np.count_nonzero(same[:, :-1] & same[:, 1:]) + 1) / (tried + 2)
