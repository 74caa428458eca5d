"""Lengths of the camera's methods other than ``joint``: in proportion to what is seen, and never below noise.

Where a configuration leaves a length out, it is the one with which the mock-up of the 2018 paper is tracked,
multiplied by the size of what is seen relative to the mock-up.
"""

from math import hypot
from typing import NamedTuple

MOCKUP_RADIUS_M = hypot(0.8, 0.5)
"""Distance of the mock-up's farthest corner from its origin: 0.8 m behind its front, 0.5 m from its axis."""
SIGMAS = 3.0
"""Standard deviations that cover an error of a range: one in 370 normal errors is larger."""


def relative_size(radius_m: float, range_m: float) -> float:
    """Return the size of what is seen relative to the mock-up.

    It is that of the target, or of what a camera sees of it: no lens shows more than 45 deg to each side.

    Args:
        radius_m: the target's radius.
        range_m: distance of what is seen.
    """
    return min(radius_m, range_m) / MOCKUP_RADIUS_M


def chosen(given: float | None, derived: float) -> float:
    """Return the configured length, or the derived one if it is left out."""
    return derived if given is None else given


class MatchLengths(NamedTuple):
    """Lengths of the ICP with reverse calibration, m."""

    direct_m: float
    """Distance in the first iteration up to which a depth at a model point's own pixel is its match."""
    scale_m: float
    """Geman-McClure scale in the first iteration."""
    gate_m: float
    """Largest distance of a match."""
    step_m: float
    """Motion of the surface in one step below which the iterations end."""
