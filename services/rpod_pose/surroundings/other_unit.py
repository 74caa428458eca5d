"""Units of the depth in which a larger thing in a frame would be of the target's size.

If a driver gives its depths in another unit than the configuration states, the target appears larger by the
ratio of both units, and a part of it may look like the target. An arm that holds the target, or a wall that
touches it, makes a larger thing too, but this thing looks like the target in no other unit.

A room is not tested: it reaches opposite borders of the image, so that its size is unknown. If its ranges
were divided by ten, it would lie within a few times their noise, and any face of the target would explain it.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_pose.surroundings.places import LEAST_SIZE, at_border, spans_view, surfaces
from rpod_pose.surroundings.separation import BALL, RangeImage
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

_UNITS_M = 1.0, 1e-3, 2.5e-4, 1e-4
"""Units in which drivers give depths, m. Physics: those of REP 118 (32FC1, 16UC1), and finer steps of devices
(RealSense)."""
_RATIOS = sorted({one / other for one in _UNITS_M for other in _UNITS_M if one > other})


class OtherUnit(NamedTuple):
    """A unit in which a thing would be of the target's size."""

    ratio: float
    """Factor by which the depths would be too large."""
    thing: NDArray[np.bool_]
    """Rays on the thing, shape (rows, columns)."""


def other_units(image: RangeImage, radius_m: float, place_m: FloatArray) -> Iterator[OtherUnit]:
    """Yield units in which the thing around a place has the target's size; none if it has it already.

    Args:
        image: ranges of a frame.
        radius_m: radius of the target's bounding sphere.
        place_m: position of a pose that was found, sensor axes, shape (3,).
    """
    measured, points_m = image.range_m > 0.0, image.points_m
    around = measured & (np.linalg.norm(points_m - place_m, axis=-1) < radius_m)
    for ratio in _RATIOS:
        # how a frame divides into things depends on the size: take the target's size in this unit
        every = surfaces(nearer(image, ratio), measured, radius_m)
        things = sorted(every, key=lambda rays: -np.count_nonzero(rays & around))[:1]
        if len(every) > 1 and not at_border(whole := np.logical_or.reduce(every)):
            things.append(whole)  # a part without a visible joint to the others stands apart
        for thing in things:
            if spans_view(thing):
                continue
            extent_m = np.linalg.norm(points_m[thing] - np.median(points_m[thing], axis=0), axis=1)
            most_m, usual_m = float(extent_m.max()), float(np.quantile(extent_m, 0.98))
            fits = LEAST_SIZE * radius_m <= most_m / ratio and usual_m / ratio <= BALL * radius_m
            if fits and usual_m > BALL * radius_m:
                yield OtherUnit(ratio, thing)
                break


def nearer(image: RangeImage, ratio: float) -> RangeImage:
    """Return an image whose ranges are divided by a ratio."""
    range_m: Float32Array = (image.range_m / np.float32(ratio)).astype(np.float32)
    return replace(image, range_m=range_m)
