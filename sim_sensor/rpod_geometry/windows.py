"""Windows of an image of pixels or rays: the rows and columns that hold what is of interest."""

import numpy as np
from numpy.typing import NDArray

Window = tuple[slice, slice]
"""A part of an image: rows and columns."""


def window_around(rays: NDArray[np.bool_], margin: tuple[int, int]) -> Window:
    """Return the smallest window with some rays and those around them; the whole image if there are none.

    Args:
        rays: the rays, shape (rows, columns).
        margin: number of rows and of columns around them.
    """
    lines = (np.flatnonzero(rays.any(axis=axis)) for axis in (1, 0))
    rows, columns = (
        slice(max(0, int(line[0]) - more), int(line[-1]) + 1 + more) if len(line) else slice(None)
        for line, more in zip(lines, margin, strict=True)
    )
    return rows, columns
