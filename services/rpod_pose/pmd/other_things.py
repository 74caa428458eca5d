"""Separation of a PMD frame: its ranges, and the frame without the pixels of other things than the target."""

from typing import NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_geometry.errors import DistortionError
from rpod_geometry.rays import NEAREST_M
from rpod_geometry.windows import window_around
from rpod_pose.pmd.amplitude_unit import least_count
from rpod_pose.pmd.depth_view import FARTHEST_M, DepthView, offset_of
from rpod_pose.surroundings.separation import Every, Label, RangeImage, Spans, upsampled
from rpod_schemas.arrays import Array
from rpod_schemas.types import LENS_COEFFICIENTS, Float32Array, PmdFrame

COARSE_RAYS, FINE_RAYS = 8_000, 250_000
"""Largest number of rays of an image for the search of places, and for the comparison with a rendering.
Numerics: budgets of computation."""
LEAST_SKY = 0.05
"""Least share of dark pixels in an image from which the amplitude of the sky is estimated. Hand: a room has
no sky, but a few dark pixels."""
DARK = 0.1
"""Largest amplitude of a pixel that shows only sky, over the median amplitude on the target. Hand: it is
below that of a target's materials."""


_SIGMA_OF_BEND = 1.21
"""Standard deviation of a normal error over the median absolute difference of one value and the mean of two
others. Physics: 1.483 / sqrt(1.5)."""
_BESIDE = np.array(((0, 1, 0), (1, 0, 1), (0, 1, 0)), np.float32)
"""The four pixels that share a side with a pixel."""
_MOST = 4
"""Half of the neighbours of a pixel. Physics: of the eight neighbours of a pixel at the straight outline of a
dark target, at most three are beside the target."""
_AROUND, _NEAR_PX = np.ones((3, 3), np.uint8), (5, 5)
"""A pixel with its neighbours, and the size, px, of the window in which pixels of other things alone are
searched. Hand: two pixels to each side are beyond the blur."""
_REACH = Spans(4, 4)
"""Margin, px, of the window around the target in which its outline's light is computed. Numerics: the means
need three pixels beside the target, and one more lets no border change a filter."""


class PartOfFrame(PmdFrame):
    """A frame that is reduced to one place, together with the whole frame, in which a pose is verified."""

    whole: PmdFrame
    """The frame as measured."""


