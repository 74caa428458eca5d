"""Distances beyond one frequency's unambiguous range, from two frequencies.

A distance at frequency f is known modulo c / 2f. Whole turns are added to two such distances so that they
agree best. At 20.013 and 30 MHz the second best combination differs by 2.49 m. At 14.98 m both frequencies
begin a turn at the same distance; a distance beyond is measured 14.98 m too short, and the samples do not
show it.
"""

from typing import NamedTuple

import numpy as np
from scipy import constants

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.config.pmd import PmdConfig


class Turns(NamedTuple):
    """Unambiguous ranges of two frequencies, and their differences."""

    first_m: float
    """Unambiguous range c / 2f of the first frequency."""
    second_m: float
    """Unambiguous range c / 2f of the second frequency."""
    number: int
    """Number of turns of the first frequency until both begin a turn at the same distance."""
    half_gap_m: float
    """Half the least difference between two ways to unwrap."""
    first_weight: float
    """Weight of the first distance in the mean: the noise of a distance is proportional to c / 2f."""

    @classmethod
    def of(cls, config: PmdConfig) -> "Turns":
        """Return the turns of a camera; with one frequency, both are that one."""
        frequencies_hz = config.frequencies_hz
        first_m, second_m = (constants.c / (2.0 * hz) for hz in (frequencies_hz[0], frequencies_hz[-1]))
        number = round(config.unambiguous_range_m / first_m)
        starts_m = np.sort(np.arange(number) * first_m % second_m)
        gap_m = np.diff(starts_m, append=starts_m[0] + second_m).min()
        return cls(first_m, second_m, number, 0.5 * float(gap_m), second_m**2 / (first_m**2 + second_m**2))


def unwrap(first_m: Array, second_m: Array, config: PmdConfig) -> tuple[FloatArray, FloatArray]:
    """Return distances over the unambiguous range of two frequencies.

    Args:
        first_m: radial distances, m, modulo c / 2f (Eq. 2) of the first frequency, any shape.
        second_m: radial distances of the second frequency, same shape.
        config: configuration of the camera, profile dual.

    Returns:
        The distances modulo ``config.unambiguous_range_m``, and the disagreement of the two, as a share of
        half the least difference between two ways to unwrap them.
    """
    distance_m = np.empty(np.shape(first_m))
    disagreement = np.empty_like(distance_m)
    _unwrap(np.ravel(first_m), np.ravel(second_m), Turns.of(config), distance_m.ravel(), disagreement.ravel())
    return distance_m, disagreement


@kernel
def _unwrap(
    first_m: FloatArray, second_m: FloatArray, turns: Turns, distance_m: FloatArray, disagreement: FloatArray
) -> None:
    """Fill distances and disagreements, shape (N,) each, like ``unwrap``."""
    for index in range(first_m.size):
        distance_m[index], disagreement[index] = unwrap_pixel(first_m[index], second_m[index], turns)


@inner_kernel
def unwrap_pixel(first_m: float, second_m: float, turns: Turns) -> tuple[float, float]:
    """Return the distance and the disagreement of one pixel, like ``unwrap``."""
    least_m, near_m, other_m = np.inf, 0.0, 0.0
    for turn in range(turns.number):
        one_m = first_m + turn * turns.first_m
        two_m = second_m + np.floor((one_m - second_m) / turns.second_m + 0.5) * turns.second_m
        if abs(one_m - two_m) < least_m:
            least_m, near_m, other_m = abs(one_m - two_m), one_m, two_m
    mean_m = near_m + (1.0 - turns.first_weight) * (other_m - near_m)
    return mean_m % (turns.number * turns.first_m), least_m / turns.half_gap_m
