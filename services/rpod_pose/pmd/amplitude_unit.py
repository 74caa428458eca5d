"""The unit of an amplitude image: methods get counts, whatever a driver sends.

Methods compare amplitudes with each other, and with one count: the least amplitude that an image of integers
shows beside 0. A driver may send amplitudes of another unit as floats, for example from 0 to 1, in which one
count would be brighter than the target.
"""

from math import frexp, ldexp

import numpy as np

from rpod_schemas.arrays import Array
from rpod_schemas.types import PmdFrame

TYPICAL_BITS = 10
"""Bits of the typical amplitude of an image in counts. Numerics: a camera's image has 8 to 16 bits."""
STRIDE = 3
"""Stride of the pixels that give the typical amplitude. Numerics: it needs no more than a power of 2."""


def in_counts(frame: PmdFrame) -> PmdFrame:
    """Return a frame whose amplitudes are counts: integers, or floats that are typically below 1,024.

    Floats are multiplied by a power of 2, which changes no digit. Whole numbers are counts already.
    """
    sparse = slice(None, None, STRIDE), slice(None, None, STRIDE)
    if frame.amplitude is None or frame.amplitude.dtype.kind != "f":
        return frame
    some = frame.amplitude[sparse][frame.depth_m[sparse] > 0.0]
    some = some[some > 0.0]
    if not some.size or np.array_equal(some, np.floor(some)):
        return frame
    shift = TYPICAL_BITS - frexp(float(np.median(some)))[1]
    if not shift:
        return frame
    amplitude = np.asarray(frame.amplitude * np.float32(ldexp(1.0, shift)), np.float32)
    amplitude.setflags(write=False)  # as from the bus
    return frame.model_copy(update={"amplitude": amplitude})


def least_count(amplitude: Array, typical: float) -> float:
    """Return one count of an image: 1 for integers, else a small share of its typical amplitude.

    Args:
        amplitude: amplitudes, any shape.
        typical: typical amplitude of the target.
    """
    if amplitude.dtype.kind != "f":
        return 1.0
    return max(ldexp(typical, -TYPICAL_BITS), float(np.finfo(np.float32).tiny))
