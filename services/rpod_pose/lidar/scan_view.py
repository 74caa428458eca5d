"""Assignment of a scan's returns to the rays of its pattern."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt

from rpod_geometry.kernels import kernel
from rpod_geometry.rays import NEAREST_M, Hits, RayGrid
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array, LidarScan

FARTHEST_M = 1e5
"""Largest valid range. Physics: no LIDAR measures 100 km. The least valid range is ``NEAREST_M``, because
many sensors send a point at their origin for a ray without a return."""

MOST = 0.9
"""Share of the returns whose distance from their rays is compared with ``ON`` and ``BESIDE``. Numerics: the
others may be strays."""
ON = 0.005
"""Largest distance of returns from their rays, in steps of the pattern, at which the pattern's own rays are
used. Numerics: on a face at 45 deg, 20 m away, a range then differs by 2 mm with steps of 1 deg."""
BESIDE = 0.1
"""Largest distance, in steps of the pattern, at which an unorganised scan has the pattern's rays. Numerics:
of random returns, 4 % are nearer."""

_FEW = 0.5
"""Least share of the average number of returns in the chosen rows and columns; with fewer, others are chosen.
Numerics: neighbouring rows of a pattern differ by less."""

HIDDEN_M = np.inf
"""Coordinates of a return from a thing that hides the target; its ray gives no information on the target."""


@dataclass(frozen=True, eq=False)
class SeenScan:
    """The returns of one scan and the rays that they belong to."""

    points_m: FloatArray
    """Finite points, sensor axes, shape (N, 3)."""
    rays: NDArray[np.int64]
    """Row-major index of each point's ray, shape (N,); -1 for a point outside the pattern."""
    range_m: FloatArray
    """Measured range of each ray, shape (rows, columns): 0 without a return, negative if a return is unknown,
    for example because something hides the target."""
    grid: RayGrid
    """The rays: those of the pattern, or rays through the returns if the returns lie beside them."""

    @property
    def returns(self) -> int:
        """Number of points."""
        return len(self.points_m)

    @property
    def cut_off(self) -> bool:
        """Whether the outermost measured rays have returns, so that the target may extend beyond them."""
        return _ends_return(self.range_m) or _ends_return(self.range_m.T)

    def downsampled(self, count: int) -> FloatArray:
        """Return about ``count`` of the points, evenly distributed over the scan, shape (n, 3)."""
        return np.ascontiguousarray(self.points_m[:: max(1, round(self.returns / count))])

    def around(self, radius_m: float) -> "SeenScan":
        """Return the scan without returns farther than a radius from the median of all returns."""
        middle_m = np.median(self.points_m, axis=0)
        near = ((self.points_m - middle_m) ** 2).sum(axis=1) <= radius_m**2
        if near.all():
            return self
        image = self.range_m.copy()
        image.flat[self.rays[~near & (self.rays >= 0)]] = 0.0
        return SeenScan(self.points_m[near], self.rays[near], image, self.grid)

    def without(self, places: NDArray[np.intp]) -> "SeenScan":
        """Return the scan in which the rays at given rows and columns, shape (N, 2), are unknown."""
        image = self.range_m.copy()
        image[tuple(places.T)] = -1.0
        kept = (self.rays < 0) | (image.flat[self.rays] >= 0.0)
        return SeenScan(self.points_m[kept], self.rays[kept], image, self.grid)

    def first(self, stride: int) -> tuple[int, int]:
        """Return the row and the column at which ``every`` begins: 0, 0 unless it would have few returns.

        For example, a pattern may state rows that the sensor does not have, such as every second one.
        """
        row, column = np.divmod(self.rays[self.rays >= 0], self.range_m.shape[1])
        counts = np.bincount(row % stride * stride + column % stride, minlength=stride * stride)
        best = 0 if counts[0] >= _FEW * counts.mean() else int(counts.argmax())
        return best // stride, best % stride

    def every(self, stride: int, first: tuple[int, int] = (0, 0)) -> "SeenScan":
        """Return the returns in every ``stride``-th row and column of the pattern, beginning at ``first``."""
        row, column = np.divmod(self.rays, self.range_m.shape[1])
        row, column = row - first[0], column - first[1]
        kept = (self.rays >= 0) & (row % stride == 0) & (column % stride == 0)
        image = np.ascontiguousarray(self.range_m[first[0] :: stride, first[1] :: stride])
        rays = row[kept] // stride * image.shape[1] + column[kept] // stride
        grid = RayGrid(np.ascontiguousarray(self.grid.components[:, first[0] :: stride, first[1] :: stride]))
        return SeenScan(self.points_m[kept], rays, image, grid)


