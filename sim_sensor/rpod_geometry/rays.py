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

from rpod_geometry.drawing import TOGETHER, Face, draw, fill_half_planes, fill_sides, fill_spans, volume_of
from rpod_geometry.kernels import kernel
from rpod_geometry.lens import undistort
from rpod_geometry.lines import end_line, first_line, lines_of, slopes_of
from rpod_schemas.arrays import Array, FloatArray
from rpod_schemas.types import Camera, Float32Array

NEAREST_M = 0.05
"""Least distance of a point that a sensor may see, m. Physics: none of these sensors measures nearer."""


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
        volume = volume_of(corner)  # negative where seen from outside
        if volume == 0.0 or (cull and volume > 0.0):  # NaN is skipped too
            continue
        least, most = slopes_of(corner, 1)
        top, bottom = first_line(rows, least), end_line(rows, most)
        least, most = slopes_of(corner, 0)
        left, right = first_line(columns, least), end_line(columns, most)
        if top < bottom and left < right:
            fill_sides(corner, 1.0 if volume > 0.0 else -1.0, side)
            face = Face(index, 1.0 / abs(volume), top, bottom, left, right)
            if right - left > few:
                fill_half_planes(side, columns.reach, rows.reach, half_planes)
                fill_spans(rows, columns, half_planes, face, spans)
            else:
                spans[top:bottom, 0], spans[top:bottom, 1] = left, right
            draw(rays, side, face, spans, inverse, triangle)