class PmdFrames:
    """Separates PMD frames: surroundings.frames.Frames.

    Args:
        range_bias_m: standard deviation of the error that all ranges of a frame share.
    """

    def __init__(self, range_bias_m: float = 0.0) -> None:
        self.range_bias_m = range_bias_m
        self._unmeasured: tuple[PmdFrame, _Unmeasured] | None = None

    def image(self, frame: PmdFrame, *, fine: bool) -> RangeImage | None:
        """Return the ranges on a coarse or fine grid of pixels; None if the lens cannot be inverted."""
        stride = _stride(frame, FINE_RAYS if fine else COARSE_RAYS)
        if frame.camera.distortion[LENS_COEFFICIENTS:].any():
            return None
        try:
            view = DepthView.of(frame.camera, stride)
        except DistortionError:
            return None
        grid = view.rays(1) if stride == 1 else view.coarse
        every = (slice(view.offset, None, stride),) * 2
        depth_m = frame.depth_m[every]
        depth_m = np.where((depth_m > NEAREST_M) & (depth_m < FARTHEST_M), depth_m, np.float32(0.0))
        hidden = None if frame.hidden is None else frame.hidden[every]
        range_m = (depth_m / grid.components[2]).astype(np.float32)
        noise_m = _noise_m(range_m, frame.amplitude[every]) if fine and frame.amplitude is not None else None
        return RangeImage(grid, range_m, hidden, noise_m, Every(stride, view.offset))

    def separated(self, frame: PmdFrame, labels: NDArray[np.uint8], inside: NDArray[np.bool_]) -> PmdFrame:
        """Return a frame that is dark beside the target, and marked as hidden where something hides it.

        Without an amplitude no pixel can be dark. Then things behind the target stay where they are visible
        within its outline.
        """
        measured, shape, every = frame.depth_m > 0.0, frame.depth_m.shape, _every_fine(frame)
        label = _of_unmeasured(upsampled(labels, every, shape), measured, self._regions(frame, measured))
        hiding, beyond = label == Label.HIDING, label == Label.BEYOND
        if frame.amplitude is None:
            beyond &= ~upsampled(inside, every, shape)
        hidden = hiding if frame.hidden is None else hiding | frame.hidden
        images = {"depth_m": np.where(hiding | beyond, np.float32(np.nan), frame.depth_m), "hidden": hidden}
        if frame.amplitude is not None:
            kept = label == Label.KEPT
            amplitude = np.where(hiding, frame.amplitude.dtype.type(0), frame.amplitude)
            images["amplitude"] = _without_others(frame, amplitude, kept, beyond)
        for image in images.values():
            image.setflags(write=False)  # as from the bus
        return frame.model_copy(update=images)

    def _regions(self, frame: PmdFrame, measured: NDArray[np.bool_]) -> "_Unmeasured":
        """Return the regions without ranges of a frame; those of the last frame are kept."""
        last = self._unmeasured
        if last is None or last[0] is not frame:
            last = self._unmeasured = frame, _Unmeasured.of(measured)
        return last[1]

    def behind_bodies(self, frame: PmdFrame, hides: NDArray[np.bool_]) -> PmdFrame:
        """Return a frame without the pixels on known bodies.

        Args:
            frame: the frame.
            hides: whether a known body is on a ray of the frame's fine image, shape (rows, columns).
        """
        labels = np.where(hides, Label.HIDING, Label.KEPT).astype(np.uint8)
        hidden = upsampled(hides, _every_fine(frame), frame.depth_m.shape)
        separated = self.separated(frame, labels, np.zeros(hides.shape, np.bool_))
        if frame.hidden is not None:
            hidden = hidden | frame.hidden
        return separated.model_copy(update={"hidden": hidden})

    def nearer(self, frame: PmdFrame, ratio: float) -> PmdFrame:
        """Return a frame whose depths are divided by a ratio."""
        depth_m = np.asarray(frame.depth_m / np.float32(ratio), np.float32)
        depth_m.setflags(write=False)  # as from the bus
        return frame.model_copy(update={"depth_m": depth_m})

    def part_of(self, part: PmdFrame, whole: PmdFrame) -> PmdFrame:
        """Return a part of a frame together with the whole frame."""
        return PartOfFrame.model_construct(**dict(part), whole=whole)

    def whole_of(self, frame: PmdFrame) -> PmdFrame | None:
        """Return the whole frame of a part; None for a frame that is not a part."""
        return frame.whole if isinstance(frame, PartOfFrame) else None

    def every_range_m(self, frame: PmdFrame) -> Float32Array:
        """Return each pixel's z-depth, to which gate and background refer, (height, width), 0 for none."""
        return frame.range_image_m


def _stride(frame: PmdFrame, rays: int) -> int:
    """Return the stride of pixels, px, at which an image has at most about ``rays`` of them."""
    return int(np.ceil(np.sqrt(frame.depth_m.size / rays)))


def _every_fine(frame: PmdFrame) -> Every:
    """Return stride and offset of the pixels in the fine image of a frame."""
    stride = _stride(frame, FINE_RAYS)
    return Every(stride, offset_of(frame.camera, stride))


def _noise_m(range_m: Float32Array, amplitude: Array) -> Float32Array | None:
    """Return the standard deviation of each range's noise, m, (height, width); None without neighbours.

    It is proportional to one over the amplitude. The second differences of neighbouring ranges give the
    factor, since a plane has none.

    Args:
        range_m: ranges, 0 without one, shape (height, width).
        amplitude: amplitudes, same shape.
    """
    left, middle, right = range_m[:, :-2], range_m[:, 1:-1], range_m[:, 2:]
    known = (left > 0.0) & (middle > 0.0) & (right > 0.0)
    if not known.any():
        return None
    bend_m = np.abs(middle - 0.5 * (left + right))[known]
    factor = float(np.median(bend_m * amplitude[:, 1:-1][known])) * _SIGMA_OF_BEND
    least = least_count(amplitude, float(np.median(amplitude[:, 1:-1][known])))
    return np.asarray(factor / np.maximum(amplitude, least), np.float32)