@dataclass(frozen=True, eq=False)
class ScanView:
    """The rays of a scan pattern."""

    azimuth_rad: FloatArray
    """As in ``ScanPattern``, shape (columns,)."""
    elevation_rad: FloatArray
    """As in ``ScanPattern``, shape (rows,)."""
    row_azimuth_rad: FloatArray | None
    """As in ``ScanPattern``, shape (rows,)."""
    grid: RayGrid
    """Rays of the pattern, shape (rows, columns)."""
    hits: Hits
    """Buffers for the results of casting the rays."""

    @classmethod
    def of(
        cls, azimuth_rad: FloatArray, elevation_rad: FloatArray, row_azimuth_rad: FloatArray | None = None
    ) -> Self:
        """Return the view of a pattern, whose fields are those of ``ScanPattern``."""
        grid = RayGrid.azimuth_elevation(azimuth_rad, elevation_rad, row_azimuth_rad)
        return cls(azimuth_rad, elevation_rad, row_azimuth_rad, grid, Hits.of(grid))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.elevation_rad.size, self.azimuth_rad.size

    def every(self, stride: int, first: tuple[int, int] = (0, 0)) -> "ScanView":
        """Return the view of every ``stride``-th row and column, beginning at ``first``."""
        rows, columns = slice(first[0], None, stride), slice(first[1], None, stride)
        aside_rad = None if self.row_azimuth_rad is None else self.row_azimuth_rad[rows].copy()
        return ScanView.of(self.azimuth_rad[columns].copy(), self.elevation_rad[rows].copy(), aside_rad)

    def seen(self, scan: LidarScan) -> SeenScan:
        """Return a scan's returns with their rays; returns of an unorganised scan get the nearest rays.

        If returns lie beside the rays of the pattern, rays through the returns are used. This is so in a
        scan that was de-skewed, and in one whose pattern never repeats. For the second kind it is unknown
        whether the sensor measured beside a return.
        """
        points_m, places, range_m = returns_of(np.ascontiguousarray(scan.points_m.reshape(-1, 3)))
        organised = scan.points_m.shape[:-1] == self.shape
        rays = places if organised else self._nearest_rays(points_m, range_m)
        off = self._off(points_m / range_m[:, None], rays)
        elsewhere = not organised and off > BESIDE
        if elsewhere:
            rays = spread(rays, *self.shape)
        image = range_image(rays, range_m, *self.shape)
        if organised:
            image[np.isinf(scan.points_m[..., 0])] = -1.0
        if scan.hidden is not None and scan.hidden.shape == self.shape:
            image[scan.hidden & (image == 0.0)] = -1.0
        if elsewhere:
            beside = binary_dilation(image > 0.0, np.ones((3, 3), np.bool_))
            image[beside & (image == 0.0)] = -1.0
        grid = self.grid if off <= ON else self._through(points_m, rays, moved=organised)
        return SeenScan(points_m, rays, image, grid)

    def _nearest_rays(self, points_m: FloatArray, range_m: FloatArray) -> NDArray[np.int64]:
        """Return the rays of the returns of an unorganised scan, -1 outside the pattern."""
        row, above = _nearest(self.elevation_rad, np.arcsin(points_m[:, 1] / range_m))
        azimuth_rad = np.arctan2(points_m[:, 0], points_m[:, 2])
        if self.row_azimuth_rad is not None:
            azimuth_rad -= self.row_azimuth_rad[row]
        middle_rad = 0.5 * (self.azimuth_rad.min() + self.azimuth_rad.max())
        azimuth_rad += 2.0 * np.pi * np.round((middle_rad - azimuth_rad) / (2.0 * np.pi))
        column, beside = _nearest(self.azimuth_rad, azimuth_rad)
        return np.where(beside | above, -1, row * self.azimuth_rad.size + column)

    def _off(self, directions: FloatArray, rays: NDArray[np.int64]) -> float:
        """Return the largest distance of the ``MOST`` nearest returns from their rays, in steps.

        Args:
            directions: unit vectors to the returns, sensor axes, shape (N, 3).
            rays: their rays, -1 for none, shape (N,).
        """
        known = rays >= 0
        last = int(MOST * np.count_nonzero(known)) - 1
        if last < 0:
            return 0.0
        off = directions[known] - self.grid.directions.reshape(-1, 3)[rays[known]]
        return float(np.sqrt(np.partition((off * off).sum(axis=1), last)[last])) / self._step_rad

    @cached_property
    def _step_rad(self) -> float:
        return min(spacing_rad(self.azimuth_rad), spacing_rad(self.elevation_rad))

    def _through(self, points_m: FloatArray, rays: NDArray[np.int64], *, moved: bool) -> RayGrid:
        """Return the grid in which each ray with a return passes through this return.

        Args:
            points_m: returns, sensor axes, shape (N, 3), m.
            rays: their rays, shape (N,), -1 for none.
            moved: whether rays without a return are turned like those of the nearest returns.
        """
        components, known = self.grid.components.copy(), rays >= 0
        directions = points_m[known] / np.linalg.norm(points_m[known], axis=1, keepdims=True)
        components.reshape(3, -1)[:, rays[known]] = directions.T
        if moved:
            missed = np.ones(self.shape, np.bool_)
            missed.flat[rays[known]] = False
            nearest = distance_transform_edt(missed, return_distances=False, return_indices=True)
            components = self.grid.components + (components - self.grid.components)[:, *nearest]
            components /= np.linalg.norm(components, axis=0)
        return RayGrid(components)


