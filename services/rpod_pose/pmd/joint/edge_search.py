"""Search for an edge in an amplitude image: the steepest change along the normal of the projected edge.

Near changes are preferred, and a parabola gives the place with subpixel accuracy (after T. Drummond, R.
Cipolla, Real-Time Visual Tracking of Complex Structures, IEEE PAMI 24(7), 2002).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

SHORTEST = 1e-9
"""Least length in the image of a projected unit vector along an edge, over the focal length. Numerics: it
avoids a division by zero; an edge seen from its end has no direction."""
MOST_REACH = 32
"""Largest length of a profile in each direction, px. Numerics: a budget of computation."""
FLAT = 0.02
"""Least range of amplitudes along a profile that can be searched, over the least change that counts. Hand:
the range by noise is larger, that in saturated and dark areas is smaller."""
NOT_SATURATED = np.zeros((0, 0), np.uint8)
"""Mask of an image without saturated pixels."""
NO_PHASE = np.empty(0)
"""Stands for an image whose modulation frequencies are unknown."""
MIDDLE = 2
"""Half length of the middle of a profile, px. Hand: an edge in its predicted place lies in this part."""


class Lens(NamedTuple):
    """A camera's matrix and distortion (plumb_bob or rational_polynomial, as in CameraInfo)."""

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0


class EdgeArrays(NamedTuple):
    """Samples of the target's edges in the form that the kernels take (``edge_model.EdgeModel``)."""

    places_m: FloatArray
    """Positions of the samples, target axes, shape (N, 3)."""
    directions: FloatArray
    """Unit vectors along the edges, target axes, shape (N, 3)."""
    normals: FloatArray
    """Normals of the faces on both sides, target axes, shape (N, 2, 3)."""
    spreads: FloatArray
    """Standard deviations of the logarithms of the faces' albedos, shape (N, 2)."""

    def thinned(self, every: int) -> "EdgeArrays":
        """Return every n-th sample."""
        return self if every == 1 else EdgeArrays(*(array[::every].copy() for array in self))


class CoarsePixels(NamedTuple):
    """Positions in the image of the coarse pixels: every ``stride``-th one along rows and columns."""

    stride: int
    """Distance from one coarse pixel to the next, px, at least 1."""
    offset: int
    """Row and column of the first coarse pixel, px."""


class Patch(NamedTuple):
    """The part of an amplitude image in which edges are searched."""

    image: Float32Array
    """Smoothed amplitude, clipped before it is smoothed, shape (rows, columns)."""
    unclipped: Float32Array
    """The same without the clip."""
    column: float
    """Column of its first pixel."""
    row: float
    """Row of its first pixel."""
    least: float
    """Least change of amplitude over two pixels that counts as an edge."""
    noise: float
    """Standard deviation of a change of amplitude over two pixels."""
    typical: float
    """Median amplitude of the target; 0 if no edge is searched."""
    saturated: NDArray[np.uint8] = NOT_SATURATED
    """1 where saturated pixels shift edges, shape (rows, columns); shape (0, 0) if none is saturated."""
    unranged: NDArray[np.uint8] = NOT_SATURATED
    """1 where no range is measured, shape (rows, columns); shape (0, 0) if that is unknown."""
    rad_per_m: FloatArray = NO_PHASE
    """Phase of light over the range of what it returns from, by modulation frequency, shape (F,), rad/m;
    shape (0,) if the camera states no frequency."""


class Imaged(NamedTuple):
    """Pixel to which slopes x / z and y / z are projected, and its derivatives with respect to them, px."""

    column: float
    row: float
    column_by_x: float
    column_by_y: float
    row_by_x: float
    row_by_y: float


class Profile(NamedTuple):
    """A line in the image along which edges are searched."""

    column: float
    """Column of its middle."""
    row: float
    """Row of its middle."""
    across: float
    """Component of its direction along the columns."""
    down: float
    """Component of its direction along the rows."""


class Step(NamedTuple):
    """The steepest change along a line."""

    place: float
    """Position along the line, relative to its middle, px."""
    change: float
    """Change of amplitude over two pixels; 0 if none is large enough, -1 if the line cannot be searched."""


