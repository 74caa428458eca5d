"""Fits of a target's brightness to an image, since materials are known only roughly.

``misfit`` compares poses whose edges fit equally well. It fits the brightness of each plane face, and so
compares the places of outlines and of changes within the target, which no brightness can explain.
``fitted`` returns a rendering that predicts the places of edges. If edges are nearer to each other than the
blur, the place of each depends on the brightness beside it. Therefore the brightness of each surface is
fitted. A surface is a smooth part of the body, of one material. Its faces keep their shading by Lambert's
law: with more freedom, errors of the pose would be taken for brightness.

Both fits are non-negative: multiplicative steps of maximum likelihood (MLEM; L. A. Shepp, Y. Vardi, IEEE
Transactions on Medical Imaging 1(2), 1982) with the image's blur as the system.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_pose.pmd.joint.brightness.amplitude_noise import sky_of
from rpod_pose.pmd.joint.brightness.local_brightness import local_light
from rpod_pose.pmd.joint.brightness.mixture import Mixture
from rpod_pose.pmd.joint.edge_search import Patch
from rpod_pose.pmd.rendering import Window
from rpod_schemas.types import Float32Array

ROUNDS = 3
"""Number of multiplicative steps. Numerics: a budget; the first one fits a face except for its edges."""
UNEVEN = 0.15
"""Relative standard deviation of the brightness within a face. Hand: half of what surfaces that are not
Lambertian add to the spread of an albedo (``brightness``)."""
MOST_SIGMAS = 3.0
"""Limit at which the residual of a pixel or point is clipped, in sigmas. Physics: one in 370 normal errors is
larger; another body or a shadow is an outlier."""
MOST_RATIO = 2.0
"""Largest ratio of image over rendering that counts. Numerics: a glint does not decide about its surface; a
surface of another brightness is found within the steps, each of which may double it."""
MIXED = 0.01
"""Weight of a pixel that shows several parts, over that of a pixel of one. Numerics: it matters only for a
part that has no pixel of its own."""
HELD = 0.01
"""Weight of the brightness that the target's file gives, over that of a pixel of one part. Numerics: that of
one pixel that shows several parts."""
TYPICAL_SAMPLES = 20_000
"""Number of pixels from which the rendering's median brightness is estimated. Numerics: a budget of
computation; all pixels of a target of 140 by 140."""


class ByFile(NamedTuple):
    """A rendering with the materials of the target's file."""

    shade: Float32Array
    """Smoothed brightness, clipped like the image, on the pixels of the window."""
    typical: float
    """Median brightness before smoothing; 0 if nothing is in view."""


def rendered_by_file(mixture: Mixture, *, clip: float, blur_px: float) -> ByFile:
    """Return the rendering with the materials of the target's file.

    Args:
        mixture: the parts that the pixels show at a pose.
        clip: largest brightness, over the typical one.
        blur_px: standard deviation of the blur.
    """
    shade, typical = clipped(mixture, clip)
    return ByFile(_blurred(shade, blur_px), typical)


def misfit(patch: Patch, mixture: Mixture, *, clip: float, blur_px: float) -> float:
    """Return minus the log likelihood of an image at a pose, with the brightness of parts and sky fitted.

    All pixels have the same weight. Pixels within one blur share their errors, so the sum is divided by the
    area 4 pi blur^2 of the blur's autocorrelation. Arguments as for ``fitted``.
    """
    shown = predicted(patch, mixture, clip=clip, blur_px=blur_px)
    return 0.5 * squares_of(patch, shown, mixture.window) / (4.0 * np.pi * blur_px**2)


def predicted(patch: Patch, mixture: Mixture, *, clip: float, blur_px: float) -> "Behind":
    """Return the image at a pose, with the brightness of parts and sky fitted; arguments as for ``fitted``.

    A wall may be behind the target: if the sky were assumed to be dark, a pose that hides more of the wall
    would be likelier. All pixels have the same weight, and the brightness of the file has none.
    """
    free = _blurred(mixture.free.copy(), blur_px)
    sky = sky_of(patch, free, mixture.window)
    shown = np.float32(sky) * free
    if mixture.pixel.size:
        image = np.maximum(_within(mixture.window, patch.image) - shown, np.float32(0.0))
        _, typical = clipped(mixture, clip)
        first, most = patch.typical / typical, clip * patch.typical
        rendering = _Rendering(mixture, np.float32(faintest(patch)), blur_px, np.float32(most))
        gain = _gains(image, rendering, np.ones_like(image), first=first, held=0.0, most_ratio=np.inf)
        shown = shown + rendering.with_gains(gain)
    return Behind(shown, sky)


