"""From light to counts: what the two taps of a photonic mixer make of their charge.

The taps share the charge in time with the modulation. The background suppression takes the same charge off
both, so that sunlight, which fills them alike, leaves the difference as it is and only its noise behind. What
remains in a tap is clipped at the full well, and the difference of the taps is converted.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rpod_schemas.config.pmd import SAMPLE_OFFSET, PmdConfig
from rpod_schemas.types import Float32Array


class Electronics(NamedTuple):
    """The chip in one sub-exposure, electrons."""

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


def convert(
    modulated_e: Float32Array,
    charge_e: Float32Array,
    noise: Float32Array,
    electronics: Electronics,
) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Return Q1..Q4 and whether a tap of the pixel was full.

    Args:
        modulated_e: correlation of the light with the modulation, electrons, shape (H, W, K).
        charge_e: all electrons of a sub-exposure, shape (H, W).
        noise: standard normal, shape (H, W, K): shot and read noise of the difference of the taps.
        electronics: the chip.

    Returns:
        Samples, counts from an offset of 32768, shape (H, W, K), and the flags, shape (H, W).
    """
    samples = np.empty(modulated_e.shape, np.uint16)
    full = np.empty(charge_e.shape, np.bool_)
    _convert(modulated_e, charge_e, noise, electronics, samples, full)
    return samples, full


@njit(cache=True, nogil=True, error_model="numpy")
def _convert(modulated_e, charge_e, noise, electronics, samples, full):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    height, width, count = modulated_e.shape
    for row in range(height):
        for column in range(width):
            charge = charge_e[row, column]
            sigma_e = np.sqrt(charge + electronics.read_variance_e2)
            fullest = 0.0
            for k in range(count):
                difference = (
                    electronics.contrast * modulated_e[row, column, k] + sigma_e * noise[row, column, k]
                )
                tap_a, tap_b = 0.5 * (charge + difference), 0.5 * (charge - difference)
                common = min(tap_a, tap_b, electronics.suppression_e)
                tap_a, tap_b = tap_a - common, tap_b - common
                fullest = max(fullest, tap_a, tap_b)
                kept = min(tap_a, electronics.full_well_e) - min(tap_b, electronics.full_well_e)
                samples[row, column, k] = SAMPLE_OFFSET + round(kept / electronics.electrons_per_count)
            full[row, column] = fullest >= electronics.full_well_e
