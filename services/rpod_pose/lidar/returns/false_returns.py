"""Returns that no surface gave, such as those of sunlight, stray light or dark counts.

They come from any ray and at any range, each one alone. Most returns of a surface have neighbours: those of
neighbouring rays lie on the same surface. A thin part may give returns that stand alone too. How often that
happens, the target itself shows: a share f of the returns that agree with a pose stands alone. If c returns
that contradict the pose have neighbours, at most (c + ``UNSEEN``) f / (1 - f) of those that contradict it
alone are expected to be a surface's. The others are false, and say nothing about the pose.

At a wrong pose the contradicting returns are those of the target's own surfaces, so that most of them have
neighbours. In a scan of few returns many stand alone, and none of them is called false.
"""

from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from rpod_pose.lidar.scan_view import SeenScan
from rpod_schemas.arrays import FloatArray

STEEP = 5.8
"""Depth between returns of neighbouring rays over the distance of these rays. Physics: a surface that is met
at 80 deg from its normal."""
SURE = 0.95
"""Probability with which a share is below its limit. Physics: the usual one-sided interval."""
UNSEEN = 3.0
"""Limit of the expected number of events of which none was seen. Physics: that of a Poisson distribution, for
the probability ``SURE``."""


class Lone(NamedTuple):
    """Returns of a scan that contradict a pose and stand alone."""

    places: NDArray[np.intp]
    """Their rows and columns, shape (N, 2)."""
    of_surfaces: int
    """Largest number of them that a surface may have given; all others are false."""


def lone_returns(seen: SeenScan, agreeing: NDArray[np.bool_]) -> Lone:
    """Return the returns of a scan that contradict a pose and stand alone.

    Args:
        seen: the scan.
        agreeing: mask of the returns that agree with the pose, shape (rows, columns).
    """
    measured = seen.range_m > 0.0
    alone = measured & ~_with_neighbour(seen.grid.directions, seen.range_m, measured)
    contradicting = measured & ~agreeing
    places = np.argwhere(contradicting & alone)
    count, lone = np.count_nonzero(agreeing), np.count_nonzero(agreeing & alone)
    if lone == count:
        return Lone(places, len(places))
    share = float(betaincinv(lone + 1, count - lone, SURE))
    of_surfaces = (np.count_nonzero(contradicting & ~alone) + UNSEEN) * share / (1.0 - share)
    return Lone(places, min(len(places), ceil(of_surfaces)))


def _with_neighbour(
    directions: FloatArray, range_m: FloatArray, measured: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the mask of the returns of which a neighbour may lie on the same surface.

    Args:
        directions: unit vectors of the rays, shape (rows, columns, 3).
        range_m: ranges, shape (rows, columns).
        measured: mask of the rays with a return, shape (rows, columns).
    """
    found = np.zeros(measured.shape, np.bool_)
    rows, columns = measured.shape
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = np.s_[: rows - down, max(0, -right) : columns - max(0, right)]
        other = np.s_[down:, max(0, right) : columns + min(0, right)]
        spacing = np.linalg.norm(directions[one] - directions[other], axis=-1)
        deep_m = STEEP * spacing * np.minimum(range_m[one], range_m[other])
        near = measured[one] & measured[other] & (np.abs(range_m[one] - range_m[other]) <= deep_m)
        found[one] |= near
        found[other] |= near
    return found
