"""Look-up of the lines of a grid of rays, its columns or its rows, by their slopes x/z or y/z.

A binary search for each side of each triangle would take longer than casting the triangle's rays. A table of
evenly spaced slopes gives the approximate place of a line. If a ray points sideways or backwards, the slopes
have no bounds. Then the table has only one entry, and all lines are searched.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_schemas.arrays import FloatArray

PER_LINE = 4
"""Number of entries of the table for each line."""


class Lines(NamedTuple):
    """Columns or rows of a grid, created by ``lines_of``."""

    lower: FloatArray
    """Lower bound of the slopes of this and all following lines, shape (lines,)."""
    upper: FloatArray
    """Upper bound of the slopes of this and all previous lines, shape (lines,)."""
    first: NDArray[np.int32]
    """First line whose slopes may be in the entry or above, for each entry of the table, shape (entries,)."""
    last: NDArray[np.int32]
    """First line whose slopes are above the entry, for each entry of the table, shape (entries,)."""
    start: float
    """Slope at which the table begins."""
    per_slope: float
    """Number of entries for a unit of slope; 0 if the slopes have no bounds."""
    reach: float
    """Largest absolute slope; inf if the slopes have no bounds."""


@inner_kernel
def lines_of(lower: FloatArray, upper: FloatArray) -> Lines:
    """Return the lines with the given bounds of their slopes, as in ``Lines``, shape (lines,) each.

    Each entry also covers its neighbours, so that rounding does no harm.
    """
    return finer_lines_of(lower, upper, PER_LINE)


@inner_kernel
def finer_lines_of(lower: FloatArray, upper: FloatArray, per_line: int) -> Lines:
    """Return ``lines_of`` with ``per_line`` entries of the table for each line; bounds of shape (lines,)."""
    count = lower.size
    start, width = 0.0, upper[count - 1] - lower[0] if count else 0.0
    if not 0.0 < width < np.inf:
        first, last = np.zeros(4, np.int32), np.full(4, count, np.int32)
        return Lines(lower, upper, first, last, start, 0.0, np.inf)
    start, entries = lower[0], per_line * count
    first, last = np.zeros(entries + 4, np.int32), np.full(entries + 4, count, np.int32)
    i, j = 0, 0
    for n in range(entries + 1):
        slope = start + width * n / entries
        while i < count and upper[i] < slope:
            i += 1
        while j < count and lower[j] <= slope:
            j += 1
        first[n + 1] = i
        if n >= 2:
            last[n - 2] = j
    first[entries + 2 :] = first[entries + 1]
    return Lines(lower, upper, first, last, start, entries / width, max(abs(start), abs(start + width)))


@inlined_kernel
def entry_of(lines: Lines, slope: float) -> int:
    """Return the entry of the table that holds a slope, the first or last one for slopes outside."""
    return int(min(max(0.0, (slope - lines.start) * lines.per_slope), lines.first.size - 3.0))


@inlined_kernel
def first_line(lines: Lines, least: float) -> int:
    """Return the first line that may have a slope of ``least`` or more; the number of lines if none has."""
    line = int(lines.first[entry_of(lines, least)])
    while line < lines.upper.size and lines.upper[line] < least:
        line += 1
    return line


@inlined_kernel
def end_line(lines: Lines, most: float) -> int:
    """Return the last line + 1 that may have a slope of ``most`` or less; 0 if none has."""
    line = int(lines.last[entry_of(lines, most)])
    while line > 0 and lines.lower[line - 1] > most:
        line -= 1
    return line


@inlined_kernel
def slopes_of(corner: FloatArray, axis: int) -> tuple[float, float]:
    """Return the least and the largest slope of the part of a triangle that is in front of the sensor.

    Args:
        corner: corners of the triangle, sensor axes, shape (3, 3), m.
        axis: coordinate that is divided by z: 0 for the slopes of columns, 1 for those of rows.
    """
    if corner[0, 2] > 0.0 and corner[1, 2] > 0.0 and corner[2, 2] > 0.0:
        one, two = corner[0, axis] / corner[0, 2], corner[1, axis] / corner[1, 2]
        three = corner[2, axis] / corner[2, 2]
        least, most = min(one, two, three), max(one, two, three)
    else:
        least, most = _slopes_in_part(corner, axis)
    return least, most


@inner_kernel
def _slopes_in_part(corner: FloatArray, axis: int) -> tuple[float, float]:
    """Return the slopes of ``slopes_of`` for a triangle that may be partly behind the sensor.

    Args:
        corner: corners of the triangle, sensor axes, shape (3, 3), m.
        axis: as for ``slopes_of``.
    """
    least, most = np.inf, -np.inf
    for i in range(3):
        j = (i + 1) % 3
        low, high = slopes_ahead(corner[i, axis], corner[i, 2], corner[j, axis], corner[j, 2])
        least, most = min(least, low), max(most, high)
    return least, most


@kernel
def slopes_ahead(a: float, a_z: float, b: float, b_z: float) -> tuple[float, float]:
    """Return the least and largest slope x/z, or y/z, of the part of a line that is in front of the sensor.

    If a line crosses the plane z = 0 at x > 0, its slopes in front of it extend to infinity, at x < 0 to
    minus infinity. The slopes of a triangle are between those of its sides. The result is inf, -inf for a
    line behind the sensor: only rays that point backwards can meet it, and their slopes have no bounds.

    Args:
        a: x or y of one end, m.
        a_z: its z, m.
        b: x or y of the other end, m.
        b_z: its z, m.
    """
    if a_z > 0.0 and b_z > 0.0:
        one, other = a / a_z, b / b_z
        return min(one, other), max(one, other)
    if not (a_z > 0.0 or b_z > 0.0):
        return np.inf, -np.inf
    slope, passes = (a / a_z, b * a_z - a * b_z) if a_z > 0.0 else (b / b_z, a * b_z - b * a_z)
    return (slope if passes > 0.0 else -np.inf), (slope if passes < 0.0 else np.inf)