def fitted(
    patch: Patch, mixture: Mixture, typical: float, *, clip: float, blur_px: float
) -> tuple[Float32Array, Float32Array]:
    """Return a smoothed rendering, in units of an image, with the brightness of each part fitted to it.

    The factor on the brightness of each part follows, shape (K,). Pixels that show a single part decide. A
    part with few pixels, or without such a pixel, keeps the brightness of the file. Image and rendering are
    compared before they are clipped: where the clip shows an edge depends on how bright its sides are.

    Args:
        patch: the image, smoothed.
        mixture: the parts that the pixels show at a pose.
        typical: median brightness with the materials of the file.
        clip: largest brightness of image and rendering, over the typical one.
        blur_px: standard deviation of the blur of image and rendering.
    """
    image, weight = _within(mixture.window, patch.unclipped), weights(mixture.alone)
    rendering, first = _Rendering(mixture, np.float32(faintest(patch)), blur_px), patch.typical / typical
    gain = _gains(image, rendering, weight, first=first, held=HELD, most_ratio=MOST_RATIO)
    return rendering._replace(most=np.float32(clip * patch.typical)).with_gains(gain), gain


def followed(
    patch: Patch, mixture: Mixture, gain: Float32Array, *, clip: float, blur_px: float
) -> Float32Array:
    """Return a rendering as of ``fitted``, whose brightness also follows the image within each part.

    Args:
        patch: the image, smoothed.
        mixture: the parts that the pixels show at a pose.
        gain: fitted factor on the brightness of each part, shape (K,).
        clip: as for ``fitted``.
        blur_px: as for ``fitted``.
    """
    image, faint = _within(mixture.window, patch.unclipped), np.float32(faintest(patch))
    rendering = _Rendering(mixture, faint, blur_px)
    ratio = ratio_of(image, rendering.with_gains(gain), faint, np.float32(MOST_RATIO))
    mixture = mixture._replace(light=local_light(mixture, weights(mixture.alone), ratio))
    return _Rendering(mixture, faint, blur_px, np.float32(clip * patch.typical)).with_gains(gain)


class _Rendering(NamedTuple):
    """How the parts of a mixture are rendered."""

    mixture: Mixture
    faint: np.float32
    """Brightness below which differences are no change of the image."""
    blur_px: float
    """Standard deviation of the blur."""
    most: np.float32 = np.float32(np.inf)
    """Largest brightness before the blur."""

    def with_gains(self, gain: Float32Array) -> Float32Array:
        """Return the smoothed rendering with a factor on the brightness of each part, shape (K,)."""
        return _blurred(mixed(gain, self.mixture, self.most), self.blur_px)


def _gains(
    image: Float32Array,
    rendering: _Rendering,
    weight: Float32Array,
    *,
    first: float,
    held: float,
    most_ratio: float,
) -> Float32Array:
    """Return the fitted factor on the brightness of each part, shape (K,).

    Args:
        image: the image, smoothed, shape (rows, columns).
        rendering: how the parts are rendered.
        weight: weight of each pixel, same shape.
        first: the factor by the brightness of the file.
        held: its weight in pixels of one part; without it, each pixel acts on all parts within its blur.
        most_ratio: largest ratio of image over rendering that counts.
    """
    gain = np.full(int(rendering.mixture.part.max()) + 1, first, np.float32)
    for _ in range(ROUNDS):
        ratio = ratio_of(image, rendering.with_gains(gain), rendering.faint, np.float32(most_ratio))
        if not held:
            _blurred(ratio, rendering.blur_px)
        adapt(gain, (first, held), rendering.mixture, weight, ratio)
    return gain


def _within(window: Window, image: Float32Array) -> Float32Array:
    """Return the pixels of a window, shape (window.rows, window.columns)."""
    row, column, rows, columns = window
    return np.ascontiguousarray(image[row : row + rows, column : column + columns])


def _blurred(image: Float32Array, blur_px: float) -> Float32Array:
    """Return an image, smoothed in place."""
    cv2.GaussianBlur(image, (0, 0), blur_px, dst=image)
    return image


@kernel
def faintest(patch: Patch) -> float:
    """Return the brightness below which differences are no change of the image."""
    return 0.5 * patch.least


class Behind(NamedTuple):
    """A rendering in front of a sky of constant brightness."""

    image: Float32Array
    """Brightness on the pixels of the window, shape (rows, columns)."""
    sky: float
    """Brightness of all other pixels."""


@kernel
def squares_of(patch: Patch, rendered: Behind, window: Window) -> float:
    """Return the sum of an image's squared residuals, in sigmas, each clipped at ``MOST_SIGMAS``.

    Args:
        patch: the image.
        rendered: the rendering.
        window: the pixels around the target.
    """
    image, check = patch.image, patch.saturated.size > 0
    floor, total = faintest(patch) ** 2 + patch.noise**2, 0.0
    bottom, right = window.row + window.rows, window.column + window.columns
    for i in range(image.shape[0]):
        beside = i < window.row or i >= bottom
        for j in range(image.shape[1]):
            if check and patch.saturated[i, j] > 0:
                continue
            shown = rendered.sky
            if not (beside or j < window.column or j >= right):
                shown = float(rendered.image[i - window.row, j - window.column])
            residual = image[i, j] - shown
            total += min(residual * residual / (UNEVEN * UNEVEN * shown * shown + floor), MOST_SIGMAS**2)
    return total


