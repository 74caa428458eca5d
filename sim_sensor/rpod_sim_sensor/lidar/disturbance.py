"""Disturbed returns of a LIDAR: mixed at edges, reflected twice, or from stray light."""

import numpy as np
from numpy.random import Generator

from rpod_schemas.arrays import FloatArray
from rpod_sim_sensor.worlds import LidarWorld

_APART_M = 0.1
"""Largest distance of two surfaces that give one common echo."""
_STEEPEST = 0.05
"""Least cosine of incidence in the spread of a beam on a plane."""
_FALSE_SPREAD = 0.5, 1.5
"""Limits of the uniformly distributed false ranges, as multiples of the median of the true ranges."""


def mixed(
    middle: tuple[FloatArray, FloatArray, FloatArray],
    beside: tuple[FloatArray, FloatArray, FloatArray],
    world: LidarWorld,
    generator: Generator,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the range, cosine of incidence and reflectivity that rays with a wide beam measure.

    Args:
        middle: range, cosine of incidence and reflectivity at the beam's middle, NaN where it meets nothing,
            shape (rows, columns) each.
        beside: range, cosine and reflectivity at the beam's rim.
        world: share of rays that are mixed.
        generator: random numbers of the frame's disturbances.
    """
    shape = middle[0].shape
    chosen, weight = generator.random(shape) < world.mixed_share, generator.random(shape)
    outside, inside = np.isnan(middle[0]), np.isfinite(beside[0])
    aside_m = world.footprint_rad * middle[0]  # on one steep plane ranges differ as well
    slant_m = aside_m * np.sqrt(1.0 - middle[1] ** 2) / np.maximum(middle[1], _STEEPEST)
    apart = np.abs(middle[0] - beside[0]) > _APART_M + slant_m
    between = chosen & ~outside & inside & apart
    grazed = chosen & outside & inside
    range_m, cosine, reflectivity = (
        np.where(grazed, rim, np.where(between, weight * mid + (1.0 - weight) * rim, mid))
        for mid, rim in zip(middle, beside, strict=True)
    )
    # Half of the beam's light misses the target.
    return range_m, cosine, np.where(grazed, 0.5 * reflectivity, reflectivity)


def bounced(range_m: FloatArray, world: LidarWorld, generator: Generator) -> FloatArray:
    """Return ranges, m, in their shape, some of which are too long by a second reflection."""
    late = generator.random(range_m.shape) < world.bounced_share
    return range_m + np.where(late, generator.exponential(world.detour_m, range_m.shape), 0.0)


def false_m(range_m: FloatArray, world: LidarWorld, generator: Generator) -> FloatArray:
    """Return ranges of stray light, m, for some rays without a range, NaN for all others, in their shape."""
    shape = range_m.shape
    strays = (generator.random(shape) < world.false_share) & np.isnan(range_m)
    middle_m = float(np.nanmedian(range_m)) if np.isfinite(range_m).any() else np.nan
    return np.where(strays, middle_m * generator.uniform(*_FALSE_SPREAD, shape), np.nan)
