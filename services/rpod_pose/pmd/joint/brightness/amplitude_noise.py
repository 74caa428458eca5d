"""Typical brightness of a target in an amplitude image and beside it, and the image's noise."""

from math import erf

import numpy as np

from rpod_geometry.kernels import kernel
from rpod_pose.pmd.joint.check.frame_check import LIT_SPREADS
from rpod_pose.pmd.joint.edge_search import Patch
from rpod_pose.pmd.rendering import Window
from rpod_schemas.types import Float32Array

SAMPLES = 3000
"""Number of pixels in the estimates. Numerics: the noise is then known to about 2 %."""
SECOND_DIFFERENCE = 0.6745 * 6.0**0.5
"""Median of the absolute second difference of normal noise over the noise's standard deviation. Physics:
0.6745 of the standard deviation, and sqrt(1 + 4 + 1) for the difference."""
LIT = 0.25, 4.0
"""Least and largest amplitude of the target over its median: darker pixels show the sky, brighter ones a
glint. Hand: as ``frame_check.BRIGHT``."""
ROUNDS = 4
"""Number of iterations of this median. Numerics: a budget of computation, in which it converges."""
SKY_SAMPLES, FREE = 1000, 0.99
"""Number of pixels from which the brightness beside the target is estimated, and the least share of such a
pixel that the target does not cover. Numerics: their median is known to a thirtieth of a standard
deviation."""


@kernel
def noise_of(image: Float32Array, least: float) -> float:
    """Return the standard deviation of a pixel's noise where an image, shape (H, W), exceeds ``least``.

    The second difference along a row does not depend on brightness and slope, and its median does not depend
    on edges (after J. Immerkaer, Fast Noise Variance Estimation, Computer Vision and Image Understanding
    64(2), 1996).
    """
    rows, columns = image.shape
    step = rows * columns // SAMPLES + 1
    differences, count = np.empty(rows * columns // step + 1), 0
    for pixel in range(0, rows * columns, step):
        i, j = pixel // columns, pixel % columns
        if 0 < j < columns - 1 and image[i, j] > least:
            differences[count] = abs(image[i, j + 1] - 2.0 * image[i, j] + image[i, j - 1])
            count += 1
    return float(np.median(differences[:count]) / SECOND_DIFFERENCE) if count else 0.0


def noise_of_change(blur_px: float) -> float:
    """Return the noise of a change over two pixels after a Gaussian blur, over a pixel's noise before it.

    After a blur of width s, the variance is multiplied by 1 / (4 pi s^2), and pixels d apart have the
    correlation exp(-d^2 / (4 s^2)).
    """
    correlation = np.exp(-(blur_px**-2.0))
    return float(np.sqrt((1.0 - correlation) / (2.0 * np.pi)) / blur_px)


def noise_of_place(blur_px: float) -> float:
    """Return the noise of an edge's place, px, times its change over two pixels over a pixel's noise.

    The place is where the change I(x + 1) - I(x - 1) has its maximum, so that its error is the noise of the
    slope of this difference over the difference's second derivative (as for J. Canny, A Computational
    Approach to Edge Detection, IEEE Transactions PAMI 8(6), 1986, section III). The step is blurred by the
    Gaussian of width s and by a pixel, with the variance s^2 + 1 / 12. The noise has the covariance
    exp(-d^2 / (4 s^2)) / (4 pi s^2).
    """
    variance = blur_px**2 + 1.0 / 12.0
    change = erf((2.0 * variance) ** -0.5)
    bend = np.sqrt(2.0 / np.pi) * variance**-1.5 * np.exp(-0.5 / variance)
    behind = (1.0 - 2.0 * blur_px**-2.0) * np.exp(-(blur_px**-2.0))
    slope = np.sqrt((1.0 - behind) / (4.0 * np.pi)) / blur_px**2
    return float(slope * change / bend)


def correlation_px(blur_px: float) -> float:
    """Return the correlation length, px, of an edge's errors by noise along the edge, after a Gaussian blur.

    It is the integral of the correlation exp(-d^2 / (4 s^2)) over all distances d, with s = ``blur_px``.
    """
    return float(2.0 * np.sqrt(np.pi) * blur_px)


def typical_of(image: Float32Array, measured: float, depth_m: Float32Array) -> float:
    """Return the median amplitude of the pixels that are neither much darker nor much brighter than it.

    If a target is small and faint, the noise of the sky is not much darker, and most pixels show the sky. A
    median within this noise is that of the sky. Then the typical amplitude of the pixels with depth is
    returned.

    Args:
        image: shape (H, W).
        measured: typical amplitude of pixels with depth, right within a small factor; 0 if none has depth.
        depth_m: depth, same shape, m.
    """
    step = int(np.sqrt(image.size / SAMPLES)) + 1
    sparse = image[::step, ::step]
    few = np.sort(sparse, axis=None)
    start = measured or float(np.median(image[image >= image.mean()]))
    middle = start
    for _ in range(ROUNDS):
        first, last = np.searchsorted(few, (LIT[0] * middle, LIT[1] * middle))
        if first == last:
            break
        middle = float(few[(first + last) // 2])
    if middle >= measured:
        return middle
    sky = sparse[~(depth_m[::step, ::step] > 0.0) & (sparse > 0.0) & (sparse < measured)]
    return measured if middle <= brightest_of(sky) else middle


def brightest_of(sky: Float32Array) -> float:
    """Return the largest amplitude that the noise of pixels of the sky, shape (N,), explains; 0 if none."""
    if not sky.size:
        return 0.0
    median = np.median(sky)
    return float(median + LIT_SPREADS * np.median(np.abs(sky - median)))


@kernel
def sky_of(patch: Patch, free: Float32Array, window: Window) -> float:
    """Return the median brightness of an image's pixels beside the target; 0 without any.

    Args:
        patch: the image.
        free: how much of a pixel of the window the target leaves free, shape (rows, columns).
        window: the pixels around the target.
    """
    image, check = patch.image, patch.saturated.size > 0
    found, count = np.empty(SKY_SAMPLES + 1, np.float32), 0
    bottom, right = window.row + window.rows, window.column + window.columns
    step = image.size // SKY_SAMPLES + 1
    for pixel in range(0, image.size, step):
        i, j = pixel // image.shape[1], pixel % image.shape[1]
        if check and patch.saturated[i, j] > 0:
            continue
        beside = i < window.row or i >= bottom or j < window.column or j >= right
        if beside or free[i - window.row, j - window.column] > FREE:
            found[count] = image[i, j]
            count += 1
    return float(np.median(found[:count])) if count > 0 else 0.0
