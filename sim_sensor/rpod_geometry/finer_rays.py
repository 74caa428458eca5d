"""More rays in the pixels that show edges, tested against the triangles around them alone.

A few rays for each pixel tell the place of an edge only to their distance. Rays that are cast through the
whole target take too long. So the rays of a pixel are tested against the triangles that coarser rays in and
around it meet. A ray that meets none of them may meet a smaller triangle. The surface is followed beyond the
sides that the ray lies across, as long as it faces the sensor. Where all coarser rays in and around a pixel
meet the target, a ray that still meets none has the hit of the nearest of them: no sky is seen there.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inlined_kernel, inner_kernel
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.types import Float32Array

SAMPLES = 4
"""Number of rays along rows and columns of a pixel. Numerics: no two are in one row or column, so that they
tell the place of an edge along either to a sixteenth of a pixel."""
MOST_TRIED = 32
"""Largest number of triangles against which the rays of a pixel are tested. Numerics: a budget, twice the
number of coarser rays in and around a pixel that has four; a ray that meets none of them counts as sky."""


class Surface(NamedTuple):
    """The target at a pose; its triangles are numbered as in the coarser rays' hits."""

    triangles_m: FloatArray
    """Corners, target axes, shape (T, 3, 3)."""
    beyond: NDArray[np.int32]
    """Triangle beyond each side of each triangle, -1 where the surface ends, shape (T, 3)."""
    R: FloatArray
    """R_sensor_target, shape (3, 3)."""
    t: FloatArray
    """Position of the target, sensor axes, shape (3,), m."""


class FinerHits(NamedTuple):
    """First hits of the ``SAMPLES`` x ``SAMPLES`` rays of P pixels."""

    triangle: NDArray[np.int32]
    """Index of the triangle, shape (P, SAMPLES^2), -1 without a hit."""
    inverse: Float32Array
    """One over the range, 1/m, same shape; 0 without a hit."""


