"""Fits of a target's brightness to an image, since materials are known only roughly.

Two poses whose edges fit equally well are told apart by what no brightness explains: places of outlines and
of changes inside (``misfit``). There the brightness of each plane face is free.

Where edges are nearer to each other than the blur, the place of each depends on the brightness of what is
beside it. A rendering that shows these places has the brightness of each surface fitted (``fitted``). A
surface is a smooth part of the body of one material. Its faces keep their shading by Lambert's law: with more
freedom, errors of the pose would be taken for brightness.

Both fits are non-negative: multiplicative steps of maximum likelihood (MLEM; L. A. Shepp, Y. Vardi, IEEE
Transactions on Medical Imaging 1(2), 1982) with the image's blur as the system.
"""

from math import cos, radians
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, kernel
from rpod_pose.pmd.joint.edge_search import Patch
from rpod_schemas.arrays import Array
from rpod_schemas.types import Float32Array
from rpod_target import Target
from rpod_target.mesh.topology import components, edges

ROUNDS = 3
"""Number of multiplicative steps. Numerics: a budget; the first one fits all of a face but its edges."""
UNEVEN = 0.15
"""Standard deviation of the brightness within a face, as a share. Hand: half of what surfaces that are not
Lambertian add to the spread of an albedo (``brightness``)."""
MOST_SIGMAS = 3.0
"""Greatest residual of a pixel or point that counts, in sigmas. Physics: one in 370 normal errors is
larger; another body or a shadow is an outlier."""
PLANES = 50.0
"""Number of steps in which normals and offsets of faces are told apart. Numerics: a degree, and 2 % of the
radius; more faces need more steps of the fit."""
SMOOTH_DEG = 30.0
"""Angle between neighbouring faces up to which they are one surface. Physics: a round body of at least twelve
sides."""
MIXED = 0.01
"""Weight of a pixel that shows several parts, over that of a pixel of one. Numerics: it matters only for a
part that has no pixel of its own."""
HELD = 0.01
"""Weight of the brightness by the file, over that of a pixel of one part. Numerics: that of one pixel that
shows several parts."""

MIXED_PIXEL = -2
"""Stands for the triangle of a pixel whose rays meet several. Numerics: no triangle has this number."""


class Mixture(NamedTuple):
    """Shares of the target's parts, plane faces or surfaces, in the pixels of a rendering; M in all."""

    pixel: NDArray[np.int32]
    """Row-major index of the pixel, shape (M,)."""
    part: NDArray[np.int32]
    """Number of the part, shape (M,)."""
    light: Float32Array
    """Brightness that the part adds to the pixel, shape (M,)."""
    alone: NDArray[np.int32]
    """Number of the part that a pixel shows alone, -1 for others or the sky, shape (rows, columns)."""


def faces_of(target: Target) -> NDArray[np.int32]:
    """Return the number of the plane face of one material to which each triangle belongs, shape (T,)."""
    normals, triangles_m = np.asarray(target.normals), np.asarray(target.triangles_m)
    offsets = np.einsum("ni,ni->n", normals, triangles_m[:, 0]) / target.radius_m
    steps = np.rint(PLANES * np.column_stack((normals, offsets))).astype(np.int64)
    planes = np.column_stack((steps, target.triangle_material))
    each: NDArray[np.int32] = np.unique(planes, axis=0, return_inverse=True)[1].ravel().astype(np.int32)
    return each


def surfaces_of(target: Target) -> NDArray[np.int32]:
    """Return the number of the smooth surface of one material to which each triangle belongs, shape (T,)."""
    normals, material = np.asarray(target.normals), np.asarray(target.triangle_material)
    _, beside = edges(np.asarray(target.triangles_m))
    one, other = beside.T
    smooth = np.einsum("ni,ni->n", normals[one], normals[other]) > cos(radians(SMOOTH_DEG))
    smooth &= material[one] == material[other]
    found: NDArray[np.int32] = components(beside[smooth], size=len(normals)).astype(np.int32)
    return found