class _Unmeasured(NamedTuple):
    """Connected regions of the pixels of a frame that have no range."""

    number: NDArray[np.int32]
    """Number of each pixel's region, shape (height, width), 0 if it has a range."""
    sizes: NDArray[np.intp]
    """Number of pixels of each region, by its number, shape (regions,)."""

    @classmethod
    def of(cls, measured: NDArray[np.bool_]) -> Self:
        """Return the regions of a frame, whose pixels with a range are given, shape (height, width)."""
        count, numbers = cv2.connectedComponents((~measured).view(np.uint8), connectivity=4)
        number = np.asarray(numbers, np.int32)
        return cls(number, np.bincount(number.ravel(), minlength=count))


def _of_unmeasured(
    label: NDArray[np.uint8], measured: NDArray[np.bool_], regions: _Unmeasured
) -> NDArray[np.uint8]:
    """Return labels in which a pixel without a range has the label of the thing to which it belongs.

    A surface may lack the range of single pixels, and a dark or remote part of a room that of all its pixels.
    Without labels, their light would seem to be a part of the target without a range.

    Args:
        label: ``Label`` of each pixel, shape (height, width).
        measured: pixels with a range, same shape.
        regions: regions of the other pixels.
    """
    filled = label.copy()
    window = window_around(label != Label.BEYOND, _REACH)
    label, measured, number = label[window], measured[window], regions.number[window]
    unknown = ~measured & (label == Label.KEPT)
    part = filled[window]
    for other in (Label.HIDING, Label.BEYOND):
        around = cv2.boxFilter((measured & (label == other)).view(np.uint8), -1, (3, 3), normalize=False)
        part[unknown & (around > _MOST)] = other
    others = np.bincount(number[~measured & (label != Label.BEYOND)], minlength=len(regions.sizes))
    beyond, beside = others < regions.sizes, np.zeros(len(regions.sizes), bool)
    kept = (measured & (label == Label.KEPT)).view(np.uint8)
    beside[number[cv2.dilate(kept, _AROUND) > 0]] = True
    part[unknown & (beyond & ~beside)[number]] = Label.BEYOND
    return filled


def _without_others(
    frame: PmdFrame, amplitude: Array, kept: NDArray[np.bool_], beyond: NDArray[np.bool_]
) -> Array:
    """Return the amplitudes without the light of other things beyond the target, shape (height, width).

    Args:
        frame: the frame.
        amplitude: its amplitudes, 0 where something hides the target, shape (height, width).
        kept: pixels on the target, same shape.
        beyond: pixels on other things, same shape.
    """
    measured = frame.depth_m > 0.0
    sky, window = _sky(frame, kept & measured), window_around(kept, _REACH)
    alone: Array = np.where(beyond, amplitude.dtype.type(sky), amplitude)
    kept, measured, others = kept[window], measured[window], beyond[window]
    sides = _Sides(kept, measured, others & measured)
    unmixed = _unmixed(frame.depth_m[window], amplitude[window], sides, sky)
    alone[window] = np.where(others | sides.unclear, unmixed, amplitude[window])
    return alone


def _unmixed(depth_m: Float32Array, amplitude: Array, sides: "_Sides", sky: float) -> Array:
    """Return the amplitudes of the outline's pixels without the light of the background, (height, width).

    A pixel at the outline shows the target and the background. Its range lies between both ranges, nearer to
    the one from which it gets more light. Together with the amplitudes on both sides, this gives the share of
    the pixel that the target covers. A pixel with the range of the background is not covered at all; a camera
    that does not mix ranges has only such pixels. If the target or the pixel has no range, the amplitude is
    used in the same way. If a side is unknown, the share is a half, which is right on average. The target's
    light is at most that of the whole pixel.
    """
    near_m, lit = sides.range_of_target(depth_m), sides.light_of_target(amplitude)
    far_m, behind = sides.mean_of_others(depth_m), sides.mean_of_others(amplitude)
    inner = sides.mean_of_inner(amplitude)
    with np.errstate(invalid="ignore", divide="ignore"):
        light = np.clip((far_m - depth_m) / (far_m - near_m), 0.0, 1.0)
        by_range = light * behind / (light * behind + (1.0 - light) * lit)
        by_light = np.clip((behind - amplitude) / (behind - inner), 0.0, 1.0)
    ranged = np.isfinite(by_range)
    lit = np.where(ranged | ~np.isfinite(inner), lit, inner)
    covered = np.where(ranged, by_range, by_light)
    covered = np.where(np.isfinite(covered), covered, np.float32(0.5))
    mixed = np.where(sides.touches, covered * lit + (1.0 - covered) * sky, sky)
    return np.asarray(np.minimum(mixed, np.maximum(amplitude, sky))).astype(amplitude.dtype)