@kernel
def imaged(x: float, y: float, lens: Lens) -> Imaged:
    """Return the pixel to which the slopes x / z and y / z are projected, and its derivatives.

    Source: the rational model of OpenCV's camera calibration, of which plumb_bob is a part; derivatives by
    the product and quotient rules, with d r^2 = 2 x dx + 2 y dy.
    """
    k1, k2, p1, p2, k3 = lens.k1, lens.k2, lens.p1, lens.p2, lens.k3
    k4, k5, k6 = lens.k4, lens.k5, lens.k6
    r2 = x * x + y * y
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / below
    slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))
    growth = 2.0 * slope / below
    column = lens.fx * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + lens.cx
    row = lens.fy * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + lens.cy
    across = growth * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    xx = radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    yy = radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return Imaged(column, row, lens.fx * xx, lens.fx * across, lens.fy * across, lens.fy * yy)


@inner_kernel
def across_edge(at: Imaged, towards: tuple[float, float, float], x: float, y: float) -> tuple[float, float]:
    """Return the unit vector across a projected edge in the image; 0, 0 for an edge seen from its end.

    Args:
        at: the pixel of a sample of the edge, with its derivatives.
        towards: unit vector along the edge, sensor axes.
        x: slope x / z of the sample.
        y: slope y / z of the sample.
    """
    bx, by, bz = towards
    mx, my = bx - x * bz, by - y * bz
    tu, tv = at.column_by_x * mx + at.column_by_y * my, at.row_by_x * mx + at.row_by_y * my
    length = np.sqrt(tu * tu + tv * tv)
    if not length > SHORTEST * at.column_by_x:
        return 0.0, 0.0
    return -tv / length, tu / length


@kernel
def steepest(image: Float32Array, line: Profile, reach: float, least: float) -> Step:
    """Return the position and size of the steepest change along a line.

    A line cannot be searched if it leaves the image, is dark in its middle, or is clipped along its length.

    Args:
        image: shape (rows, columns).
        line: line to search.
        reach: half length of the search, px, at most ``MOST_REACH``.
        least: least change that counts.
    """
    if not reach >= 0.0:
        return Step(0.0, -1.0)
    column, row, across, down = line
    most = int(min(reach, MOST_REACH)) + 2
    rows, columns = image.shape
    far_column, far_row = most * abs(across) + 1.0, most * abs(down) + 1.0
    inside = far_column <= column < columns - 1.0 - far_column and far_row <= row < rows - 1.0 - far_row
    if not inside:
        return Step(0.0, -1.0)
    lowest, highest, brightest = np.inf, -np.inf, 0.0
    one, two, three, four, five = 0.0, 0.0, 0.0, 0.0, 0.0  # the last five places of the line
    best, place, change, before, after = 0.0, 0, 0.0, 0.0, 0.0
    width = 0.5 * reach + 1.0
    for k in range(-most, most + 1):
        one, two, three, four = two, three, four, five
        five = bilinear(image, column + k * across, row + k * down)
        lowest, highest = min(lowest, five), max(highest, five)
        if abs(k) <= MIDDLE:
            brightest = max(brightest, five)
        here, previous, following = abs(four - two), abs(three - one), abs(five - three)
        if k >= 4 - most and here >= least and here >= previous and here >= following:
            score = here / (1.0 + ((k - 2) / width) ** 2)
            if score > best:
                best, place, change, before, after = score, k - 2, here, previous, following
    if highest - lowest < FLAT * least or brightest < FLAT * least:
        return Step(0.0, -1.0)
    if best == 0.0:
        return Step(0.0, 0.0)
    bend = before - 2.0 * change + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return Step(place + shift, change)


@inlined_kernel
def bilinear(image: Float32Array, column: float, row: float) -> float:
    """Return the value of an image, shape (rows, columns), at a place that is not on its last row or column.

    Args:
        image: the image.
        column: column, at least 0.
        row: row, at least 0.
    """
    j, i = (
        np.uint32(column),
        np.uint32(row),
    )  # an index without a sign is not checked for counting from the end
    a, b = column - j, row - i
    one = np.uint32(1)
    first, second = image[i, j], image[i + one, j]
    upper = first + a * (image[i, j + one] - first)
    lower = second + a * (image[i + one, j + one] - second)
    return float(upper + b * (lower - upper))
