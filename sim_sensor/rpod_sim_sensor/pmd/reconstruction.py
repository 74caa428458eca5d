"""Depth and amplitude from Q1..Q4: Klionovska et al. 2018, Eqs. 1 to 3.

It takes a camera's raw samples, whether emulated or real. The equations stand here once: as they are for
arrays, compiled for the kernel that goes over an image.
"""

import math
from enum import IntFlag
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import constants

from rpod_schemas.arrays import Array
from rpod_schemas.config.pmd import SAMPLE_OFFSET, PmdConfig
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.pmd.unwrapping import Turns, unwrap_pixel

_TURN_RAD = 2.0 * math.pi


class Lost(IntFlag):
    """Why a pixel has no depth."""

    TOO_DARK = 1
    """The amplitude is under its least."""
    SATURATED = 2
    """A tap was full."""
    INCONSISTENT = 4
    """Samples that should cancel do not, or the distances of two frequencies do not agree."""

    @property
    def camera_code(self) -> int:
        """What the camera's manual has in place of a distance; over goes before under and invalid."""
        if self & Lost.SATURATED:
            return 0x0000
        return 0xFFFF if self & Lost.TOO_DARK else 0x0001


class Reconstruction(NamedTuple):
    """The images of a frame."""

    depth_m: Float32Array
    """z-depth, shape (H, W), NaN where there is none."""
    amplitude: NDArray[np.uint16]
    """Counts of the converter, shape (H, W); of two frequencies the mean."""
    lost: NDArray[np.uint8]
    """``Lost``, shape (H, W), 0 where there is depth."""

    @classmethod
    def of(cls, config: PmdConfig) -> "Reconstruction":
        """Return buffers for a camera's images."""
        shape = config.camera.height, config.camera.width
        return cls(np.empty(shape, np.float32), np.empty(shape, np.uint16), np.empty(shape, np.uint8))


def _phase(q1: Any, q2: Any, q3: Any, q4: Any) -> Any:
    angle = np.arctan2(q3 - q4, q1 - q2)
    return angle + (angle < 0.0) * _TURN_RAD


def _amplitude(q1: Any, q2: Any, q3: Any, q4: Any) -> Any:
    return 0.5 * np.sqrt((q1 - q2) ** 2 + (q3 - q4) ** 2)


def _asymmetry(q1: Any, q2: Any, q3: Any, q4: Any) -> Any:
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
    """Return the greater of |Q1 + Q2| and |Q3 + Q4|, which are zero but for noise and motion."""
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

    The depth is lost where the amplitude is too low, a tap was full, or the samples contradict each other.
    The amplitude lives on; both are lost only where both taps were full, so that nothing is left of their
    difference.

    Args:
        samples: Q1..Q4, counts from an offset of 32768, shape (F, H, W, 4) in the order of
            ``config.frequencies_hz``, or (H, W, 4) of one frequency.
        config: of the camera that took them.
        cosine: of the angle between each pixel's ray and the boresight, shape (H, W): z over radial distance.
        full: pixels with a full tap, shape (H, W), where the camera says so.
        out: buffers to write into and to return; new ones where left out.
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
    """What keeps a pixel's depth, in counts."""

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


_phase_of, _amplitude_of, _asymmetry_of = (
    njit(cache=True, nogil=True, error_model="numpy")(equation)
    for equation in (_phase, _amplitude, _asymmetry)
)
_TOO_DARK, _SATURATED, _INCONSISTENT = int(Lost.TOO_DARK), int(Lost.SATURATED), int(Lost.INCONSISTENT)


@njit(cache=True, nogil=True, error_model="numpy")
def _reconstruct(samples, full, cosine, limits, turns, images):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    frequencies, height, width, _ = samples.shape
    depth_m, strengths, losses = images
    for row in range(height):
        for column in range(width):
            lost = _SATURATED if full[row, column] else 0
            strength = 0.0
            for frequency in range(frequencies):
                share, reason = _judge(samples[frequency, row, column], limits)
                strength += share / frequencies
                lost |= reason
            metres = np.nan
            if lost == 0:
                metres, disagreement = _radial_m(samples, row, column, turns)
                lost = _INCONSISTENT if disagreement > limits.disagreement else 0
            depth_m[row, column] = np.nan if lost else metres * cosine[row, column]
            strengths[row, column] = int(strength + 0.5)
            losses[row, column] = lost


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _counts(sample):  # type: ignore[no-untyped-def]
    offset = np.float32(SAMPLE_OFFSET)
    return (
        np.float32(sample[0]) - offset,
        np.float32(sample[1]) - offset,
        np.float32(sample[2]) - offset,
        np.float32(sample[3]) - offset,
    )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _judge(sample, limits):  # type: ignore[no-untyped-def]
    """Return the amplitude of one frequency's samples, and why they give no depth."""
    q1, q2, q3, q4 = _counts(sample)
    strength = _amplitude_of(q1, q2, q3, q4)
    lost = 0
    if strength < limits.least_amplitude:
        lost |= _TOO_DARK
    if max(abs(q1), abs(q2), abs(q3), abs(q4)) >= limits.saturation:
        lost |= _SATURATED
    if _asymmetry_of(q1, q2, q3, q4) > limits.asymmetry * strength:
        lost |= _INCONSISTENT
    return strength, lost


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _radial_m(samples, row, column, turns):  # type: ignore[no-untyped-def]
    q1, q2, q3, q4 = _counts(samples[0, row, column])
    first_m = _phase_of(q1, q2, q3, q4) / _TURN_RAD * turns.first_m
    if samples.shape[0] == 1:
        return first_m, 0.0
    q1, q2, q3, q4 = _counts(samples[1, row, column])
    second_m = _phase_of(q1, q2, q3, q4) / _TURN_RAD * turns.second_m
    return unwrap_pixel(first_m, second_m, turns)