def fitted(patch: Patch, mixture: Mixture, *, clip: float, blur_px: float) -> Float32Array:
    """Return a smoothed rendering, in units of an image, with the brightness of each part fitted to it.

    A part of few pixels, or of none that it has for itself, keeps the brightness by the file.

    Args:
        patch: the image, smoothed.
        mixture: the parts that the pixels show at a pose.
        clip: greatest brightness of image and rendering, over the typical one.
        blur_px: standard deviation of the blur of image and rendering.
    """
    return _fitted(patch, mixture, clip, blur_px, alone=True)


def misfit(patch: Patch, mixture: Mixture, *, clip: float, blur_px: float) -> float:
    """Return minus the log likelihood of an image at a pose, with the brightness of each part fitted.

    All pixels have the same weight in this fit. Pixels that one blur covers share their errors: the sum is
    divided by the area 4 pi blur^2 of its autocorrelation. Arguments as for ``fitted``.
    """
    if not mixture.pixel.size:
        return 0.0
    rendered = _fitted(patch, mixture, clip, blur_px, alone=False)
    deviation = np.hypot(UNEVEN * rendered, np.hypot(_faint(patch), patch.noise))
    residual = np.minimum(np.abs(patch.image - rendered) / deviation, MOST_SIGMAS)
    if patch.saturated.size:
        residual = residual[patch.saturated == 0]
    return float(0.5 * np.square(residual).sum() / (4.0 * np.pi * blur_px**2))


def _fitted(patch: Patch, mixture: Mixture, clip: float, blur_px: float, *, alone: bool) -> Float32Array:
    """Return the rendering after ``ROUNDS`` steps; other arguments as for ``fitted``.

    If ``alone``, pixels that show one part alone decide, and the file where there is none. Else all pixels
    count alike, and the file does not.
    """
    weight = weights(mixture.alone) if alone else np.ones(mixture.alone.shape, np.float32)
    shape, most, faint = patch.image.shape, np.float32(clip * patch.typical), _faint(patch)
    gain = np.ones(int(mixture.part.max()) + 1, np.float32)
    bright = mixed(gain, mixture, shape, np.float32(np.inf))
    first = float(patch.typical / np.median(bright[bright > 0.0]))
    gain *= np.float32(first)

    def shown() -> Float32Array:
        """Return the smoothed rendering, clipped like the image."""
        return _blurred(mixed(gain, mixture, shape, most), blur_px)

    for _ in range(ROUNDS):
        ratio = ratio_of(patch.image, shown(), faint)
        if alone:
            adapt(gain, (first, HELD), mixture, weight, ratio)
        else:
            adapt(gain, (first, 0.0), mixture, weight, _blurred(ratio, blur_px))
    return shown()


def _faint(patch: Patch) -> np.float32:
    """Return the least brightness that counts: what differs by less is no change of the image."""
    return np.float32(0.5 * patch.least)


def _blurred(image: Array, blur_px: float) -> Float32Array:
    return cv2.GaussianBlur(image, (0, 0), blur_px).astype(np.float32, copy=False)


