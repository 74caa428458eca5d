"""Rows and columns of a scan that never have a return between others that do: gaps, or dead channels.

A dead channel gives no return wherever the target is, and its rays say nothing. A gap of the target gives
none either, and its rays are part of the outline; so do rays that pass between the target and another body.
A scan does not tell which it is, nor do several of a target that stands still. So the lines are named for the
operator, who may look at the sensor, and nothing else follows from them. Lines beside all returns, as those
that see only sky, are not named.
"""

from collections import deque
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rpod_schemas.types import Float32Array

_SCANS, _LEAST_SCANS = 8, 3
"""Number of the last scans that are compared, and from which on lines are named. Hand: about a second of a
LIDAR, so that a row which returns again is soon left out. Each eighth scan they are compared anew."""
_LEAST_RAYS = 10
"""Least number of rays of an empty line, in all compared scans, with a return on both sides. Physics: a live
line of which half of the rays are lost has none of ten by chance in one of 1000 cases."""


class EmptyLines:
    """Follows which rows and columns of one sensor's organised scans have returns."""

    def __init__(self) -> None:
        self._returned: deque[NDArray[np.bool_]] = deque(maxlen=_SCANS)
        self._scans = 0
        self.text = ""
        """Empty lines with the remedy, for the operator; empty if there are none."""

    def add(self, points_m: Float32Array) -> None:
        """Take the points of a scan, shape (rows, columns, 3), m; NaN or the origin without one."""
        x_m, z_m = points_m[..., 0], points_m[..., 2]
        returned = np.isfinite(x_m) & ((x_m != 0.0) | (z_m != 0.0))
        if self._returned and self._returned[-1].shape != returned.shape:
            self._returned.clear()
            self._scans = 0
        self._returned.append(returned)
        self._scans += 1
        if self._scans <= _SCANS or self._scans % _SCANS == 0:
            self.text = self._describe()

    def rows(self) -> list[int]:
        """Return the rows without a return between rows that have some in the same columns."""
        return self._empty(1)

    def columns(self) -> list[int]:
        """Return the columns without a return between columns that have some in the same rows."""
        return self._empty(2)

    def _empty(self, axis: int) -> list[int]:
        if len(self._returned) < _LEAST_SCANS:
            return []
        returned = np.moveaxis(np.stack(self._returned), axis, 0)
        alive = np.flatnonzero(returned.any(axis=(1, 2)))
        ends = pairwise(alive)
        return [
            int(line)
            for first, last in ends
            if last - first > 1 and np.count_nonzero(returned[first] & returned[last]) >= _LEAST_RAYS
            for line in range(first + 1, last)
        ]

    def _describe(self) -> str:
        return "; ".join(
            f"{len(lines)} {name if len(lines) == 1 else f'{name}s'} had no return in {len(self._returned)} "
            f"scans, between {name}s that had: gaps in or beside the target, or dead channels, which count "
            f"as misses; if they are dead, write dead_{name}s: {lines} for the sensor into the file of "
            "surroundings"
            for name, lines in (("row", self.rows()), ("column", self.columns()))
            if lines
        )
