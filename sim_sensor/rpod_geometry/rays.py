"""Casts a sensor's rays: one caster for the camera and for the LIDAR.

All rays start in the sensor's origin, so a triangle needs only four numbers per ray. Its corners v0, v1, v2
and the ray d give ``s_i = d . (v_i x v_j)``, whose sign gives the side of the plane through the origin and an
edge on which the ray lies. The ray passes through the triangle if all three have the sign of ``v0 . (v1 x
v2)``. It meets the plane at ``v0 . (v1 x v2) / (s_0 + s_1 + s_2)``, because the three cross products add up
to the face's normal. Two triangles that share an edge compute the same product with opposite signs, so no ray
passes between them.
"""

from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from rpod_geometry.kernels import inlined_kernel, inner_kernel, kernel
from rpod_geometry.lens import undistort
from rpod_geometry.lines import Lines, end_line, entry_of, first_line, lines_of, slopes_of
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.types import Camera, Float32Array

NEAREST_M = 0.05
"""Least distance of a point that a sensor may see, m. Physics: none of these sensors measures nearer."""
TOGETHER = 16
"""Number of neighbouring rays that are tested together. Numerics: a processor's vectors; rays that remain are
tested one by one, which takes longer."""
ROUNDING = 1e-6
"""Share of the terms of a ray's test by which rounding may change their sum. Numerics: single precision, five
roundings of each term, twice."""


class Envelope(NamedTuple):
    """Non-decreasing bounds of the slopes of a grid's lines: columns (x/z) or rows (y/z)."""

    lower: FloatArray
    """Lower bound of the slopes of this and all following lines, shape (lines,)."""
    upper: FloatArray
    """Upper bound of the slopes of this and all previous lines, shape (lines,)."""


class GridArrays(NamedTuple):
    """The rays of a grid and their bounds, as arguments of kernels; nested records would be slower."""

    components: FloatArray
    """x, y, z of the unit rays in sensor axes, shape (3, rows, columns), float64 or float32."""
    column_lower: FloatArray
    """``Envelope.lower`` of the columns, shape (columns,)."""
    column_upper: FloatArray
    """``Envelope.upper`` of the columns, shape (columns,)."""
    row_lower: FloatArray
    """``Envelope.lower`` of the rows, shape (rows,)."""
    row_upper: FloatArray
    """``Envelope.upper`` of the rows, shape (rows,)."""


class RenderBuffers(NamedTuple):
    """First hit of each ray of a grid, as arguments of kernels."""

    range_m: Float32Array
    """Distance along the ray, shape (rows, columns), inf without a hit."""
    triangle: NDArray[np.int32]
    """Index of the triangle, shape (rows, columns), -1 without a hit."""