class _Sides:
    """Means over the pixels on both sides of the target's outline, each of shape (height, width).

    Args:
        kept: pixels on the target, shape (height, width).
        measured: pixels with a range, same shape.
        others: pixels with a range on other things beyond it, same shape.
    """

    def __init__(
        self, kept: NDArray[np.bool_], measured: NDArray[np.bool_], others: NDArray[np.bool_]
    ) -> None:
        self._kept, self._ranged = kept.astype(np.float32), (kept & measured).astype(np.float32)
        self.touches: NDArray[np.bool_] = cv2.filter2D(self._kept, -1, _BESIDE) > 0.5
        """Whether a pixel shares a side with one of the target."""
        beside = cv2.dilate(others.astype(np.uint8), _AROUND) > 0
        self.unclear: NDArray[np.bool_] = kept & ~measured & beside
        """Whether a pixel without a range may show the target and is beside another thing."""
        self._inner = (kept & ~beside).astype(np.float32)
        self._others = (others & ~(cv2.dilate(kept.astype(np.uint8), _AROUND) > 0)).astype(np.float32)

    def light_of_target(self, amplitude: Array) -> Float32Array:
        """Return the mean amplitude of the target's pixels that share a side with each one; NaN for none."""
        return _mean(amplitude, self._kept)

    def range_of_target(self, depth_m: Float32Array) -> Float32Array:
        """Return the mean depth of the target's pixels that share a side with each one; NaN for none."""
        return _mean(depth_m, self._ranged)

    def mean_of_inner(self, image: Array) -> Float32Array:
        """Return the mean of the pixels around each pixel that show only the target; NaN for none."""
        return _mean_around(image, self._inner)

    def mean_of_others(self, image: Array) -> Float32Array:
        """Return the mean of the pixels around each pixel that show only other things; NaN for none."""
        return _mean_around(image, self._others)


def _mean_around(image: Array, pixels: Float32Array) -> Float32Array:
    """Return the mean of the chosen pixels around each pixel, shape (height, width); NaN for none.

    Args:
        image: values, shape (height, width).
        pixels: 1 at the chosen pixels, 0 elsewhere, same shape.
    """
    sums, count = (
        cv2.boxFilter(part, -1, _NEAR_PX, normalize=False)
        for part in (np.where(pixels > 0, image, 0).astype(np.float32), pixels)
    )
    return np.where(count > 0.5, sums / np.maximum(count, 1.0), np.float32(np.nan))


def _mean(image: Array, pixels: Float32Array) -> Float32Array:
    """Return the mean of the chosen pixels that share a side with each pixel, (height, width); NaN for none.

    Args:
        image: values, shape (height, width).
        pixels: 1 at the chosen pixels, 0 elsewhere, same shape.
    """
    sums, count = (
        cv2.filter2D(part, -1, _BESIDE)
        for part in (np.where(pixels > 0, image, 0).astype(np.float32), pixels)
    )
    return np.where(count > 0.5, sums / np.maximum(count, 1.0), np.float32(np.nan))


def _sky(frame: PmdFrame, kept: NDArray[np.bool_]) -> float:
    """Return the amplitude of a pixel that shows only sky: the median of the dark pixels without depth."""
    assert frame.amplitude is not None  # noqa: S101 - the caller's condition
    typical = float(np.median(frame.amplitude[kept])) if kept.any() else 0.0
    most, least = DARK * typical if kept.any() else 1.0, least_count(frame.amplitude, typical)
    dark = frame.amplitude[~(frame.depth_m > 0.0) & (frame.amplitude < most) & (frame.amplitude > 0)]
    sky = float(np.median(dark)) if dark.size > LEAST_SKY * frame.depth_m.size else least
    return max(least, sky if frame.amplitude.dtype.kind == "f" else float(round(sky)))
