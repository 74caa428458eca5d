"""The brightness of surfaces as it varies across an image.

Surfaces that are not Lambertian are brighter where they mirror the light, so that one factor for a surface
leaves some ten percent. Edges nearer to each other than the blur are then expected a tenth of a pixel beside
their places, all those of a part on the same side. Therefore the ratio of image over rendering is followed
within each surface: by a plane in each tile of the image, with neighbours blended. This is a local linear
regression (W. S. Cleveland, S. J. Devlin, Journal of the American Statistical Association 83, 1988).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_pose.pmd.joint.brightness.mixture import Mixture
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

TILE_PX = 12
"""Side of a tile. Physics: several times the width of a blurred edge, 1.6 px, so that an edge that is
displaced does not pass for a change of brightness."""
SLOPE_PX2 = 1.0
"""Variance of places that is added where a slope is fitted, px2. Physics: that of places within the blur,
since pixels that are nearer to each other tell no slope."""
UNKNOWN = 0.0005
"""Weight of no change, over that of a pixel that shows one surface. Numerics: a twentieth of a pixel that
shows several, so that it matters only without such a pixel."""
LEAST, MOST = 0.3, 3.0
"""Limits of a factor. Numerics: they matter only for planes that are extrapolated."""


class Axis(NamedTuple):
    """The tiles along the rows or the columns of a window, for each of its N rows or columns."""

    tile: NDArray[np.int64]
    """Number of the tile, shape (N,)."""
    off_px: FloatArray
    """Place from the middle of the tile, shape (N,)."""
    before: NDArray[np.int64]
    """Number of the last tile whose middle is not behind, shape (N,)."""
    beyond: FloatArray
    """Place from that middle, in sides of a tile, shape (N,)."""


class Tiles(NamedTuple):
    """The tiles of K surfaces, which follow each other; a surface has those of its bounding rectangle."""

    first: NDArray[np.int64]
    """Index of the first tile of each surface, shape (K + 1,)."""
    row: NDArray[np.int64]
    """First row of tiles, shape (K,)."""
    column: NDArray[np.int64]
    """First column of tiles, shape (K,)."""
    rows: NDArray[np.int64]
    """Number of rows, shape (K,)."""
    columns: NDArray[np.int64]
    """Number of columns, shape (K,)."""


@kernel
def local_light(mixture: Mixture, weight: Float32Array, ratio: Float32Array) -> Float32Array:
    """Return the light of each contribution, shape (M,), times the ratio of its surface around its pixel.

    Args:
        mixture: the surfaces that the pixels show.
        weight: weight of each pixel, shape (rows, columns).
        ratio: image over rendering, same shape.
    """
    down, across = _axis(mixture.window.rows), _axis(mixture.window.columns)
    tiles, lights = _tiles(mixture, down, across), mixture.light
    planes, result = _planes(_sums(mixture, weight, ratio, (down, across), tiles)), np.empty_like(lights)
    row, begin = 0, 0
    for n in range(lights.size):
        while mixture.pixel[n] >= begin + mixture.window.columns:
            row, begin = row + 1, begin + mixture.window.columns
        k, column = mixture.part[n], mixture.pixel[n] - begin
        v, u = down.before[row] - tiles.row[k], across.before[column] - tiles.column[k]
        y, x = down.beyond[row], across.beyond[column]
        weights, total = UNKNOWN, 0.0
        for j in range(max(v, 0), min(v + 2, tiles.rows[k])):
            for i in range(max(u, 0), min(u + 2, tiles.columns[k])):
                tile, dy, dx = tiles.first[k] + j * tiles.columns[k] + i, y - (j - v), x - (i - u)
                share = planes[tile, 0] * (1.0 - abs(dy)) * (1.0 - abs(dx))
                weights += share
                total += share * (planes[tile, 1] + planes[tile, 2] * dx + planes[tile, 3] * dy)
        result[n] = lights[n] * min(max(1.0 + total / weights, LEAST), MOST)
    return result


@inner_kernel
def _axis(number: int) -> Axis:
    """Return the tiles along ``number`` rows or columns."""
    place, middle = np.arange(number), 0.5 * (TILE_PX - 1)
    tile, from_first = place // TILE_PX, (place - middle) / TILE_PX
    before = np.floor(from_first)
    off_px = (place - TILE_PX * tile).astype(np.float64) - middle
    return Axis(tile, off_px, before.astype(np.int64), from_first - before)


@inner_kernel
def _tiles(mixture: Mixture, down: Axis, across: Axis) -> Tiles:
    """Return the tiles of all surfaces in the pixels of a window, with those along its rows and columns."""
    columns, number = mixture.window.columns, int(mixture.part.max()) + 1
    low, high = np.full((2, number), 1 << 40, np.int64), np.full((2, number), -1, np.int64)
    row, begin = 0, 0
    for n in range(mixture.pixel.size):
        while mixture.pixel[n] >= begin + columns:
            row, begin = row + 1, begin + columns
        k, v, u = mixture.part[n], down.tile[row], across.tile[mixture.pixel[n] - begin]
        low[0, k], low[1, k] = min(low[0, k], v), min(low[1, k], u)
        high[0, k], high[1, k] = max(high[0, k], v), max(high[1, k], u)
    size, first = np.maximum(high - low + 1, 0), np.zeros(number + 1, np.int64)
    first[1:] = np.cumsum(size[0] * size[1])
    return Tiles(first, low[0], low[1], size[0], size[1])


@inner_kernel
def _sums(
    mixture: Mixture, weight: Float32Array, ratio: Float32Array, axes: tuple[Axis, Axis], tiles: Tiles
) -> FloatArray:
    """Return the sums of w (1, x, y, x^2, x y, y^2, q, q x, q y) in each tile, shape (N, 9).

    q is the ratio minus 1, and (x, y) the place from the middle of the tile. What a pixel shows shares its
    weight w.

    Args:
        mixture: the surfaces that the pixels show.
        weight: weight of each pixel, shape (rows, columns).
        ratio: image over rendering, same shape.
        axes: tiles along rows and columns.
        tiles: tiles of all surfaces.
    """
    lights, shares, ratios = mixture.light, weight.ravel(), ratio.ravel()
    (down, across), columns = axes, mixture.window.columns
    total, sums = np.zeros(shares.size, np.float32), np.zeros((tiles.first[-1], 9))
    for n in range(lights.size):
        total[mixture.pixel[n]] += lights[n]
    row, begin = 0, 0
    for n in range(lights.size):
        pixel, k = mixture.pixel[n], mixture.part[n]
        while pixel >= begin + columns:
            row, begin = row + 1, begin + columns
        if not lights[n] > 0.0:
            continue
        j = down.tile[row] - tiles.row[k]
        tile = tiles.first[k] + j * tiles.columns[k] + across.tile[pixel - begin] - tiles.column[k]
        y, x, w = down.off_px[row], across.off_px[pixel - begin], shares[pixel] * lights[n] / total[pixel]
        q = w * (ratios[pixel] - 1.0)
        sums[tile, 0] += w
        sums[tile, 1] += w * x
        sums[tile, 2] += w * y
        sums[tile, 3] += w * x * x
        sums[tile, 4] += w * x * y
        sums[tile, 5] += w * y * y
        sums[tile, 6] += q
        sums[tile, 7] += q * x
        sums[tile, 8] += q * y
    return sums


@inner_kernel
def _planes(sums: FloatArray) -> FloatArray:
    """Return each tile's weight, and q in the middle and its change over a tile along x and y, shape (N, 4).

    Args:
        sums: as of ``_sums``, shape (N, 9).
    """
    planes = np.zeros((len(sums), 4))
    for n in range(len(sums)):
        weight = sums[n, 0]
        if not weight > 0.0:
            continue
        x, y, q = sums[n, 1] / weight, sums[n, 2] / weight, sums[n, 6] / weight
        xx, yy = sums[n, 3] / weight - x * x + SLOPE_PX2, sums[n, 5] / weight - y * y + SLOPE_PX2
        xy, qx, qy = sums[n, 4] / weight - x * y, sums[n, 7] / weight - q * x, sums[n, 8] / weight - q * y
        per_px2 = 1.0 / (xx * yy - xy * xy)
        by_x, by_y = (yy * qx - xy * qy) * per_px2, (xx * qy - xy * qx) * per_px2
        planes[n, 0], planes[n, 1] = weight, q - by_x * x - by_y * y
        planes[n, 2], planes[n, 3] = TILE_PX * by_x, TILE_PX * by_y
    return planes
