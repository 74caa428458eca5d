"""Range errors that vary over the target: the wiggling of a camera that is not calibrated.

The modulation is not exactly a sine. With four samples a period its harmonics make an error of the range that
repeats with an eighth of the modulation's wavelength, c / (8 f) (M. Lindner et al., Computer Vision and Image
Understanding 114, 2010). Its phase and amplitude differ from camera to camera. A small target is much
shorter than the period: its near end may be measured centimetres off its far end.
"""

import numpy as np
from scipy.constants import speed_of_light

from rpod_schemas.arrays import FloatArray

PERIODS = 8.0
"""Periods of the error in one wavelength of the modulation, of which the way to the target and back is two
ranges. Physics: four samples alias the third and the fifth harmonic to four periods in half a wavelength."""
ROUNDS = 3
"""Number of weighted fits, after each of which outliers count less. Numerics: a budget of computation."""


def wiggling(
    error_m: FloatArray, range_m: FloatArray, frequencies_hz: FloatArray, *, sigma_m: float, scale_m: float
) -> FloatArray:
    """Return the wiggling that explains errors of ranges best, beyond an error that all of them share, m.

    The waves' amplitudes have a prior, so that wiggling explains no more error than a camera may have.

    Args:
        error_m: measured ranges less those expected, shape (N,), m.
        range_m: measured ranges, shape (N,), m.
        frequencies_hz: modulation frequencies, shape (F,), Hz; without any, the result is 0.
        sigma_m: standard deviation of the camera's wiggling, m.
        scale_m: Geman-McClure scale of an error that no wiggling explains, m.
    """
    if not len(error_m) or not len(frequencies_hz) or sigma_m == 0.0:
        return np.zeros(len(error_m))
    phase = 2.0 * np.pi * PERIODS / speed_of_light * np.outer(range_m, frequencies_hz)
    waves = np.column_stack((np.ones(len(range_m)), np.sin(phase), np.cos(phase)))
    prior = np.full(waves.shape[1], (scale_m / sigma_m) ** 2)
    prior[0] = 0.0
    weights, amplitudes = np.ones(len(error_m)), np.zeros(waves.shape[1])
    for _ in range(ROUNDS):
        weighted = waves * weights[:, None]
        amplitudes = np.linalg.lstsq(weighted.T @ waves + np.diag(prior), weighted.T @ error_m, rcond=None)[0]
        left_m = error_m - waves @ amplitudes
        weights = (1.0 + (left_m / scale_m) ** 2) ** -2
    explained: FloatArray = waves[:, 1:] @ amplitudes[1:]
    return explained - np.median(explained)
