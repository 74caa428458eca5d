"""Energies: fast measures of the mismatch between a scan and thousands of attitudes of the target.

For each attitude the target is first aligned with the scan by its centroid. The expected centroid is that of
the points that face the sensor, weighted by the number of rays that meet them and by the probability of
detection. It is moved to the centroid of the scan. The mismatch is then computed in both directions, since a
missing return counts as much as one too many:

- each return costs its squared distance from the target's surface,
- each point in view costs the squared distance of its ray from the nearest ray with a return.

Both costs are truncated, and averaged over the returns and over the points' weights.
"""

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rpod_geometry.kernels import inner_kernel, kernel
from rpod_geometry.rays import NEAREST_M
from rpod_pose.registration.distance_field import FieldArrays
from rpod_pose.registration.lie_group import Vector
from rpod_pose.search.view_model import Points, view_of
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import Float32Array

CELLS = 96
"""Cells of the image of distances from returns, along each side. Numerics: memory and time."""
LEAST_Z_M = np.float32(NEAREST_M)
"""Least z of a point in view, in the kernel's precision."""
NOTHING_IN_VIEW = 1e9
"""Energy of an attitude with no point in view. Numerics: larger than any other energy."""


Real = float | np.floating[Any]


class Image(NamedTuple):
    """Squared angles to the nearest return, on a grid with equal steps in tan(azimuth) and tan(elevation)."""

    squares: Float32Array
    """Squared angles, shape (CELLS, CELLS), rad2."""
    first_column: Real
    """Edge of the first column, x/z."""
    column_step: Real
    """Width of a column, x/z, above 0."""
    first_row: Real
    """Edge of the first row, y/hypot(x, z)."""
    row_step: Real
    """Height of a row, y/hypot(x, z), above 0."""


class Returns(Protocol):
    """The measured points of the target."""

    @property
    def points_m(self) -> FloatArray:
        """Positions of the points, sensor axes, shape (N, 3)."""
        ...

    def downsampled(self, count: int) -> FloatArray:
        """Return about ``count`` of the points, evenly spread, shape (n, 3)."""
        ...


def energies(
    attitudes: Float32Array,
    places_m: Float32Array,
    *,
    seen: Returns,
    points: Points,
    squares: FieldArrays,
    image: Image,
    detection: tuple[float, FloatArray],
    returns: int,
    rounds: int,
    truncation_m: float,
) -> Float32Array:
    """Return the energy of each attitude, shape (M,), m2; align each place with the scan.

    Args:
        attitudes: R_sensor_target, float32, shape (M, 3, 3).
        places_m: first guesses of the target's origin, sensor axes, float32, shape (M, 3); replaced by the
            aligned ones.
        seen: the measurement.
        points: surface points of the target.
        squares: squared distance field of the target; places outside have the values of its border.
        image: ``ReturnDistances.image`` of the scan.
        detection: steps of a table per unit of echo, albedo cos(theta) / R^2, and the table: the share of
            rays with a return.
        returns: approximate number of returns that are compared.
        rounds: how often the centroids are aligned.
        truncation_m: distance at which costs are truncated, in both directions; equal to the field's.
    """
    energy = np.empty(len(attitudes), np.float32)
    sight = _Sight(
        np.ascontiguousarray(seen.downsampled(returns).T, np.float32),
        seen.points_m.mean(axis=0).astype(np.float32),
        Image(image.squares, *(np.float32(bound) for bound in image[1:])),
        _Echoes(np.float32(detection[0]), detection[1].astype(np.float32)),
        np.float32(truncation_m**2),
    )
    field = FieldArrays(
        squares.origin_m.astype(np.float32),  # pyright: ignore[reportArgumentType]
        np.float32(squares.spacing_m),  # type: ignore[arg-type]
        squares.values,
    )
    _energies(attitudes, places_m, sight, points, field, rounds, energy)
    return energy


class _Echoes(NamedTuple):
    """Probability that a surface returns an echo."""

    steps: np.float32
    """Steps of the table per unit of echo, rho cos(theta) / R^2."""
    table: Float32Array
    """Probability of detection, shape (steps,)."""


