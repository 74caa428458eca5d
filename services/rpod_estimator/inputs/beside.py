"""An amplitude image that lies beside its depth: both show one target, in other pixels.

The outline of the pixels with depth is found again in the edges of the amplitude: the correlation of both is
greatest at the shift between the images (normalised cross-correlation, J. P. Lewis, Fast Template Matching,
Vision Interface 1995). Where the images belong together, this is at no shift, whatever the materials are.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import Float32Array, PmdFrame, SensorFrame

_MOST_PX = 12
"""Largest shift that is looked for, px: wrong regions of interest and offsets of a few pixels."""
_LEAST_PX = 2
"""Least shift that is told, px: the edges of both images are blurred by a pixel."""
_BLUR_PX = 1.0
_LOOK_S, _CALM_S = 1.0, 10.0
"""Time until the next image is compared, s, after one with a shift and after one without: one takes 7 to 20
ms, and how images are cut changes with the driver's mode only."""
_AGREEING = 4
"""Number of images with the same shift within a pixel, without one that differs between them. Of all shifts,
one of 70 is alike by chance."""
_SURE = 3.0
"""Standard deviations by which the images must be more alike at a shift than at none, by Fisher's z of their
correlation: a scene at rest shows the same shift by chance in each image."""


class ImagesBeside:
    """Compares depth and amplitude of single frames of one camera."""

    def __init__(self) -> None:
        self._looked_ns = -round(_CALM_S * NANOSECONDS)
        self._shifts: list[tuple[int, int]] = []

    def found(self, data: SensorFrame) -> str:
        """Take a frame; return how far its amplitude lies beside its depth, or "" where it does not."""
        if not isinstance(data, PmdFrame) or data.amplitude is None:
            return ""
        wait_s = _LOOK_S if self._shifts else _CALM_S
        if not 0 <= data.stamp_ns - self._looked_ns < wait_s * NANOSECONDS:
            self._looked_ns = data.stamp_ns
            self._take(shift_px(data.depth_m, data.amplitude))
        if len(self._shifts) < _AGREEING:
            return ""
        across, down = np.median(self._shifts, axis=0)
        return (
            f"its amplitude lies {across:+.0f} px (columns) and {down:+.0f} px (rows) beside its depth, in "
            f"{len(self._shifts)} compared images; let its driver cut and scale both images alike, and "
            "send both of one exposure"
        )

    def _take(self, shift: tuple[int, int] | None) -> None:
        if shift is None:
            return
        if max(map(abs, shift)) < _LEAST_PX:
            self._shifts = []
        elif self._shifts and np.abs(np.subtract(shift, self._shifts[-1])).max() > 1:
            self._shifts = [shift]
        else:
            self._shifts = [*self._shifts, shift][-2 * _AGREEING :]


def shift_px(depth_m: Float32Array, amplitude: NDArray[np.generic]) -> tuple[int, int] | None:
    """Return by how many columns and rows an amplitude image is shifted against its depth.

    None if the images do not tell it: one shows no edge, the depth fills it, or they are not surely more
    alike at the shift than at none.

    Args:
        depth_m: depth, shape (height, width); NaN or 0 where a pixel has none.
        amplitude: amplitude, same shape.
    """
    ranged = np.isfinite(depth_m) & (depth_m > 0.0)
    if not ranged.any():
        return None
    rows, columns = (np.flatnonzero(ranged.any(axis=axis)) for axis in (1, 0))
    edge = _MOST_PX + round(4.0 * _BLUR_PX)
    window = tuple(slice(max(int(at[0]) - edge, 0), int(at[-1]) + edge + 1) for at in (rows, columns))
    ranged, light = ranged[window], np.nan_to_num(amplitude[window].astype(np.float32))
    if min(ranged.shape) <= 2 * edge:
        return None
    typical = np.float32(np.median(light[ranged]))
    if not typical > 0.0:
        return None
    outline = _edges(cv2.medianBlur(ranged.astype(np.uint8), 3).astype(np.float32))
    looked_for = outline[_MOST_PX:-_MOST_PX, _MOST_PX:-_MOST_PX]
    lines = _edges(np.minimum(light / typical, np.float32(1.0)))
    if not looked_for.any() or not lines.any():
        return None
    alike = cv2.matchTemplate(lines, looked_for, cv2.TM_CCOEFF_NORMED)
    alike = np.nan_to_num(alike).clip(-0.999, 0.999)
    down, across = np.unravel_index(int(alike.argmax()), alike.shape)
    independent = np.count_nonzero(looked_for > 0.5 * looked_for.max()) / (4.0 * np.pi * _BLUR_PX**2)
    gain = np.arctanh(alike[down, across]) - np.arctanh(alike[_MOST_PX, _MOST_PX])
    shift = int(across) - _MOST_PX, int(down) - _MOST_PX
    is_sure = gain * np.sqrt(max(independent - 3.0, 0.0) / 2.0) > _SURE
    return shift if is_sure or max(map(abs, shift)) < _LEAST_PX else None


def _edges(image: Float32Array) -> Float32Array:
    """Return the size of an image's gradient, blurred."""
    smooth = cv2.GaussianBlur(image, (0, 0), _BLUR_PX)
    return np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
