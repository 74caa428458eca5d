"""Depth and amplitude from Q1..Q4: Klionovska et al. 2018, Eqs. 1 to 3.

The samples may come from the emulator or from a real camera.
"""

import math
from enum import IntFlag
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.config.pmd import SAMPLE_OFFSET, SAMPLES, PmdConfig
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.pmd.unwrapping import Turns, unwrap_pixel

_TURN_RAD = 2.0 * math.pi


class Lost(IntFlag):
    """Reasons why a pixel has no depth."""

    TOO_DARK = 1
    """The amplitude is below its limit."""
    SATURATED = 2
    """A tap was full."""
    INCONSISTENT = 4
    """Samples that should cancel do not, or the distances of two frequencies do not agree."""


class Reconstruction(NamedTuple):
    """The images of a frame."""

    depth_m: Float32Array
    """z-depth, shape (H, W), NaN without one."""
    amplitude: NDArray[np.uint16]
    """Amplitude in counts of the converter, shape (H, W); the mean of two frequencies."""
    lost: NDArray[np.uint8]
    """``Lost`` of each pixel, shape (H, W), 0 for a pixel with depth."""

    @classmethod
    def of(cls, config: PmdConfig) -> "Reconstruction":
        """Return buffers for a camera's images."""
        shape = config.camera.height, config.camera.width
        return cls(np.empty(shape, np.float32), np.empty(shape, np.uint16), np.empty(shape, np.uint8))


def _phase(q1: Any, q2: Any, q3: Any, q4: Any) -> Any:
    angle = np.arctan2(q3 - q4, q1 - q2)
    return angle + (angle < 0.0) * _TURN_RAD


def _amplitude(q1: Any, q2: Any, q3: Any, q4: Any) -> Any:
    """Return half the length of (Q1 - Q2, Q3 - Q4) (Eq. 3), in the unit of the samples, of any shape."""
    return 0.5 * np.sqrt((q1 - q2) ** 2 + (q3 - q4) ** 2)


def _asymmetry(q1: Any, q2: Any, q3: Any, q4: Any) -> Any:
    """Return the greater of |Q1 + Q2| and |Q3 + Q4|, in the unit of the samples, of any shape."""
    return np.maximum(np.abs(q1 + q2), np.abs(q3 + q4))


def phase(samples: Array) -> Array:
    """Return the phase shift, rad, 0 to 2 pi, of Q1..Q4 along the last axis (Eq. 1).

    The paper prints a plain arctangent, which is right for a seventh of the ranges between 1 and 7.5 m at
    20 MHz; here it has all four quadrants. An offset of the samples cancels.
    """
    shift: Array = _phase(*_planes(samples))
    return shift


def distance(phase_rad: Array, modulation_frequency_hz: float) -> Array:
    """Return the radial distance, m, of a phase shift (Eq. 2), modulo c / 2f."""
    metres: Array = phase_rad * (constants.c / (4.0 * math.pi * modulation_frequency_hz))
    return metres


def amplitude(samples: Array) -> Array:
    """Return the amplitude of Q1..Q4 along the last axis, in their unit (Eq. 3). An offset cancels."""
    strength: Array = _amplitude(*_planes(samples))
    return strength


def asymmetry(samples: Array) -> Array:
    """Return the greater of |Q1 + Q2| and |Q3 + Q4|, which are zero except for noise and motion."""
    greater: Array = _asymmetry(*_planes(samples))
    return greater


def _planes(samples: Array) -> Array:
    """Return Q1..Q4 along the first axis; as floats, since differences of unsigned integers wrap."""
    return np.moveaxis(np.asarray(samples, np.float64), -1, 0)


def reconstruct(
    samples: NDArray[np.uint16],
    config: PmdConfig,
    *,
    cosine: Array,
    full: NDArray[np.bool_] | None = None,
    out: Reconstruction | None = None,
) -> Reconstruction:
    """Return the images of a frame.

    The depth is lost if the amplitude is too low, a tap was full, or the samples are inconsistent with each
    other. The amplitude remains. Both are lost only if both taps were full, so that their difference is zero.

    Args:
        samples: Q1..Q4, counts from an offset of 32768, shape (F, H, W, 4) in the order of
            ``config.frequencies_hz``, or (H, W, 4) of one frequency.
        config: configuration of the camera that took them.
        cosine: cosine of the angle between each pixel's ray and the boresight (z over radial distance), shape
            (H, W).
        full: pixels with a full tap, shape (H, W), if the camera reports them.
        out: buffers to write into and to return; by default new ones.
    """
    every = samples.reshape(len(config.frequencies_hz), *samples.shape[-3:])
    if out is None:
        shape = every.shape[1:3]
        out = Reconstruction(
            np.empty(shape, np.float32), np.empty(shape, np.uint16), np.empty(shape, np.uint8)
        )
    if full is None:
        full = np.zeros(every.shape[1:3], np.bool_)
    _reconstruct(every, full, cosine, _Limits.of(config), Turns.of(config), out)
    return out