class _Sight(NamedTuple):
    """A measurement in single precision, in the form that the kernels take."""

    returns: Float32Array
    """Measured points, sensor axes, shape (3, N), m."""
    centroid: Float32Array
    """Centroid of all measured points, sensor axes, shape (3,), m."""
    image: Image
    echoes: _Echoes
    most: np.float32
    """Squared distance at which costs are truncated, m2."""


class _Sums(NamedTuple):
    """Sums over the points in view."""

    weight: np.float32
    cost: np.float32
    """Sum of the costs, times the weights, m2."""
    x: np.float32
    """Sums of the positions x, y, z, times the weights, sensor axes, m."""
    y: np.float32
    z: np.float32


@kernel
def _energies(  # noqa: PLR0917
    attitudes: Float32Array,
    places: Float32Array,
    sight: _Sight,
    points: Points,
    field: FieldArrays,
    rounds: int,
    energy: Float32Array,
) -> None:
    """Fill ``energy``, shape (M,), m2, and replace ``places``; all in single precision.

    Args:
        attitudes: R_sensor_target, shape (M, 3, 3).
        places: positions of the target in the sensor, shape (M, 3), m, input and output.
        sight: the measurement.
        points: surface points of the target.
        field: squared distances from the target, m2.
        rounds: how often the centroids are aligned.
        energy: output.
    """
    centroid, image = sight.centroid, sight.image
    columns, seen_from, cube = points
    rays = np.empty((6, columns.shape[1]), np.float32)
    cells = np.empty(sight.returns.shape[1], np.int32)
    for m in range(attitudes.shape[0]):
        R, t = attitudes[m], places[m]
        cost, weight = np.float32(0.0), np.float32(0.0)
        for turn in range(rounds + 1):
            vx = -(R[0, 0] * t[0] + R[1, 0] * t[1] + R[2, 0] * t[2])
            vy = -(R[0, 1] * t[0] + R[1, 1] * t[1] + R[2, 1] * t[2])
            vz = -(R[0, 2] * t[0] + R[1, 2] * t[1] + R[2, 2] * t[2])
            _project(R, t, Vector(vx, vy, vz), columns, image, rays)
            seen = seen_from[view_of(vx, vy, vz, cube)]
            weight, cost, x, y, z = _compare(rays, seen, columns, sight)
            if turn < rounds and weight > 0.0:
                t[0] += centroid[0] - x / weight
                t[1] += centroid[1] - y / weight
                t[2] += centroid[2] - z / weight
        energy[m] = NOTHING_IN_VIEW
        if weight > 0.0:
            energy[m] = cost / weight + _off_surface(R, t, sight.returns, field, cells)


@inner_kernel
def _project(  # noqa: PLR0917
    R: Float32Array,
    t: Float32Array,
    viewpoint: Vector,
    columns: Float32Array,
    image: Image,
    rays: Float32Array,
) -> None:
    """Compute x, y, z, the cells of the image, and the echo of the points, 0 for those not in view.

    The loops are short and touch few arrays each, since only such loops are vectorised.

    Args:
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        viewpoint: position of the sensor, target axes, m.
        columns: ``Points.columns``, shape (9, K).
        image: squared angles to the nearest return.
        rays: output, shape (6, K); cells of points that are not in view are not valid.
    """
    squares, u0, du, v0, dv = image
    q, count = columns, columns.shape[1]
    vx, vy, vz = viewpoint
    r00, r01, r02, t0 = R[0, 0], R[0, 1], R[0, 2], t[0]
    r10, r11, r12, t1 = R[1, 0], R[1, 1], R[1, 2], t[1]
    r20, r21, r22, t2 = R[2, 0], R[2, 1], R[2, 2], t[2]
    for k in range(count):
        rays[0, k] = r00 * q[0, k] + r01 * q[1, k] + r02 * q[2, k] + t0
    for k in range(count):
        rays[1, k] = r10 * q[0, k] + r11 * q[1, k] + r12 * q[2, k] + t1
    for k in range(count):
        rays[2, k] = r20 * q[0, k] + r21 * q[1, k] + r22 * q[2, k] + t2
    for k in range(count):
        rays[5, k] = q[3, k] * vx + q[4, k] * vy + q[5, k] * vz - q[6, k]
    per_u, per_v = np.float32(1.0) / du, np.float32(1.0) / dv
    for k in range(count):
        rays[3, k] = (rays[0, k] / rays[2, k] - u0) * per_u
    for k in range(count):
        x, z = rays[0, k], rays[2, k]
        rays[4, k] = (rays[1, k] / np.sqrt(x * x + z * z) - v0) * per_v
    wide, high, none = np.float32(squares.shape[1]), np.float32(squares.shape[0]), np.float32(0.0)
    for k in range(count):
        x, y, z, u, v = rays[0, k], rays[1, k], rays[2, k], rays[3, k], rays[4, k]
        range2 = x * x + y * y + z * z
        in_view = (z > LEAST_Z_M) & (u >= none) & (u < wide) & (v >= none) & (v < high)
        rays[5, k] = rays[5, k] / (range2 * np.sqrt(range2)) if in_view else none


