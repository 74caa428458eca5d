"""Conversion of light to counts: the charge of the two taps of a photonic mixer.

The taps share the charge in time with the modulation. The background suppression removes the same charge from
both. Sunlight fills them equally, so that it does not change their difference but adds its noise. The charge
that remains in a tap is clipped at the full well, and the difference of the taps is converted.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import SAMPLE_OFFSET, SAMPLES, PmdConfig
from rpod_schemas.types import Float32Array


class Electronics(NamedTuple):
    """The chip in one sub-exposure of the full time, electrons."""

    contrast: float
    read_variance_e2: float
    suppression_e: float
    full_well_e: float
    electrons_per_count: float

    @classmethod
    def of(cls, config: PmdConfig) -> "Electronics":
        """Return the chip that a configuration describes."""
        pixel = config.pixel
        return cls(
            contrast=pixel.contrast,
            read_variance_e2=pixel.read_noise_e**2,
            suppression_e=pixel.suppression_e_s * config.sub_exposure_s,
            full_well_e=pixel.full_well_e,
            electrons_per_count=pixel.electrons_per_count,
        )


class Light(NamedTuple):
    """The light that a frame collects in the full time, and the share of the time that is used."""

    modulated_e: Float32Array
    """Correlation of the light with the modulation, electrons, shape (K, H, W)."""
    charge_e: Float32Array
    """All electrons of a sub-exposure, S + B, shape (H, W)."""
    stray_e: FloatArray
    """Stray light in every pixel: modulation in each sub-exposure, then charge, shape (K + 1,)."""
    time_share: float = 1.0
    """Share of the full time that the automatic exposure uses."""


class Noise(NamedTuple):
    """Standard normal numbers: row r takes W for each sub-exposure in turn, from ``pool[starts[r]]`` on."""

    pool: Float32Array
    """Normal numbers, shape (P,)."""
    starts: NDArray[np.int64]
    """First index in the pool for each row, shape (H,), at most P - W K."""


class _Taken(NamedTuple):
    """Light and noise of a row of pixels in one sub-exposure."""

    signal: Float32Array
    """Correlation of the light with the modulation in the full time, electrons, shape (W,)."""
    stray: float
    """Correlation of the stray light with the modulation in the full time, electrons."""
    normal: Float32Array
    """Standard normal noise, shape (W,)."""
    share: float
    """Share of the full time that is used."""


@kernel
def convert(
    light: Light,
    noise: Noise,
    electronics: Electronics,
    samples: NDArray[np.uint16],
    full: NDArray[np.bool_],
) -> None:
    """Fill Q1..Q4 and whether a tap of the pixel was full.

    Args:
        light: light of the frame.
        noise: shot and read noise of the difference of the taps.
        electronics: the chip.
        samples: output, counts from an offset of 32768, shape (K / 4, H, W, 4).
        full: output, pixels with a full tap, shape (H, W).
    """
    modulated_e, charge_e, stray_e, share = light
    count, height, width = modulated_e.shape
    charge, sigma, fullest = np.empty(width), np.empty(width), np.empty(width)
    counts = np.empty(width, np.int32)
    for row in range(height):
        for column in range(width):
            charge[column] = share * (charge_e[row, column] + stray_e[count])
            sigma[column] = np.sqrt(charge[column] + electronics.read_variance_e2)
            fullest[column] = 0.0
        for k in range(count):
            first = noise.starts[row] + k * width
            normal = noise.pool[first : first + width]
            signal = modulated_e[k, row]
            taken = _Taken(signal, stray_e[k], normal, share)
            _fill(taken, charge, sigma, electronics, fullest, counts)
            for column in range(width):  # a separate loop, so that the one above is vectorised
                samples[k // SAMPLES, row, column, k % SAMPLES] = counts[column]
        for column in range(width):
            full[row, column] = fullest[column] >= electronics.full_well_e


@inner_kernel
def _fill(  # noqa: PLR0917
    taken: _Taken,
    charge: FloatArray,
    sigma: FloatArray,
    electronics: Electronics,
    fullest: FloatArray,
    counts: NDArray[np.int32],
) -> None:
    """Fill both taps of a row's pixels in a sub-exposure, and convert the clipped difference; shape (W,)."""
    signal, stray, normal, share = taken
    suppression_e, full_well_e = share * electronics.suppression_e, electronics.full_well_e
    gain, counts_per_e = share * electronics.contrast, 1.0 / electronics.electrons_per_count
    for column in range(signal.size):
        difference = gain * (signal[column] + stray) + sigma[column] * normal[column]
        tap_a, tap_b = 0.5 * (charge[column] + difference), 0.5 * (charge[column] - difference)
        common = min(tap_a, tap_b, suppression_e)
        tap_a, tap_b = tap_a - common, tap_b - common
        fullest[column] = max(fullest[column], tap_a, tap_b)
        kept = min(tap_a, full_well_e) - min(tap_b, full_well_e)
        counts[column] = np.int32(SAMPLE_OFFSET + 0.5 + kept * counts_per_e)