@kernel
def returns_of(points: Float32Array) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Return the points at a valid range, (N, 3), m, their indices, (N,), and their ranges, (N,), m.

    Args:
        points: all points, sensor axes, shape (M, 3), m; NaN without a return.
    """
    places, range_m = np.empty(len(points), np.int64), np.empty(len(points))
    count = 0
    for n in range(len(points)):
        x, y, z = np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2])
        r = np.sqrt(x * x + y * y + z * z)
        if NEAREST_M < r < FARTHEST_M:  # false for NaN
            places[count], range_m[count] = n, r
            count += 1
    return points[places[:count]].astype(np.float64), places[:count], range_m[:count]


@kernel
def range_image(rays: NDArray[np.int64], range_m: FloatArray, rows: int, columns: int) -> FloatArray:
    """Return the range of each ray, 0 without a return, shape (rows, columns), m.

    Args:
        rays: ray of each return, counted row by row, -1 for none, shape (N,).
        range_m: range of each return, shape (N,), m.
        rows: rows of the pattern.
        columns: columns of the pattern.
    """
    image = np.zeros(rows * columns)
    for n in range(rays.size):
        if rays[n] >= 0:
            image[rays[n]] = range_m[n]
    return image.reshape(rows, columns)


@kernel
def spread(rays: NDArray[np.int64], rows: int, columns: int) -> NDArray[np.int64]:
    """Return rays with few duplicates: a return whose ray is occupied gets a free neighbouring ray.

    Args:
        rays: ray of each return, counted row by row, -1 for none, shape (N,).
        rows: rows of the pattern.
        columns: columns of the pattern.
    """
    found, taken = rays.copy(), np.zeros((rows, columns), np.bool_)
    later = np.zeros(rays.size, np.bool_)
    for n in range(rays.size):
        if rays[n] >= 0:
            row, column = divmod(rays[n], columns)
            later[n] = taken[row, column]
            taken[row, column] = True
    for n in range(rays.size):
        if not later[n]:
            continue
        row, column = divmod(rays[n], columns)
        for i in range(max(row - 1, 0), min(row + 2, rows)):
            for j in range(max(column - 1, 0), min(column + 2, columns)):
                if later[n] and not taken[i, j]:
                    found[n], taken[i, j], later[n] = i * columns + j, True, False
    return found


def spacing_rad(angles_rad: FloatArray) -> float:
    """Return the median step, rad, of the angles of columns or rows, (N,); 1 degree for a single angle."""
    return float(np.median(np.abs(np.diff(angles_rad)))) if angles_rad.size > 1 else np.radians(1.0)


def _ends_return(image: FloatArray) -> bool:
    """Return whether the first or last known ray of any row of an image, (rows, columns), has a return."""
    known = image >= 0.0
    rows = np.flatnonzero(known.any(axis=1))
    first, last = known.argmax(axis=1), image.shape[1] - 1 - known[:, ::-1].argmax(axis=1)
    return bool(image[rows, first[rows]].any() or image[rows, last[rows]].any())


def _nearest(angles_rad: FloatArray, wanted_rad: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the index of the pattern's nearest angle, and whether this is farther than one step."""
    order = np.argsort(angles_rad)
    middle = (angles_rad[order][1:] + angles_rad[order][:-1]) / 2.0
    index = order[np.searchsorted(middle, wanted_rad)]
    return index, np.abs(angles_rad[index] - wanted_rad) > spacing_rad(angles_rad)