class _Limits(NamedTuple):
    """Limits within which a pixel has depth, in counts."""

    least_amplitude: float
    saturation: int
    asymmetry: float
    disagreement: float

    @classmethod
    def of(cls, config: PmdConfig) -> "_Limits":
        limits = config.reconstruction
        return cls(
            limits.least_amplitude_e / config.pixel.electrons_per_count,
            config.pixel.saturation_count,
            2.0 * limits.asymmetry_limit,
            limits.wrap_limit,
        )


_amplitude_of, _asymmetry_of = kernel(_amplitude), kernel(_asymmetry)
_TOO_DARK, _SATURATED, _INCONSISTENT = int(Lost.TOO_DARK), int(Lost.SATURATED), int(Lost.INCONSISTENT)


@kernel
def _reconstruct(  # noqa: PLR0917
    samples: NDArray[np.uint16],
    full: NDArray[np.bool_],
    cosine: Array,
    limits: _Limits,
    turns: Turns,
    images: Reconstruction,
) -> None:
    """Fill the images of a frame; arguments as in ``reconstruct``, samples of shape (F, H, W, 4)."""
    frequencies, height, width, _ = samples.shape
    depth_m, strengths, losses = images
    wrapped, strength, lost = np.empty((2, width)), np.empty(width), np.empty(width, np.int64)
    metres, planes = np.empty(width), np.empty((SAMPLES, width))
    for row in range(height):
        strength[:] = 0.0
        for column in range(width):
            lost[column] = _SATURATED if full[row, column] else 0
        for frequency in range(frequencies):
            _mark_row(samples[frequency, row], limits, planes, wrapped[frequency], strength, lost)
        for column in range(width):
            metres[column] = wrapped[0, column] * turns.first_m
        if frequencies > 1:
            _unwrap_row(wrapped[1], turns, limits, metres, lost)
        for column in range(width):
            depth_m[row, column] = np.nan if lost[column] else metres[column] * cosine[row, column]
            strengths[row, column] = int(strength[column] / frequencies + 0.5)
            losses[row, column] = lost[column]


@inner_kernel
def _mark_row(  # noqa: PLR0917
    samples: NDArray[np.uint16],
    limits: _Limits,
    planes: FloatArray,
    wrapped: FloatArray,
    strength: FloatArray,
    lost: NDArray[np.int64],
) -> None:
    """Fill a row's phases in turns, (W,), add its amplitudes, and mark the pixels without depth.

    ``planes`` is memory of shape (4, W). A loop over interleaved samples takes four times as long as three
    loops, of which the first one separates them.
    """
    offset = np.float64(SAMPLE_OFFSET)
    for column in range(wrapped.size):
        for k in range(SAMPLES):
            planes[k, column] = samples[column, k] - offset
    for column in range(wrapped.size):
        q1, q2, q3, q4 = planes[0, column], planes[1, column], planes[2, column], planes[3, column]
        size = _amplitude_of(q1, q2, q3, q4)
        strength[column] += size
        strongest = max(abs(q1), abs(q2), abs(q3), abs(q4))
        lost[column] |= (
            (_TOO_DARK if size < limits.least_amplitude else 0)
            | (_SATURATED if strongest >= limits.saturation else 0)
            | (_INCONSISTENT if _asymmetry_of(q1, q2, q3, q4) > limits.asymmetry * size else 0)
        )
    for column in range(wrapped.size):
        wrapped[column] = phase_turns(
            planes[0, column], planes[1, column], planes[2, column], planes[3, column]
        )


@inner_kernel
def _unwrap_row(
    wrapped: FloatArray, turns: Turns, limits: _Limits, metres: FloatArray, lost: NDArray[np.int64]
) -> None:
    """Unwrap a row's distances by the phases of the second frequency, shape (W,) each."""
    for column in range(wrapped.size):
        if lost[column] == 0:
            second_m = wrapped[column] * turns.second_m
            metres[column], disagreement = unwrap_pixel(metres[column], second_m, turns)
            lost[column] = _INCONSISTENT if disagreement > limits.disagreement else 0


@kernel
def phase_turns(q1: float, q2: float, q3: float, q4: float) -> float:
    """Return ``phase`` (Eq. 1) in turns, 0 to 1, to 2e-8: a fitted polynomial, which is vectorised."""
    across, along = q3 - q4, q1 - q2
    less, more = min(abs(across), abs(along)), max(abs(across), abs(along))
    t = less / more if more > 0.0 else 0.0
    t2 = t * t
    odd = -0.009448567552434017 + t2 * (0.0038461685215798328 - t2 * 0.0007430583510577952)
    odd = 0.031782025228718834 + t2 * (-0.02230808794843388 + t2 * (0.0157660428809624 + t2 * odd))
    turns = t * (0.15915492681891674 + t2 * (-0.05304946153068153 + t2 * odd))
    turns = 0.25 - turns if abs(across) > abs(along) else turns
    turns = 0.5 - turns if along < 0.0 else turns
    return 1.0 - turns if across < 0.0 else turns
