"""Drawing of one triangle on a grid of rays: which rays meet it, and at which range.

The docstring of ``rays`` derives the equations.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel
from rpod_geometry.lines import Lines, entry_of
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.types import Float32Array

TOGETHER = 16
"""Number of neighbouring rays that are tested together. Numerics: a processor's vectors; rays that remain are
tested one by one, which takes longer."""
ROUNDING = 1e-6
"""Share of the terms of a ray's test by which rounding may change their sum. Numerics: single precision, five
roundings of each term, twice."""


class Face(NamedTuple):
    """One triangle on the block of the grid that it may cover."""

    number: int
    scale: float
    """One over the absolute value of v0 . (v1 x v2), 1/m3."""
    top: int
    bottom: int
    """Last row + 1."""
    left: int
    right: int
    """Last column + 1."""


@inner_kernel
def volume_of(corner: FloatArray) -> float:
    """Return v0 . (v1 x v2), m3, of a triangle's corners in sensor axes, shape (3, 3), m."""
    x = corner[1, 1] * corner[2, 2] - corner[1, 2] * corner[2, 1]
    y = corner[1, 2] * corner[2, 0] - corner[1, 0] * corner[2, 2]
    z = corner[1, 0] * corner[2, 1] - corner[1, 1] * corner[2, 0]
    return float(corner[0, 0] * x + corner[0, 1] * y + corner[0, 2] * z)


@inner_kernel
def fill_sides(corner: FloatArray, sign: float, side: Array) -> None:
    """Fill the products v_i x v_j, m2, shape (3, 3), with signs so that s_i >= 0 for rays inside."""
    for i in range(3):
        a, b = corner[i], corner[(i + 1) % 3]
        side[i, 0] = sign * (a[1] * b[2] - a[2] * b[1])
        side[i, 1] = sign * (a[2] * b[0] - a[0] * b[2])
        side[i, 2] = sign * (a[0] * b[1] - a[1] * b[0])


@inner_kernel
def fill_half_planes(side: Array, across: float, down: float, half_planes: FloatArray) -> None:
    """Fill, for each side of a triangle, the half plane of slopes in which a ray may be within the triangle.

    A ray with the slopes X and Y is within it if a X + b Y + c >= 0 for all sides (a, b, c). A row of the
    result has a, b, c with a margin for rounding, and -1 / a.

    Args:
        side: as filled by ``fill_sides``, shape (3, 3).
        across: largest absolute slope of the columns.
        down: largest absolute slope of the rows.
        half_planes: output, shape (3, 4).
    """
    for i in range(3):
        a, b, c = np.float64(side[i, 0]), np.float64(side[i, 1]), np.float64(side[i, 2])
        half_planes[i, 0], half_planes[i, 1] = a, b
        half_planes[i, 2] = c + ROUNDING * (abs(a) * across + abs(b) * down + abs(c))
        half_planes[i, 3] = -1.0 / a


@inlined_kernel
def fill_spans(
    rows: Lines, columns: Lines, half_planes: FloatArray, face: Face, spans: NDArray[np.uint64]
) -> None:
    """Fill the first and last + 1 of the columns that may meet a triangle, for each of its rows.

    Args:
        rows: rows of the grid.
        columns: its columns.
        half_planes: as filled by ``fill_half_planes``, shape (3, 4).
        face: the triangle.
        spans: output, shape (rows, 2).
    """
    for row in range(face.top, face.bottom):
        least, most = -np.inf, np.inf
        for i in range(3):
            a, b = half_planes[i, 0], half_planes[i, 1]
            highest = max(b * rows.lower[row], b * rows.upper[row])
            bound = (highest + half_planes[i, 2]) * half_planes[i, 3]
            if a > 0.0:
                least = max(least, bound)
            elif a < 0.0:
                most = min(most, bound)
        begin = max(face.left, int(columns.first[entry_of(columns, least)]))
        end = min(face.right, int(columns.last[entry_of(columns, most)]))
        spans[row, 0], spans[row, 1] = begin, max(begin, end)


@inner_kernel
def draw(  # noqa: PLR0917
    rays: Array,
    side: Array,
    face: Face,
    spans: NDArray[np.uint64],
    inverse: Float32Array,
    triangle: NDArray[np.int32],
) -> None:
    """Assign to a triangle the rays for which it is the nearest so far, without branches, for vectorisation.

    More rays are tested than may meet the triangle: a multiple of ``TOGETHER``, if the row has as many.

    Args:
        rays: ``GridArrays.components``, shape (3, rows, columns).
        side: as filled by ``fill_sides``, shape (3, 3).
        face: the triangle.
        spans: first and last + 1 of the columns that may meet it, by row, shape (rows, 2).
        inverse: one over the range, 1/m, shape (rows, columns), input and output.
        triangle: index of the nearest triangle, same shape, input and output.
    """
    number, scale = face.number, face.scale
    a0, a1, a2 = side[0, 0], side[0, 1], side[0, 2]
    b0, b1, b2 = side[1, 0], side[1, 1], side[1, 2]
    c0, c1, c2 = side[2, 0], side[2, 1], side[2, 2]
    width, together = np.uint64(rays.shape[2]), np.uint64(TOGETHER)
    for row in range(np.uint64(face.top), np.uint64(face.bottom)):
        begin, end = spans[row, 0], spans[row, 1]
        number_of_rays = (end - begin + together - np.uint64(1)) // together * together
        if number_of_rays <= width:
            begin = min(begin, width - number_of_rays)
            end = begin + number_of_rays
        for column in range(begin, end):
            x, y, z = rays[0, row, column], rays[1, row, column], rays[2, row, column]
            s0 = a0 * x + a1 * y + a2 * z
            s1 = b0 * x + b1 * y + b2 * z
            s2 = c0 * x + c1 * y + c2 * z
            near = np.float32((s0 + s1 + s2) * scale)
            wins = (s0 >= 0.0) & (s1 >= 0.0) & (s2 >= 0.0) & (near > inverse[row, column])
            inverse[row, column] = near if wins else inverse[row, column]
            triangle[row, column] = np.int32(number) if wins else triangle[row, column]
