"""From light to counts: what the two taps of a photonic mixer make of their charge.

The taps share the charge in time with the modulation. The background suppression takes the same charge off
both, so that sunlight, which fills them alike, leaves the difference as it is and only its noise behind. What
remains in a tap is clipped at the full well, and the difference of the taps is converted.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
    """What a frame collects in the full time, and which share of the time it has."""

    modulated_e: Float32Array
    """Correlation of the light with the modulation, electrons, shape (K, H, W)."""
    charge_e: Float32Array
    """All electrons of a sub-exposure, S + B, shape (H, W)."""
    stray_e: FloatArray
    """What every pixel gets as well: modulation in each sub-exposure, then charge, shape (K + 1,)."""
    time_share: float = 1.0
    """Of the full time: the automatic exposure's."""


class Noise(NamedTuple):
    """Standard normal numbers: the pixels of row r take theirs from ``pool[starts[r]]`` on."""

    pool: Float32Array
    """Shape (P,)."""
    starts: NDArray[np.int64]
    """Shape (H,), at most P - W K."""


def convert(
    light: Light,
    noise: Noise,
    electronics: Electronics,
    *,
    samples: NDArray[np.uint16],
    full: NDArray[np.bool_],
) -> None:
    """Fill in Q1..Q4 and whether a tap of the pixel was full.

    Args:
        light: of the frame.
        noise: shot and read noise of the difference of the taps.
        electronics: the chip.
        samples: out, counts from an offset of 32768, shape (K / 4, H, W, 4).
        full: out, shape (H, W).
    """
    _convert(light, noise, electronics, samples, full)


@njit(cache=True, nogil=True, error_model="numpy")
def _convert(light, noise, electronics, samples, full):  # type: ignore[no-untyped-def]
    modulated_e, charge_e, stray_e, share = light
    pool, starts = noise
    count, height, width = modulated_e.shape
    suppression_e, full_well_e = share * electronics.suppression_e, electronics.full_well_e
    counts_per_e = 1.0 / electronics.electrons_per_count
    for row in range(height):
        normal = starts[row]
        for column in range(width):
            charge = share * (charge_e[row, column] + stray_e[count])
            sigma_e = np.sqrt(charge + electronics.read_variance_e2)
            fullest = 0.0
            for k in range(count):
                signal = share * electronics.contrast * (modulated_e[k, row, column] + stray_e[k])
                difference = signal + sigma_e * pool[normal + k]
                tap_a, tap_b = 0.5 * (charge + difference), 0.5 * (charge - difference)
                common = min(tap_a, tap_b, suppression_e)
                tap_a, tap_b = tap_a - common, tap_b - common
                fullest = max(fullest, tap_a, tap_b)
                kept = min(tap_a, full_well_e) - min(tap_b, full_well_e)
                samples[k // SAMPLES, row, column, k % SAMPLES] = int(
                    SAMPLE_OFFSET + 0.5 + kept * counts_per_e
                )
            full[row, column] = fullest >= full_well_e
            normal += count
