"""Metering of a frame's light: its mean, and the exposure time.

The exposure time depends only on the light of the same frame, before any noise. So a frame depends neither on
the order in which frames are emulated, nor on frames that are left out.
"""

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import kernel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.config.pmd import PmdConfig
from rpod_schemas.types import Float32Array
from rpod_sim_sensor.pmd.pixel import Electronics

_METERED = 4
"""Stride of the rows and columns that are metered."""


def mean_light_e(modulated_e: Float32Array, charge_e: Float32Array) -> FloatArray:
    """Return the image's mean modulation in each sub-exposure, then its mean charge, electrons, (K + 1,)."""
    return np.append(modulated_e.mean(axis=(1, 2)), charge_e.mean()).astype(float)


def exposure_share(
    modulated_e: Float32Array, charge_e: Float32Array, config: PmdConfig, electronics: Electronics
) -> float:
    """Return the share of the profile's time at which few lit pixels lose depth: a power of 1 / sqrt(2).

    A pixel is lit if it has a depth at some time between the profile's and the shortest.

    Args:
        modulated_e: correlation of the light with the modulation in the full time, shape (K, H, W).
        charge_e: all electrons of a sub-exposure in the full time, shape (H, W).
        config: configuration of the camera.
        electronics: the chip at the full time.
    """
    if config.exposure == "fixed":
        return 1.0
    control = config.automatic_exposure
    changes = np.zeros(control.half_stops + 2, np.int64)
    limits_e = config.reconstruction.least_amplitude_e, control.full_well_share * electronics.full_well_e
    lit = _meter(modulated_e, charge_e, electronics, limits_e, changes)
    kept = np.cumsum(changes)[:-1]
    half_stops = int(np.argmax(kept >= kept.max() - control.loss_share * lit))
    return float(2.0 ** (-0.5 * half_stops))


@kernel
def _meter(
    modulated_e: Float32Array,
    charge_e: Float32Array,
    electronics: Electronics,
    limits_e: tuple[float, float],
    changes: NDArray[np.int64],
) -> int:
    """Store the half stops at which each pixel stops saturating and becomes too dark; return the lit ones.

    The light has the shape (K, H, W); changes, shape (half stops + 2,), counts the pixels that change there.
    """
    count, height, width = modulated_e.shape
    least_e, most_e = limits_e
    lit = 0
    for row in range(0, height, _METERED):
        for column in range(0, width, _METERED):
            strongest = 0.0
            for k in range(count):
                strongest = max(strongest, abs(modulated_e[k, row, column]))
            difference = electronics.contrast * strongest
            if difference < least_e:
                continue
            common = 0.5 * (charge_e[row, column] - difference)
            fullest = difference + max(common - electronics.suppression_e, 0.0)
            first = max(int(np.ceil(2.0 * np.log2(fullest / most_e))), 0)
            last = int(np.floor(2.0 * np.log2(difference / least_e)))
            if first <= last and first < changes.size - 1:
                lit += 1
                changes[first] += 1
                changes[min(last + 1, changes.size - 1)] -= 1
    return lit