@kernel
def clipped(mixture: Mixture, clip: float) -> tuple[Float32Array, float]:
    """Return the brightness of the pixels with the materials of the file, (rows, columns), and its median.

    Args:
        mixture: the parts that the pixels show.
        clip: largest brightness over the median.
    """
    image = np.zeros(mixture.alone.size, np.float32)
    for n in range(mixture.pixel.size):
        image[mixture.pixel[n]] += mixture.light[n]
    step = image.size // TYPICAL_SAMPLES + 1
    few, count = np.empty(image.size // step + 1, np.float32), 0
    for n in range(0, image.size, step):
        few[count] = image[n]
        count += image[n] > 0.0
    typical = float(np.median(few[:count])) if count else 0.0
    most = np.float32(clip * typical)
    for n in range(image.size):
        image[n] = min(image[n], most)
    return image.reshape(mixture.alone.shape), typical


@kernel
def weights(alone: NDArray[np.int32]) -> Float32Array:
    """Return the weight of each pixel in the fit: 1 if it and its neighbours show one part, else ``MIXED``.

    Args:
        alone: the only part that each pixel shows, -1 for none, shape (rows, columns), like the result.
    """
    rows, columns = alone.shape
    weight = np.full((rows, columns), MIXED, np.float32)
    for i in range(1, rows - 1):
        for j in range(1, columns - 1):
            same = alone[i, j] >= 0
            for v in range(i - 1, i + 2):
                for u in range(j - 1, j + 2):
                    same &= alone[v, u] == alone[i, j]
            if same:
                weight[i, j] = 1.0
    return weight


@kernel
def mixed(gain: Float32Array, mixture: Mixture, most: np.float32) -> Float32Array:
    """Return the brightness of the pixels of the window, shape (rows, columns).

    Args:
        gain: factor on the brightness of each part, shape (K,).
        mixture: the parts that the pixels show.
        most: largest brightness; inf for none.
    """
    image = np.zeros(mixture.alone.size, np.float32)
    for n in range(mixture.pixel.size):
        image[mixture.pixel[n]] += gain[mixture.part[n]] * mixture.light[n]
    for n in range(image.size):
        image[n] = min(image[n], most)
    return image.reshape(mixture.alone.shape)


@kernel
def ratio_of(
    image: Float32Array, rendered: Float32Array, faint: np.float32, most: np.float32
) -> Float32Array:
    """Return image over rendering, with ``faint`` added to both.

    Args:
        image: shape (rows, columns), like the result.
        rendered: same shape.
        faint: brightness that is added to both.
        most: largest ratio.
    """
    ratio = np.empty(image.shape, np.float32)
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            ratio[i, j] = min((image[i, j] + faint) / (rendered[i, j] + faint), most)
    return ratio


@kernel
def adapt(
    gain: Float32Array,
    prior: tuple[float, float],
    mixture: Mixture,
    weight: Float32Array,
    ratio: Float32Array,
) -> None:
    """Multiply the factor of each part by the mean ratio of image over rendering in its pixels.

    Args:
        gain: factor on the brightness of each part, shape (K,), input and output.
        prior: factor that the file gives, the same for all parts, and its weight in pixels of one part.
        mixture: the parts that the pixels show.
        weight: weight of each pixel, shape (rows, columns).
        ratio: image over rendering, shape (rows, columns).
    """
    sums, whole = np.zeros(gain.size), np.zeros(gain.size)
    lights, counts = np.zeros(gain.size), np.zeros(gain.size)
    ratios, shares, (first, held), n = ratio.ravel(), weight.ravel(), prior, 0
    while n < mixture.pixel.size:  # neighbours mostly show one part, whose sums stay in registers
        k, begin = mixture.part[n], n
        by, total, weighted, plain = gain[k], sums[k], whole[k], lights[k]
        while n < mixture.pixel.size and mixture.part[n] == k:
            pixel = mixture.pixel[n]
            light = by * mixture.light[n]
            total += light * shares[pixel] * ratios[pixel]
            weighted += light * shares[pixel]
            plain += light
            n += 1
        sums[k], whole[k], lights[k] = total, weighted, plain
        counts[k] += n - begin
    for k in range(gain.size):
        if whole[k] > 0.0:
            known = held * lights[k] / counts[k]
            gain[k] *= (sums[k] + known * first / gain[k]) / (whole[k] + known)