@kernel
def mixture_of(
    triangle: NDArray[np.int32], per_px: int, light: Float32Array, part: NDArray[np.int32]
) -> Mixture:
    """Return the parts that the pixels of a rendering show.

    Args:
        triangle: triangle that each ray meets, -1 for none, shape (per_px * rows, per_px * columns).
        per_px: number of rays for each pixel, along rows and columns.
        light: brightness that a ray on each triangle adds, shape (T,) or more.
        part: number of the part of each triangle, shape (T,).
    """
    rows, columns = triangle.shape[0] // per_px, triangle.shape[1] // per_px
    pixels, numbers = np.empty(triangle.size, np.int32), np.empty(triangle.size, np.int32)
    lights, count = np.empty(triangle.size, np.float32), 0
    alone = np.full((rows, columns), -1, np.int32)
    for i in range(rows):
        for j in range(columns):
            first, sky = count, False
            only = one_of(triangle, per_px, i, j)
            if only >= 0:
                numbers[count], lights[count] = part[only], 0.0
                for _ in range(per_px * per_px):  # one after the other, as below: rounding is the same
                    lights[count] += float(light[only])
                alone[i, j], pixels[count] = part[only], i * columns + j
                count += 1
            if only != MIXED_PIXEL:
                continue
            for v in range(per_px * i, per_px * (i + 1)):
                for u in range(per_px * j, per_px * (j + 1)):
                    met = triangle[v, u]
                    if met < 0:
                        sky = True
                    else:
                        share = int(part[met]), float(light[met])
                        count = _add(numbers, lights, (first, count), share)
            pixels[first:count] = i * columns + j
            if count == first + 1 and not sky:
                alone[i, j] = numbers[first]
    return Mixture(pixels[:count], numbers[:count], lights[:count], alone)


@inlined_kernel
def one_of(triangle: NDArray[np.int32], per_px: int, i: int, j: int) -> int:
    """Return the triangle that all rays of a pixel meet, -1 if none meets any, else ``MIXED_PIXEL``.

    Args:
        triangle: triangle that each ray meets, -1 for none, shape (per_px * rows, per_px * columns).
        per_px: number of rays for each pixel, along rows and columns.
        i: row of the pixel.
        j: column of the pixel.
    """
    first, same = triangle[per_px * i, per_px * j], True
    for v in range(per_px * i, per_px * (i + 1)):
        for u in range(per_px * j, per_px * (j + 1)):
            same &= triangle[v, u] == first
    return first if same else MIXED_PIXEL


@kernel
def _add(
    numbers: NDArray[np.int32], lights: Float32Array, span: tuple[int, int], share: tuple[int, float]
) -> int:
    """Add a ray's light to its part in a pixel; return the number of shares so far.

    Args:
        numbers: parts of the shares, shape (M,) or more, input and output.
        lights: their light, same shape, input and output.
        span: first share of the pixel, and number of shares so far.
        share: part that the ray meets, and brightness that it adds.
    """
    (first, count), (number, light) = span, share
    k = first
    while k < count and numbers[k] != number:
        k += 1
    if k == count:
        numbers[k], lights[k] = number, 0.0
        count += 1
    lights[k] += light
    return count


@kernel
def weights(alone: NDArray[np.int32]) -> Float32Array:
    """Return the weight of each pixel in the fit: 1 if it and its neighbours show one part, else ``MIXED``.

    Args:
        alone: part that each pixel shows alone, -1 for none, shape (rows, columns), as the result.
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
def mixed(gain: Float32Array, mixture: Mixture, shape: tuple[int, int], most: np.float32) -> Float32Array:
    """Return the brightness of the pixels, shape (rows, columns).

    Args:
        gain: factor on the brightness of each part, shape (K,).
        mixture: the parts that the pixels show.
        shape: number of rows and columns of pixels.
        most: greatest brightness; inf for none.
    """
    image = np.zeros(shape[0] * shape[1], np.float32)
    for n in range(mixture.pixel.size):
        image[mixture.pixel[n]] += gain[mixture.part[n]] * mixture.light[n]
    for n in range(image.size):
        image[n] = min(image[n], most)
    return image.reshape(shape)


@kernel
def ratio_of(image: Float32Array, rendered: Float32Array, faint: np.float32) -> Float32Array:
    """Return image over rendering, with ``faint`` added to both.

    Args:
        image: shape (rows, columns), as the result.
        rendered: same shape.
        faint: least brightness that counts.
    """
    ratio = np.empty(image.shape, np.float32)
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            ratio[i, j] = (image[i, j] + faint) / (rendered[i, j] + faint)
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
        prior: factor by the file, the same for all parts, and its weight in pixels of one part.
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