@inner_kernel
def _compare(rays: Float32Array, seen: NDArray[np.bool_], columns: Float32Array, sight: _Sight) -> _Sums:
    """Return the sums of weights, of weighted costs, and of weighted places, over the points in view.

    The echo, cos(theta) / R^2, is also proportional to the number of rays that a unit of area catches.

    Args:
        rays: filled by ``_project``, shape (6, K).
        seen: which points face the sensor and are not hidden, shape (K,).
        columns: ``Points.columns``, shape (9, K).
        sight: the measurement.
    """
    (steps, table), squares, most = sight.echoes, sight.image.squares, sight.most
    last = np.float32(table.size - 1)
    zero = np.float32(0.0)
    weights, cost, sx, sy, sz = zero, zero, zero, zero, zero
    for k in range(columns.shape[1]):
        echo = rays[5, k]
        if not echo > zero or not seen[k]:  # also true for NaN
            continue
        x, y, z = rays[0, k], rays[1, k], rays[2, k]
        weight = columns[7, k] * echo * table[int(min(max(zero, echo * columns[8, k] * steps), last))]
        weights += weight
        cost += weight * min(squares[int(rays[4, k]), int(rays[3, k])] * (x * x + y * y + z * z), most)
        sx += weight * x
        sy += weight * y
        sz += weight * z
    return _Sums(weights, cost, sx, sy, sz)


@inner_kernel
def _off_surface(
    R: Float32Array, t: Float32Array, returns: Float32Array, field: FieldArrays, cells: NDArray[np.int32]
) -> np.float32:
    """Return the mean squared distance of returns from the surface, m2, read at the nearest nodes.

    ``max(0, NaN)`` is 0, so that no node is outside of the field.

    Args:
        R: R_sensor_target, shape (3, 3).
        t: position of the target in the sensor, shape (3,), m.
        returns: measured points, sensor axes, shape (3, N), m.
        field: squared distances from the target, m2.
        cells: buffer, shape (N,).
    """
    origin, spacing, squares = field
    nx, ny, nz = squares.shape
    per_m, zero = np.float32(1.0) / spacing, np.float32(0.0)
    ax, ay, az = R[0, 0] * per_m, R[1, 0] * per_m, R[2, 0] * per_m
    bx, by, bz = R[0, 1] * per_m, R[1, 1] * per_m, R[2, 1] * per_m
    cx, cy, cz = R[0, 2] * per_m, R[1, 2] * per_m, R[2, 2] * per_m
    half = np.float32(0.5)
    a0 = half - origin[0] * per_m - ax * t[0] - ay * t[1] - az * t[2]
    b0 = half - origin[1] * per_m - bx * t[0] - by * t[1] - bz * t[2]
    c0 = half - origin[2] * per_m - cx * t[0] - cy * t[1] - cz * t[2]
    a1, b1, c1 = np.float32(nx) - half, np.float32(ny) - half, np.float32(nz) - half
    for n in range(returns.shape[1]):
        x, y, z = returns[0, n], returns[1, n], returns[2, n]
        i = np.int32(min(max(zero, ax * x + ay * y + az * z + a0), a1))
        j = np.int32(min(max(zero, bx * x + by * y + bz * z + b0), b1))
        k = np.int32(min(max(zero, cx * x + cy * y + cz * z + c0), c1))
        cells[n] = (i * np.int32(ny) + j) * np.int32(nz) + k
    flat, cost = squares.reshape(-1), zero
    for n in range(returns.shape[1]):
        cost += flat[cells[n]]
    return np.float32(cost / np.float32(returns.shape[1]))