@dataclass(frozen=True, eq=False)
class RayGrid:
    """Rays of a sensor in rows and columns, with bounds that give the rows and columns of a triangle.

    Build it by ``pinhole`` or ``azimuth_elevation``. A triangle is tested on a block of the grid only. The
    block follows from the slopes x/z and y/z of the columns and rows. The result is right for any order; it
    is fast for columns from left to right and rows from top to bottom.
    """

    components: FloatArray
    """x, y, z of the unit rays in sensor axes (x right, y down, z boresight), shape (3, rows, columns)."""
    _columns: Envelope = field(init=False, repr=False)
    _rows: Envelope = field(init=False, repr=False)

    def __post_init__(self) -> None:
        x, y, z = self.components
        forward = z > 0.0
        slope = np.divide((x, y), z, where=forward, out=np.full((2, *z.shape), np.nan))
        object.__setattr__(self, "_columns", _envelope(slope[0].T))
        object.__setattr__(self, "_rows", _envelope(slope[1]))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.components.shape[1], self.components.shape[2]

    @property
    def directions(self) -> FloatArray:
        """Unit rays in sensor axes, shape (rows, columns, 3); a view."""
        return np.moveaxis(self.components, 0, -1)

    @property
    def arrays(self) -> GridArrays:
        """The rays and their bounds, as arguments of kernels."""
        return GridArrays(self.components, *self._columns, *self._rows)

    def block(self, rows: slice, columns: slice) -> GridArrays:
        """Return the rays of a block of rows and columns, as arguments of kernels."""
        components = np.ascontiguousarray(self.components[:, rows, columns])
        across, down = self._columns, self._rows
        return GridArrays(
            components, across.lower[columns], across.upper[columns], down.lower[rows], down.upper[rows]
        )

    @classmethod
    def pinhole(cls, camera: Camera, samples: int = 1) -> Self:
        """Return ``samples`` x ``samples`` undistorted rays per pixel, spread evenly over it.

        Raises:
            rpod_geometry.errors.DistortionError: the lens distortion cannot be inverted within the image.
        """
        offsets = (np.arange(samples) + 0.5) / samples - 0.5
        column = (np.arange(camera.width)[:, None] + offsets).ravel()
        row = (np.arange(camera.height)[:, None] + offsets).ravel()
        x, y = np.meshgrid((column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy)
        x, y = undistort(np.stack((x, y)), camera)
        rays = np.stack((x, y, np.ones_like(x)))
        return cls(np.ascontiguousarray(rays / np.linalg.norm(rays, axis=0)))

    def in_single_precision(self) -> Self:
        """Return the rays in float32: casting takes half the time, with ranges accurate to a micrometre."""
        components: Array = self.components.astype(np.float32)
        return type(self)(components)

    @classmethod
    def azimuth_elevation(
        cls, azimuth_rad: FloatArray, elevation_rad: FloatArray, row_azimuth_rad: FloatArray | None = None
    ) -> Self:
        """Return rays (sin az cos el, sin el, cos az cos el); rows are elevation, columns azimuth.

        Args:
            azimuth_rad: azimuths of the columns, shape (columns,).
            elevation_rad: elevations of the rows, shape (rows,).
            row_azimuth_rad: azimuth that is added in each row, shape (rows,); None if it is 0.
        """
        elevation, azimuth = np.meshgrid(elevation_rad, azimuth_rad, indexing="ij")
        if row_azimuth_rad is not None:
            azimuth = azimuth + row_azimuth_rad[:, None]
        across = np.cos(elevation)
        return cls(np.stack((np.sin(azimuth) * across, np.sin(elevation), np.cos(azimuth) * across)))


@dataclass(frozen=True, eq=False)
class Hits:
    """First hit of each ray of a grid."""

    range_m: Float32Array
    """Distance along the ray, shape (rows, columns), inf without a hit."""
    triangle: NDArray[np.int32]
    """Index of the triangle, shape (rows, columns), -1 without a hit."""

    @classmethod
    def of(cls, grid: RayGrid) -> Self:
        """Return buffers for the hits of a grid, without any hit."""
        return cls(np.full(grid.shape, np.inf, np.float32), np.full(grid.shape, -1, np.int32))

    @property
    def arrays(self) -> RenderBuffers:
        """The hits as arguments of kernels."""
        return RenderBuffers(self.range_m, self.triangle)


def cast(
    grid: RayGrid,
    triangles_m: FloatArray,
    T_sensor_target: RigidTransform,
    *,
    out: Hits | None = None,
    cull_back_faces: bool = False,
) -> Hits:
    """Return the first hit of every ray.

    Args:
        grid: the sensor's rays.
        triangles_m: corners of the triangles, shape (T, 3, 3), target axes, counter-clockwise from outside.
        T_sensor_target: pose of the target in the sensor.
        out: buffers to write into and to return; by default new ones.
        cull_back_faces: whether to skip triangles seen from behind, which closed bodies hide anyway.
    """
    hits = Hits.of(grid) if out is None else out
    pose = T_sensor_target.as_matrix()
    R, t = pose[:3, :3].copy(), pose[:3, 3].copy()
    cast_pose(grid.arrays, triangles_m, R, t, cull_back_faces, hits.range_m, hits.triangle)
    return hits


def cast_triangles(
    grid: RayGrid, triangles_m: FloatArray, T_sensor_target: RigidTransform, *, out: Hits, cull: bool
) -> None:
    """Fill the triangle that each ray hits first, like ``cast``; the ranges of ``out`` are undefined then."""
    pose = T_sensor_target.as_matrix()
    R, t = pose[:3, :3].copy(), pose[:3, 3].copy()
    cast_inverse(grid.arrays, triangles_m, R, t, cull, out.range_m, out.triangle)


def _envelope(slope: FloatArray) -> Envelope:
    """Return non-decreasing lower and upper bounds of the slopes in each line, shape (lines, rays)."""
    behind = np.isnan(slope).any(axis=1)
    lower = np.where(behind, -np.inf, slope.min(axis=1))
    upper = np.where(behind, np.inf, slope.max(axis=1))
    return Envelope(np.minimum.accumulate(lower[::-1])[::-1].copy(), np.maximum.accumulate(upper))


@kernel
def cast_pose(  # noqa: PLR0917
    grid: GridArrays,
    triangles: FloatArray,
    R: FloatArray,
    t: FloatArray,
    cull: bool,
    range_m: Float32Array,
    triangle: NDArray[np.int32],
) -> None:
    """Fill ``range_m`` and ``triangle`` like ``cast``, for kernels that try many poses.

    The module's docstring derives the equations.

    Args:
        grid: ``RayGrid.arrays``.
        triangles: target axes, shape (T, 3, 3), m.
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        cull: whether to skip triangles seen from behind.
        range_m: output, shape (rows, columns), m.
        triangle: output, shape (rows, columns).
    """
    cast_inverse(grid, triangles, R, t, cull, range_m, triangle)
    range_m[:] = 1.0 / range_m


@kernel
def cast_inverse(  # noqa: PLR0917
    grid: GridArrays,
    triangles: FloatArray,
    R: FloatArray,
    t: FloatArray,
    cull: bool,
    inverse: Float32Array,
    triangle: NDArray[np.int32],
) -> None:
    """Fill one over the range, 1/m, 0 without a hit (the largest); arguments as in ``cast_pose``."""
    rays = grid.components
    inverse[:] = 0.0
    triangle[:] = -1
    columns = lines_of(grid.column_lower, grid.column_upper)
    rows = lines_of(grid.row_lower, grid.row_upper)
    few = TOGETHER if max(columns.reach, rows.reach) < np.inf else rays.shape[2]
    corner, side, half_planes = np.empty((3, 3)), np.empty((3, 3), rays.dtype), np.empty((3, 4))
    spans = np.empty((rays.shape[1], 2), np.uint64)
    for index in range(triangles.shape[0]):
        for i in range(3):
            x, y, z = triangles[index, i, 0], triangles[index, i, 1], triangles[index, i, 2]
            for k in range(3):
                corner[i, k] = t[k] + R[k, 0] * x + R[k, 1] * y + R[k, 2] * z
        volume = _volume(corner)  # negative where seen from outside
        if volume == 0.0 or (cull and volume > 0.0):  # NaN is skipped too
            continue
        least, most = slopes_of(corner, 1)
        top, bottom = first_line(rows, least), end_line(rows, most)
        least, most = slopes_of(corner, 0)
        left, right = first_line(columns, least), end_line(columns, most)
        if top < bottom and left < right:
            _sides(corner, 1.0 if volume > 0.0 else -1.0, side)
            face = _Face(index, 1.0 / abs(volume), top, bottom, left, right)
            if right - left > few:
                _fill_half_planes(side, columns.reach, rows.reach, half_planes)
                _fill_spans(grid, columns, half_planes, face, spans)
            else:
                spans[top:bottom, 0], spans[top:bottom, 1] = left, right
            _draw(rays, side, face, spans, inverse, triangle)


class _Face(NamedTuple):
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
def _volume(corner: FloatArray) -> float:
    """Return v0 . (v1 x v2), m3, of a triangle's corners in sensor axes, shape (3, 3), m."""
    x = corner[1, 1] * corner[2, 2] - corner[1, 2] * corner[2, 1]
    y = corner[1, 2] * corner[2, 0] - corner[1, 0] * corner[2, 2]
    z = corner[1, 0] * corner[2, 1] - corner[1, 1] * corner[2, 0]
    return float(corner[0, 0] * x + corner[0, 1] * y + corner[0, 2] * z)


@inner_kernel
def _sides(corner: FloatArray, sign: float, side: Array) -> None:
    """Fill the products v_i x v_j, m2, shape (3, 3), with signs so that s_i >= 0 for rays inside."""
    for i in range(3):
        a, b = corner[i], corner[(i + 1) % 3]
        side[i, 0] = sign * (a[1] * b[2] - a[2] * b[1])
        side[i, 1] = sign * (a[2] * b[0] - a[0] * b[2])
        side[i, 2] = sign * (a[0] * b[1] - a[1] * b[0])


@inner_kernel
def _fill_half_planes(side: Array, across: float, down: float, half_planes: FloatArray) -> None:
    """Fill, for each side of a triangle, the half plane of slopes in which a ray may be within the triangle.

    A ray with the slopes X and Y is within it if a X + b Y + c >= 0 for all sides (a, b, c). A row of the
    result has a, b, c with a margin for rounding, and -1 / a.

    Args:
        side: as filled by ``_sides``, shape (3, 3).
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
def _fill_spans(
    grid: GridArrays, columns: Lines, half_planes: FloatArray, face: "_Face", spans: NDArray[np.uint64]
) -> None:
    """Fill the first and last + 1 of the columns that may meet a triangle, for each of its rows.

    Args:
        grid: the rays.
        columns: their columns.
        half_planes: as filled by ``_fill_half_planes``, shape (3, 4).
        face: the triangle.
        spans: output, shape (rows, 2).
    """
    for row in range(face.top, face.bottom):
        least, most = -np.inf, np.inf
        for i in range(3):
            a, b = half_planes[i, 0], half_planes[i, 1]
            highest = max(b * grid.row_lower[row], b * grid.row_upper[row])
            bound = (highest + half_planes[i, 2]) * half_planes[i, 3]
            if a > 0.0:
                least = max(least, bound)
            elif a < 0.0:
                most = min(most, bound)
        begin = max(face.left, int(columns.first[entry_of(columns, least)]))
        end = min(face.right, int(columns.last[entry_of(columns, most)]))
        spans[row, 0], spans[row, 1] = begin, max(begin, end)


@inner_kernel
def _draw(  # noqa: PLR0917
    rays: Array,
    side: Array,
    face: _Face,
    spans: NDArray[np.uint64],
    inverse: Float32Array,
    triangle: NDArray[np.int32],
) -> None:
    """Assign to a triangle the rays for which it is the nearest so far, without branches, for vectorisation.

    More rays are tested than may meet the triangle: a multiple of ``TOGETHER``, if the row has as many.

    Args:
        rays: ``GridArrays.components``, shape (3, rows, columns).
        side: as filled by ``_sides``, shape (3, 3).
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
