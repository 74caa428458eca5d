"""The noise of an amplitude image, told by the image itself."""

import numpy as np
from numpy.typing import NDArray

NOISE_ROWS = 5
"""Every how many rows the noise is taken from."""
SECOND_DIFFERENCE = 0.6745 * 6.0**0.5
"""Median of the absolute second difference of normal noise over the noise's standard deviation."""


def noise_of(image: NDArray[np.float32], least: float) -> float:
    """Return the standard deviation of a pixel's noise where an image, shape (H, W), exceeds ``least``.

    The second difference along a row knows nothing of brightness and slope, its median nothing of edges
    (after J. Immerkaer, Fast Noise Variance Estimation, Computer Vision and Image Understanding 64(2), 1996).
    """
    rows = image[::NOISE_ROWS]
    middle = rows[:, 1:-1]
    differences = np.abs(rows[:, 2:] - 2.0 * middle + rows[:, :-2])[middle > least]
    return float(np.median(differences)) / SECOND_DIFFERENCE if differences.size else 0.0


def noise_of_change(blur_px: float) -> float:
    """Return the noise of a change over two pixels, after a Gaussian blur, over that of a pixel before it.

    The blur leaves a variance of 1 / (4 pi s^2) and correlates places d apart by exp(-d^2 / (4 s^2)).
    """
    correlation = np.exp(-(blur_px**-2.0))
    return float(np.sqrt((1.0 - correlation) / (2.0 * np.pi)) / blur_px)