@inner_kernel
def finer_hits(
    rays: Array, triangle: NDArray[np.int32], per_px: int, pixels: NDArray[np.int32], surface: Surface
) -> FinerHits:
    """Return the first hits of more rays in some pixels.

    Args:
        rays: coarser unit rays, sensor axes, shape (3, per_px * rows, per_px * columns).
        triangle: triangle that each of them meets, -1 for none, shape (per_px * rows, per_px * columns).
        per_px: number of coarser rays for each pixel, along rows and columns.
        pixels: row and column of P pixels, shape (P, 2).
        surface: the target.
    """
    number = SAMPLES * SAMPLES
    order = np.arange(number)
    down = ((order + 0.5) / number - 0.5).astype(np.float32)
    across = ((order % SAMPLES * SAMPLES + order // SAMPLES + 0.5) / number - 0.5).astype(np.float32)
    met = np.full((len(pixels), number), -1, np.int32)
    inverse = np.zeros((len(pixels), number), np.float32)
    sides, facing = _sides_of(surface)
    beyond, listed = surface.beyond, np.full(len(facing), -1, np.int32)
    tried, middle, linear = np.empty(MOST_TRIED, np.int32), np.empty(9), np.empty(9, np.float32)
    for p in range(len(pixels)):
        around = _around(triangle.shape, per_px * pixels[p, 0], per_px * pixels[p, 1], per_px)
        _fill_middle(rays, around, per_px, middle)
        coarse = _met(triangle, around, p, listed, tried)
        for m in range(coarse):
            _fill_linear(sides, tried[m], middle, linear)
            _test(linear, tried[m], down, across, met, inverse, p)
        count, m = coarse, 0 if _missed(met, p) else coarse
        while m < count:
            k = tried[m]
            _fill_linear(sides, k, middle, linear)
            if m >= coarse:
                _test(linear, k, down, across, met, inverse, p)
            crossed = _crossed(linear, down, across, met, p)
            for side in range(3):
                other = beyond[k, side]
                further = crossed & (1 << side) and other >= 0 and facing[other]
                if further and listed[other] != p and count < MOST_TRIED:
                    tried[count], listed[other] = other, p
                    count += 1
            m += 1
        if _missed(met, p):
            lines, places = (sides, middle, linear), (down, across)
            _fill_covered(triangle, around, per_px, lines, places, (met, inverse), p)
    return FinerHits(met, inverse)


class _Around(NamedTuple):
    """The coarser rays in and around a pixel."""

    top: int
    bottom: int
    """Last row."""
    left: int
    right: int
    """Last column."""
    down: float
    """Row of the pixel's middle, relative to the first row, px."""
    across: float
    """Column of the pixel's middle, relative to the first column, px."""


@inlined_kernel
def _around(shape: tuple[int, int], row: int, column: int, per_px: int) -> _Around:
    """Return the rays in and around a pixel whose first ray is given by its row and column."""
    top, left, middle = max(row - 1, 0), max(column - 1, 0), (per_px - 1) / 2.0
    bottom, right = min(row + per_px, shape[0] - 1), min(column + per_px, shape[1] - 1)
    return _Around(top, bottom, left, right, (row - top + middle) / per_px, (column - left + middle) / per_px)


@inlined_kernel
def _fill_middle(rays: Array, around: _Around, per_px: int, middle: FloatArray) -> None:
    """Fill the ray of a pixel's middle, its change by a pixel down, and by a pixel across, shape (9,)."""
    top, bottom, left, right = around.top, around.bottom, around.left, around.right
    for i in range(3):
        here = rays[i, top, left]
        middle[3 + i] = (rays[i, bottom, left] - here) * (per_px / max(bottom - top, 1))
        middle[6 + i] = (rays[i, top, right] - here) * (per_px / max(right - left, 1))
        middle[i] = here + around.down * middle[3 + i] + around.across * middle[6 + i]


@inlined_kernel
def _met(
    triangle: NDArray[np.int32], around: _Around, p: int, listed: NDArray[np.int32], tried: NDArray[np.int32]
) -> int:
    """Return the number of the triangles that some coarser rays meet, and list them.

    Args:
        triangle: as in ``finer_hits``, shape (per_px * rows, per_px * columns).
        around: the rays.
        p: number of the pixel.
        listed: number of the last pixel for which a triangle was listed, input and output, shape (T,).
        tried: output, shape (MOST_TRIED,).
    """
    count = 0
    for v in range(around.top, around.bottom + 1):
        for u in range(around.left, around.right + 1):
            k = triangle[v, u]
            if k >= 0 and listed[k] != p and count < MOST_TRIED:
                tried[count], listed[k] = k, p
                count += 1
    return count


@inlined_kernel
def _missed(met: NDArray[np.int32], p: int) -> bool:
    """Return whether a ray of a pixel has no hit, by ``FinerHits.triangle``, shape (P, SAMPLES^2)."""
    missed = False
    for n in range(SAMPLES * SAMPLES):
        missed |= met[p, n] < 0
    return missed


@inlined_kernel
def _test(  # noqa: PLR0917
    linear: Float32Array,
    k: int,
    down: Float32Array,
    across: Float32Array,
    met: NDArray[np.int32],
    inverse: Float32Array,
    p: int,
) -> None:
    """Assign to a triangle the rays of a pixel for which it is the nearest so far, without branches.

    Args:
        linear: as filled by ``_fill_linear``.
        k: the triangle.
        down: rows of the rays, relative to the pixel's middle, px, shape (SAMPLES^2,).
        across: their columns, same shape.
        met: ``FinerHits.triangle``, shape (P, SAMPLES^2), input and output.
        inverse: ``FinerHits.inverse``, same shape, input and output.
        p: number of the pixel.
    """
    a0, b0, c0, av, bv, cv = linear[0], linear[1], linear[2], linear[3], linear[4], linear[5]
    au, bu, cu = linear[6], linear[7], linear[8]
    for n in range(np.uint64(SAMPLES * SAMPLES)):
        v, u = down[n], across[n]
        a, b, c = a0 + v * av + u * au, b0 + v * bv + u * bu, c0 + v * cv + u * cu
        near = a + b + c
        wins = (a >= 0.0) & (b >= 0.0) & (c >= 0.0) & (near > inverse[p, n])
        inverse[p, n] = near if wins else inverse[p, n]
        met[p, n] = np.int32(k) if wins else met[p, n]


@inlined_kernel
def _fill_covered(  # noqa: PLR0917
    triangle: NDArray[np.int32],
    around: _Around,
    per_px: int,
    lines: tuple[FloatArray, FloatArray, Float32Array],
    places: tuple[Float32Array, Float32Array],
    hits: tuple[NDArray[np.int32], Float32Array],
    p: int,
) -> None:
    """Give rays without a hit that of the nearest coarser ray, if all in and around the pixel have hits.

    Args:
        triangle: as in ``finer_hits``, shape (per_px * rows, per_px * columns).
        around: the coarser rays.
        per_px: number of coarser rays for each pixel, along rows and columns.
        lines: ``sides``, ``middle`` and ``linear`` as for ``_fill_linear``.
        places: ``down`` and ``across`` as for ``_test``.
        hits: as in ``FinerHits``, input and output.
        p: number of the pixel.
    """
    (sides, middle, linear), (down, across), (met, inverse) = lines, places, hits
    for v in range(around.top, around.bottom + 1):
        for u in range(around.left, around.right + 1):
            if triangle[v, u] < 0:
                return
    for n in range(SAMPLES * SAMPLES):
        if met[p, n] >= 0:
            continue
        row = around.top + round((around.down + down[n]) * per_px)
        column = around.left + round((around.across + across[n]) * per_px)
        row = min(max(row, around.top), around.bottom)
        column = min(max(column, around.left), around.right)
        k = triangle[row, column]
        _fill_linear(sides, k, middle, linear)
        v_px = (row - around.top) / per_px - around.down
        u_px = (column - around.left) / per_px - around.across
        near = 0.0
        for i in range(3):
            near += linear[i] + v_px * linear[3 + i] + u_px * linear[6 + i]
        met[p, n], inverse[p, n] = k, near


@inlined_kernel
def _crossed(
    linear: Float32Array, down: Float32Array, across: Float32Array, met: NDArray[np.int32], p: int
) -> int:
    """Return a bit for each side across which rays without a hit lie; arguments as for ``_test``."""
    crossed = np.int32(0)
    a0, b0, c0, av, bv, cv = linear[0], linear[1], linear[2], linear[3], linear[4], linear[5]
    au, bu, cu = linear[6], linear[7], linear[8]
    for n in range(np.uint64(SAMPLES * SAMPLES)):
        v, u = down[n], across[n]
        a, b, c = a0 + v * av + u * au, b0 + v * bv + u * bu, c0 + v * cv + u * cu
        side = np.int32(2) if b <= c else np.int32(4)
        side = np.int32(1) if (a <= b) & (a <= c) else side
        crossed |= side if met[p, n] < 0 else np.int32(0)
    return int(crossed)


@inlined_kernel
def _fill_linear(sides: FloatArray, k: int, middle: FloatArray, linear: Float32Array) -> None:
    """Fill the products of a triangle's sides with the ray of a pixel's middle, and their changes by a pixel.

    Args:
        sides: as filled by ``_fill_sides``, shape (T, 9).
        k: the triangle.
        middle: as filled by ``_fill_middle``, shape (9,).
        linear: output, 1/m, shape (9,).
    """
    for i in range(3):
        for m in range(3):
            a, b, c = sides[k, 3 * m], sides[k, 3 * m + 1], sides[k, 3 * m + 2]
            linear[3 * i + m] = a * middle[3 * i] + b * middle[3 * i + 1] + c * middle[3 * i + 2]


@inner_kernel
def _sides_of(surface: Surface) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the products v_i x v_j of each triangle's corners over v0 . (v1 x v2), 1/m, shape (T, 9).

    With a ray within the triangle they are positive and add up to one over its range (``rays``). Whether the
    triangle faces the sensor follows, shape (T,).
    """
    number, R, t, corner = len(surface.beyond), surface.R, surface.t, np.empty((3, 3))
    sides, facing = np.empty((number, 9)), np.empty(number, np.bool_)
    for k in range(number):
        for n in range(3):
            x, y, z = surface.triangles_m[k, n, 0], surface.triangles_m[k, n, 1], surface.triangles_m[k, n, 2]
            for i in range(3):
                corner[n, i] = t[i] + R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
        volume = 0.0
        for n in range(3):
            a, b = n, (n + 1) % 3
            sides[k, 3 * n] = corner[a, 1] * corner[b, 2] - corner[a, 2] * corner[b, 1]
            sides[k, 3 * n + 1] = corner[a, 2] * corner[b, 0] - corner[a, 0] * corner[b, 2]
            sides[k, 3 * n + 2] = corner[a, 0] * corner[b, 1] - corner[a, 1] * corner[b, 0]
        for i in range(3):
            volume += sides[k, i] * corner[2, i]
        per_volume = 1.0 / volume
        for n in range(9):
            sides[k, n] *= per_volume
        facing[k] = volume < 0.0
    return sides, facing
