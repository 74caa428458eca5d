"""Depth and amplitude from Q1..Q4: Klionovska et al. 2018, Eqs. 1 to 3.

It takes a camera's raw samples, whether emulated or real.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from rpod_schemas.arrays import Array
from rpod_schemas.config.pmd import SAMPLE_OFFSET, PmdConfig
from rpod_schemas.types import Float32Array


def phase(samples: Array) -> Array:
    """Return the phase shift, rad, 0 to 2 pi, of Q1..Q4 along the last axis (Eq. 1).

    The paper prints a plain arctangent, which is right for a seventh of the ranges between 1 and 7.5 m at
    20 MHz; here it has all four quadrants. An offset of the samples cancels.
    """
    q1, q2, q3, q4 = _planes(samples)
    angle: Array = np.arctan2(q3 - q4, q1 - q2)
    turn: Array = (angle < 0.0) * angle.dtype.type(2.0 * math.pi)
    return angle + turn


def distance(phase_rad: Array, modulation_frequency_hz: float) -> Array:
    """Return the radial distance, m, of a phase shift (Eq. 2), modulo c / 2f."""
    metres: Array = phase_rad * phase_rad.dtype.type(constants.c / (4.0 * math.pi * modulation_frequency_hz))
    return metres


def amplitude(samples: Array) -> Array:
    """Return the amplitude of Q1..Q4 along the last axis, in their unit (Eq. 3). An offset cancels."""
    q1, q2, q3, q4 = _planes(samples)
    strength: Array = 0.5 * np.hypot(q1 - q2, q3 - q4)
    return strength


def asymmetry(samples: Array) -> Array:
    """Return the greater of |Q1 + Q2| and |Q3 + Q4|, which are zero but for noise and motion."""
    q1, q2, q3, q4 = _planes(samples)
    greater: Array = np.maximum(np.abs(q1 + q2), np.abs(q3 + q4))
    return greater


def _planes(samples: Array) -> Array:
    """Return Q1..Q4 along the first axis; integers as floats, since differences of unsigned ones wrap."""
    planes: Array = np.moveaxis(samples, -1, 0)
    return planes.astype(np.result_type(planes, np.float32), order="C", copy=False)


def reconstruct(
    samples: NDArray[np.uint16],
    config: PmdConfig,
    *,
    cosine: Array,
    full: NDArray[np.bool_] | None = None,
) -> tuple[Float32Array, NDArray[np.uint16]]:
    """Return z-depth and amplitude of a frame.

    The depth is lost where the amplitude is too low, a tap was full, or the samples contradict each other.
    The amplitude lives on; both are lost only where both taps were full, so that nothing is left of their
    difference.

    Args:
        samples: Q1..Q4, counts from an offset of 32768, shape (H, W, 4).
        config: of the camera that took them.
        cosine: of the angle between each pixel's ray and the boresight, shape (H, W): z over radial distance.
        full: pixels with a full tap, shape (H, W), where the camera says so.

    Returns:
        Depth in metres, float32, NaN where there is none, and amplitude in counts, both of shape (H, W).
    """
    counts = np.moveaxis(_planes(samples) - np.float32(SAMPLE_OFFSET), 0, -1)
    strength = amplitude(counts)
    lost = strength * config.pixel.electrons_per_count < config.reconstruction.least_amplitude_e
    lost |= np.abs(counts).max(axis=-1) >= config.pixel.saturation_count
    lost |= asymmetry(counts) > 2.0 * config.reconstruction.asymmetry_limit * strength
    if full is not None:
        lost |= full
    depth_m = distance(phase(counts), config.modulation_frequency_hz) * cosine.astype(np.float32)
    depth_m[lost] = np.nan
    return depth_m, np.rint(strength).astype(np.uint16)
